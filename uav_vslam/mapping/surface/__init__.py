# SPDX-License-Identifier: Apache-2.0
"""The height of the ground and of what stands on it, from pairs of images of one flight."""
