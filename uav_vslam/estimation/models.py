# SPDX-License-Identifier: Apache-2.0
"""State models: which error coordinates a filter uses for the navigation state and the landmarks.

Everything else (process, observation) is written once, for map-frame errors (position, velocity, xi, biases); a model
only says how its own coordinates map to those, and how a correction moves the mean.

`ri15`    15 states. Errors are kept as plain differences but moved with the estimate so that they stay a chart of the
          right-invariant error: the four unobservable directions (global position and yaw) stay unobservable.
`so15`    the same states, ordinary linearisation: the baseline that shows what invariance is worth.
`euler9`  the thesis's nine states [X Y Z U V W phi theta psi] (Eq. 4.6.2), no biases, ordinary linearisation.
"""

import dataclasses
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import (
    rotation_from_rpy,
    rpy_from_rotation,
    skew,
    so3_exp,
    so3_left_jacobian,
    so3_log,
)
from uav_vslam.ins.propagation import NAV_DIM, POSITION, ROTATION, VELOCITY
from uav_vslam.types import NavState

Array = NDArray[np.float64]


class StateModel(Protocol):
    """Error coordinates of the navigation state (`nav_dim` of them) and of N landmarks (3 each)."""

    nav_dim: int
    invariant: bool  # errors are sheared after each correction, see `retangent`

    def to_map(self, nav: NavState) -> Array:
        """Return (15, nav_dim): model error to map-frame error at a mean."""

    def from_map(self, nav: NavState) -> Array:
        """Return (nav_dim, 15): map-frame error to model error at a mean."""

    def retract(self, nav: NavState, landmarks: Array, delta: Array) -> tuple[NavState, Array]:
        """Move a mean, nav and (N, 3) landmarks, by a correction (nav_dim + 3N,)."""


class RightInvariant15:
    """The default model."""

    nav_dim = NAV_DIM
    invariant = True

    def to_map(self, nav: NavState) -> Array:
        return np.eye(NAV_DIM)

    def from_map(self, nav: NavState) -> Array:
        return np.eye(NAV_DIM)

    def retract(self, nav: NavState, landmarks: Array, delta: Array) -> tuple[NavState, Array]:
        """Apply the exponential of SE_{2+N}(3), written for plain differences.

        delta already holds the rotation's share of a landmark's shift, hence the cross products that take it out.
        """
        xi = delta[ROTATION]
        R_xi, J = so3_exp(xi), so3_left_jacobian(xi)
        p, v = nav.T_map_body.t, nav.v_map
        moved = dataclasses.replace(
            nav,
            T_map_body=Pose(R_xi @ nav.T_map_body.R, p + J @ delta[POSITION]),
            v_map=R_xi @ v + J @ (delta[VELOCITY] + np.cross(v, xi)),
            gyro_bias=nav.gyro_bias + delta[9:12],
            accel_bias=nav.accel_bias + delta[12:15],
        )
        arm = landmarks - p
        shift = delta[NAV_DIM:].reshape(-1, 3) + np.cross(arm, xi)
        return moved, p + arm @ R_xi.T + shift @ J.T


class Ordinary15(RightInvariant15):
    """The same states with the usual additive correction and no shear."""

    invariant = False

    def retract(self, nav: NavState, landmarks: Array, delta: Array) -> tuple[NavState, Array]:
        moved = dataclasses.replace(
            nav,
            T_map_body=Pose(so3_exp(delta[ROTATION]) @ nav.T_map_body.R, nav.T_map_body.t + delta[POSITION]),
            v_map=nav.v_map + delta[VELOCITY],
            gyro_bias=nav.gyro_bias + delta[9:12],
            accel_bias=nav.accel_bias + delta[12:15],
        )
        return moved, landmarks + delta[NAV_DIM:].reshape(-1, 3)


class Euler9:
    """The thesis's state: position, velocity in the body frame, roll-pitch-yaw; singular at 90 degrees of pitch."""

    nav_dim = 9
    invariant = False

    def to_map(self, nav: NavState) -> Array:
        """Position as it is; v = R (U V W); xi = E(phi, theta, psi) d(angles)."""
        R = nav.T_map_body.R
        E = _rotation_per_rpy(R)
        C = np.zeros((NAV_DIM, 9))
        C[POSITION, 0:3] = np.eye(3)
        C[VELOCITY, 3:6] = R
        C[VELOCITY, 6:9] = -skew(nav.v_map) @ E
        C[ROTATION, 6:9] = E
        return C

    def from_map(self, nav: NavState) -> Array:
        C = np.zeros((9, NAV_DIM))
        C[:, :9] = np.linalg.inv(self.to_map(nav)[:9])
        return C

    def retract(self, nav: NavState, landmarks: Array, delta: Array) -> tuple[NavState, Array]:
        R = nav.T_map_body.R
        R_new = rotation_from_rpy(*(rpy_from_rotation(R) + delta[6:9]))
        moved = dataclasses.replace(
            nav,
            T_map_body=Pose(R_new, nav.T_map_body.t + delta[0:3]),
            v_map=R_new @ (R.T @ nav.v_map + delta[3:6]),
        )
        return moved, landmarks + delta[9:].reshape(-1, 3)


def _rotation_per_rpy(R: Array) -> Array:
    """Return E (3, 3) with xi = E d(roll, pitch, yaw) for R = Rz Ry Rx and a map-frame rotation vector xi."""
    _, pitch, yaw = rpy_from_rotation(R)
    return np.column_stack(
        [rotation_from_rpy(0.0, pitch, yaw)[:, 0], rotation_from_rpy(0.0, 0.0, yaw)[:, 1], [0, 0, 1]]
    )


def difference(nav: NavState, landmarks: Array, nav_to: NavState, landmarks_to: Array) -> Array:
    """Return the delta (15 + 3N,) with RightInvariant15.retract(nav, landmarks, delta) = (nav_to, landmarks_to)."""
    p = nav.T_map_body.t
    xi = so3_log(nav_to.T_map_body.R @ nav.T_map_body.R.T)
    R_xi, J_inv = so3_exp(xi), np.linalg.inv(so3_left_jacobian(xi))
    arm = landmarks - p
    nav_delta = [
        J_inv @ (nav_to.T_map_body.t - p),
        J_inv @ (nav_to.v_map - R_xi @ nav.v_map) - np.cross(nav.v_map, xi),
        xi,
        nav_to.gyro_bias - nav.gyro_bias,
        nav_to.accel_bias - nav.accel_bias,
    ]
    landmark_delta = (landmarks_to - p - arm @ R_xi.T) @ J_inv.T - np.cross(arm, xi)
    return np.concatenate([*nav_delta, landmark_delta.ravel()])


def retangent(Y: Array, moved_position: Array, moved_velocity: Array, moved_landmarks: Array) -> Array:
    """Carry an information matrix of the right-invariant chart to the moved mean.

    A plain error is dl = xi_l - [l]x xi with the invariant xi_l, which a moving mean leaves alone (but for the reset
    Jacobian, of second order): with l moving to l+ it becomes dl+ = dl - [l+ - l]x xi; likewise p and v. For T that
    map, Y+ = T^-T Y T^-1. T differs from I in the three xi columns only, so the cost is O(n^2).

    Args:
        Y: (15+3N, 15+3N) information.
        moved_position, moved_velocity: (3,) shifts of the mean [m], [m/s].
        moved_landmarks: (N, 3) shifts of the landmarks [m].
    """
    B = np.zeros((len(Y), 3))  # T^-1 = I + B E_xi^T
    B[POSITION] = skew(moved_position)
    B[VELOCITY] = skew(moved_velocity)
    B[NAV_DIM:] = skew(moved_landmarks).reshape(-1, 3)
    YB = Y @ B
    out = Y.copy()
    out[:, ROTATION] += YB
    out[ROTATION, :] += YB.T
    out[ROTATION, ROTATION] += B.T @ YB
    return out


MODELS: dict[str, type[StateModel]] = {"ri15": RightInvariant15, "so15": Ordinary15, "euler9": Euler9}
