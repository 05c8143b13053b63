# SPDX-License-Identifier: Apache-2.0
"""The front_end study."""
