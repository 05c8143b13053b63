# SPDX-License-Identifier: Apache-2.0
"""Which observed feature is which landmark of the map."""
