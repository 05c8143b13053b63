# SPDX-License-Identifier: Apache-2.0
"""Images to points: extraction, matching, stereo points and pose from points."""
