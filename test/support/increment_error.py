# SPDX-License-Identifier: Apache-2.0
"""The error of an increment, in the order of its covariance."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.types import ImuIncrement


def difference(a: ImuIncrement, reference: ImuIncrement) -> NDArray[np.float64]:
    """Return a minus reference (9,): right rotation vector, velocity, position."""
    turn = so3_log(reference.delta_R.T @ a.delta_R)
    return np.concatenate([turn, a.delta_v - reference.delta_v, a.delta_p - reference.delta_p])


def shifted(increment: ImuIncrement, error: NDArray[np.float64]) -> ImuIncrement:
    """Return the increment whose `difference` from a given one is (9,) `error`."""
    return dataclasses.replace(
        increment,
        delta_R=increment.delta_R @ so3_exp(error[:3]),
        delta_v=increment.delta_v + error[3:6],
        delta_p=increment.delta_p + error[6:9],
    )
