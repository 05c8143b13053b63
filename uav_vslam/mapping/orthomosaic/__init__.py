# SPDX-License-Identifier: Apache-2.0
"""One picture of all that was flown over, true to scale, from the views that see each spot best."""

from uav_vslam.mapping.orthomosaic.exposure import Exposure
from uav_vslam.mapping.orthomosaic.key_frames import KeyFrames
from uav_vslam.mapping.orthomosaic.mosaic import Orthomosaic, Picture
from uav_vslam.mapping.orthomosaic.two_passes import blended_mosaic

__all__ = ["Exposure", "KeyFrames", "Orthomosaic", "Picture", "blended_mosaic"]
