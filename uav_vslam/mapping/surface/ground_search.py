# SPDX-License-Identifier: Apache-2.0
"""Where the ground is, from the first two views alone: small images, searched over all depths a pair can have."""

import numpy as np

from uav_vslam.mapping.surface.prepared import PreparedView
from uav_vslam.mapping.surface.rectification import Depths, rectify
from uav_vslam.mapping.surface.settings import SurfaceSettings
from uav_vslam.mapping.surface.stereo import match

SMALL_PX = 160  # width of the small images
NEAREST, FARTHEST = 3.0, 60.0  # depths searched, in baselines
MOST_DISPARITIES = 96
LEAST_SHARE = 0.5  # of the common ground that must be matched
RANGE_PERCENTILES = (5.0, 50.0, 95.0)
LEAST_BASELINE_M = 0.2
RESOLVED_PX = 4.0  # least disparity of the ground in the small images


def search_ground(first: PreparedView, second: PreparedView, settings: SurfaceSettings) -> Depths | None:
    """Return the heights of the ground; None while the views don't determine them, as without motion.

    Args:
        first, second: views of the same ground.
        settings: of the matching that follows.
    """
    baseline_m = float(np.linalg.norm(second.T_map_cam.t - first.T_map_cam.t))
    if baseline_m < LEAST_BASELINE_M:
        return None
    scale = min(1.0, SMALL_PX / first.camera.width)
    small = [view.smaller(scale) for view in (first, second)]
    above = first.T_map_cam.t[2]
    # The middle is the harmonic mean, so that disparities reach equally far to both sides.
    middle = 2.0 * NEAREST * FARTHEST / (NEAREST + FARTHEST)
    searched = Depths(*(above - baseline_m * depth for depth in (FARTHEST, middle, NEAREST)))
    pair = rectify(small[0], small[1], searched, most=MOST_DISPARITIES, overlap=0.0)
    if pair is None:
        return None
    found = match(pair, settings)
    if found.share < LEAST_SHARE:
        return None
    depths = Depths(*np.percentile(found.points_map[:, 2], RANGE_PERCENTILES).tolist())
    disparity = pair.focal_px * baseline_m / max(above - depths.middle_m, 1e-6)
    return depths if disparity >= RESOLVED_PX else None
