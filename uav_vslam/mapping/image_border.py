# SPDX-License-Identifier: Apache-2.0
"""The edge of an image, whose rays outline what it shows."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera


def image_border(camera: PinholeCamera, per_side: int) -> NDArray[np.float64]:
    """Return (4 per_side, 2) pixels around an image in order, at the outer edges of its outermost pixels."""
    share, zero, one = np.arange(per_side) / per_side, np.zeros(per_side), np.ones(per_side)
    u, v = np.concatenate([share, one, 1.0 - share, zero]), np.concatenate([zero, share, one, 1.0 - share])
    return np.stack([u * camera.width, v * camera.height], axis=-1) - 0.5
