# SPDX-License-Identifier: Apache-2.0
"""How good a flight was: errors against the truth, consistency, and the folder that keeps them."""
