# SPDX-License-Identifier: Apache-2.0
"""Where the corners of a ridge roof are."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.simulation.ridged import Ridged


def roof_corners(solid: Ridged) -> NDArray[np.float64]:
    """Return the (6, 3) corners of a roof [m]: the eaves above the footprint's corners, then the ends of the ridge."""
    along = np.array([np.cos(solid.heading_rad), np.sin(solid.heading_rad)])
    ends = 0.5 * solid.length_m * np.array([1.0, -1.0])
    ridge = ends[:, None] * along + [solid.x, solid.y]
    fall = 0.5 * solid.width_m * solid.pitch * np.array([1.0, 1.0, 1.0, 1.0, 0.0, 0.0])
    z = solid.ridge_z + solid.climb * ends[[0, 1, 1, 0, 0, 1]] - fall
    return np.column_stack([np.concatenate([solid.footprint, ridge]), z])
