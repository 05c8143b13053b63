# SPDX-License-Identifier: Apache-2.0
"""The most likely trajectory given a whole flight; nothing of it flows back into the filter."""
