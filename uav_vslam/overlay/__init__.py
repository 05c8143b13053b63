# SPDX-License-Identifier: Apache-2.0
"""Feature tracks drawn on the images that they were found in."""
