# SPDX-License-Identifier: Apache-2.0
"""Points that are followed from image to image: the live front end."""
