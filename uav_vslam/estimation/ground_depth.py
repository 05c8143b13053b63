# SPDX-License-Identifier: Apache-2.0
"""How far away the ground is where points are seen, if what they show is ground.

A plane appears in the left image with an inverse depth that is linear in the normalised coordinates, whatever its tilt:
1/z = a + b x + c y. Cameras that look down have nearly the same depth everywhere, and few points tell no slope: there
it is the median. Points that scatter about the plane more than their errors and the relief explain, as in a room, show
no ground.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.numerics import robust_sigma

Array = NDArray[np.float64]

SLOPE_SIGMA = 1.0  # prior standard deviation of b/a and c/a, the tangents of the ground's tilt
STEEP = np.tan(np.deg2rad(40.0))  # of a view, beyond which the ground's depth is that of a plane: no turn banks so far
FARTHEST = 5.0  # of the ground, over the points' median depth: the plane may reach the horizon
NO_GROUND = 2.0  # standard deviations that points scatter about ground: beyond that they show none
ENOUGH = 10  # points to tell a slope or that there is no ground


def ground_depth(points_left: Array, depth_variance: Array, relief: float) -> Array | None:
    """Return the depths (N,) [m] that ground has along the rays to points, or None if they show none.

    Args:
        points_left: (N, 3) in the left camera frame, all in front [m].
        depth_variance: (N,) variance of each depth [m^2].
        relief: of ground, over its depth.
    """
    depth = points_left[:, 2]
    median = float(np.median(depth))
    level = np.full(len(depth), median)
    if len(depth) < ENOUGH:
        return level
    variance = depth_variance / depth**4  # of the inverse depths
    A = points_left / depth[:, None]  # x, y, 1
    weight = 1.0 / ((relief / depth) ** 2 + variance)
    N = (A.T * weight) @ A
    N[[0, 1], [0, 1]] += (median / SLOPE_SIGMA) ** 2
    plane = np.linalg.solve(N, A.T @ (weight / depth))
    ground = 1.0 / np.maximum(A @ plane, 1.0 / (FARTHEST * median))
    scatter = robust_sigma(ground / depth - 1.0)
    if scatter > NO_GROUND * np.sqrt(relief**2 + np.median(variance * ground**2)):
        return None
    return ground if np.hypot(*plane[:2]) > STEEP * plane[2] else level
