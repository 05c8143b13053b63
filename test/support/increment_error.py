# SPDX-License-Identifier: Apache-2.0
"""The error of an increment, in the order of its covariance."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.rotation import so3_log
from uav_vslam.types import ImuIncrement


def difference(a: ImuIncrement, reference: ImuIncrement) -> NDArray[np.float64]:
    """Return a minus reference (9,): right rotation vector, velocity, position."""
    turn = so3_log(reference.delta_R.T @ a.delta_R)
    return np.concatenate([turn, a.delta_v - reference.delta_v, a.delta_p - reference.delta_p])
