# SPDX-License-Identifier: Apache-2.0
"""Velocity and rate of the body in its own frame, with their covariance, as odometry publishes them."""

import numpy as np

from uav_vslam.geometry.rotation import skew
from uav_vslam.ins.gaps import UNKNOWN_RATE_SIGMA
from uav_vslam.ins.propagation import GYRO_BIAS, NAV_DIM, ROTATION, VELOCITY
from uav_vslam.types import ImuIncrement, NavEstimate, Twist


def body_twist(nav: NavEstimate, increment: ImuIncrement | None) -> Twist:
    """Return the twist at a navigation estimate.

    The linear velocity is R^T v, of error R^T (dv + [v]x xi); the angular one is the newest reading without its bias,
    of error -db and the white noise of one reading.

    Args:
        nav: the estimate.
        increment: the motion that ends there; without one the rate is unknown.
    """
    state, R = nav.state, nav.state.T_map_body.R
    J = np.zeros((6, NAV_DIM))
    J[:3, VELOCITY], J[:3, ROTATION] = R.T, R.T @ skew(state.v_map)
    variance, rate = UNKNOWN_RATE_SIGMA**2, np.zeros(3)
    if increment is not None and increment.samples:
        J[3:, GYRO_BIAS] = -np.eye(3)
        variance = increment.gyro_noise**2 * increment.samples / increment.dt_s
        rate = increment.rate_end - state.gyro_bias
    covariance = J @ nav.covariance @ J.T
    covariance[3:, 3:] += variance * np.eye(3)
    return Twist(R.T @ state.v_map, rate, covariance)
