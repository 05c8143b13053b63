# SPDX-License-Identifier: Apache-2.0
"""The strapdown process model on increments: mean, transition and process noise.

The error is (position, velocity, rotation xi, gyro bias, accel bias) in the map frame, R_true = Exp(xi) R. In these
coordinates the transition depends on the estimate only through the displacement by the specific force, so the
model is group-affine except for the biases [barrau17].
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew, so3_exp
from uav_vslam.types import ImuIncrement, NavState

Array = NDArray[np.float64]
Deltas = tuple[Array, Array, Array]  # of rotation, velocity and position

NAV_DIM = 15
POSITION, VELOCITY, ROTATION, GYRO_BIAS, ACCEL_BIAS = (slice(k, k + 3) for k in range(0, NAV_DIM, 3))
# Power of the remaining time with which a change of gyro and accel bias grows in position, velocity, rotation, biases.
GROWTH = np.repeat([[3, 2], [2, 1], [1, 1], [0, 0], [0, 0]], 3, axis=0)
_POWERS = [n[:, None] + n + 1 for n in GROWTH.T]  # n_i + n_j + 1 of both kinds


def corrected(increment: ImuIncrement, gyro_bias: Array, accel_bias: Array) -> Deltas:
    """Return delta_R, delta_v, delta_p corrected to another bias, to first order.

    Args:
        increment: preintegrated motion.
        gyro_bias, accel_bias: (3,) the new bias [rad/s], [m/s^2].
    """
    shift = increment.bias_jacobian @ np.concatenate(
        [gyro_bias - increment.gyro_bias, accel_bias - increment.accel_bias]
    )
    return increment.delta_R @ so3_exp(shift[:3]), increment.delta_v + shift[3:6], increment.delta_p + shift[6:9]


def propagate(state: NavState, increment: ImuIncrement, *, gravity: float, deltas: Deltas | None = None) -> NavState:
    """Return the state at the end of an increment; Eq. (4.6.4) of [thesis] integrated in the map frame.

    Args:
        state: at its start.
        increment: the motion.
        gravity: [m/s^2].
        deltas: what `corrected` returns for the state's biases, if it is known.
    """
    delta_R, delta_v, delta_p = deltas or corrected(increment, state.gyro_bias, state.accel_bias)
    dt = increment.dt_s
    g_map = np.array([0.0, 0.0, -gravity])
    R, p = state.T_map_body.R, state.T_map_body.t
    return dataclasses.replace(
        state,
        stamp_ns=increment.stamp_ns,
        T_map_body=Pose(R @ delta_R, p + state.v_map * dt + 0.5 * g_map * dt**2 + R @ delta_p),
        v_map=state.v_map + g_map * dt + R @ delta_v,
    )


def transition(
    state: NavState, increment: ImuIncrement, imu: ImuConfig, *, deltas: Deltas | None = None
) -> tuple[Array, Array]:
    """Return F (15, 15) and Q (15, 15) of the error over an increment that starts at `state`; `deltas` as above."""
    delta_R, delta_v, delta_p = deltas or corrected(increment, state.gyro_bias, state.accel_bias)
    dt = increment.dt_s
    R = state.T_map_body.R
    to_map = np.zeros((NAV_DIM, 9))  # increment errors (rotation, velocity, position) into the map frame
    to_map[ROTATION, 0:3] = R @ delta_R
    to_map[VELOCITY, 3:6] = R
    to_map[POSITION, 6:9] = R
    F = np.eye(NAV_DIM)
    F[POSITION, VELOCITY] = dt * np.eye(3)
    F[POSITION, ROTATION] = -skew(R @ delta_p)
    F[VELOCITY, ROTATION] = -skew(R @ delta_v)
    F[:, 9:15] += to_map @ increment.bias_jacobian
    Q = to_map @ increment.covariance @ to_map.T + _bias_walk(F[:, 9:15], dt, imu)
    return F, Q


def _bias_walk(effect: Array, dt_s: float, imu: ImuConfig) -> Array:
    """Return (15, 15) covariance of the error that the random walks of the biases leave at the end of an increment.

    A step dw of a bias, tau before the end, moves error i by (tau/dt)^n_i J_i dw, n as in `GROWTH`; the integral
    over tau is s^2 dt J_i J_j^T / (n_i + n_j + 1). Exact for a constant specific force without rotation.

    Args:
        effect: (15, 6) J, error at the end by gyro and accel bias at the start.
        dt_s: length of the increment [s].
        imu: s, the densities of the walks.
    """
    Q = np.zeros((NAV_DIM, NAV_DIM))
    for kind, density in enumerate((imu.gyro_bias_walk, imu.accel_bias_walk)):
        J = effect[:, 3 * kind : 3 * kind + 3]
        Q += density**2 * dt_s * (J @ J.T) / _POWERS[kind]
    return Q
