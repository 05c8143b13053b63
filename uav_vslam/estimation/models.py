# SPDX-License-Identifier: Apache-2.0
"""State models: which error coordinates a filter uses for the navigation state and the landmarks.

Process and observation are written once, for map-frame errors (position, velocity, xi, biases); a model only defines
how its coordinates map to those, and how a correction is applied to the mean.

`ri15`    15 states. Errors are plain differences, transported with the estimate so that they remain a chart of the
          right-invariant error [barrau17]: the four unobservable directions (global position and yaw) stay so.
`so15`    the same states, ordinary linearisation: the baseline for the gain of invariance.
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

POSE = np.array([0, 1, 2, 6, 7, 8])  # columns of position and attitude, in every model


class StateModel(Protocol):
    """Error coordinates of the navigation state (`nav_dim` of them) and of N landmarks (3 each)."""

    nav_dim: int
    invariant: bool  # errors are transported after each correction, see `chart_transport`

    def to_map(self, nav: NavState) -> Array:
        """Return (15, nav_dim): Jacobian of the map-frame error by the model's error."""

    def from_map(self, nav: NavState) -> Array:
        """Return (nav_dim, 15): Jacobian of the model's error by the map-frame error."""

    def retract(self, nav: NavState, landmarks: Array, delta: Array) -> tuple[NavState, Array]:
        """Apply a correction (nav_dim + 3N,) to a mean, nav and (N, 3) landmarks."""

    def local(self, nav: NavState, nav_to: NavState) -> Array:
        """Return the (nav_dim,) correction that moves nav to nav_to."""

    def perturbed_arms(self, nav: NavState, arms: Array, pose: Array, landmark: Array) -> Array:
        """Return (..., 3) landmarks in the body frame under errors of pose and landmark.

        Args:
            nav: mean.
            arms: (..., 3) lever arms: mean landmark minus mean position, map frame [m].
            pose: (..., 6) errors in the columns `POSE`; all three are broadcast.
            landmark: (..., 3) errors.
        """


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

        delta already contains a landmark's shift by the rotation; the cross products remove it.
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
        shift = delta[NAV_DIM:].reshape(-1, 3) + arm @ skew(xi)  # arm x xi
        return moved, p + arm @ R_xi.T + shift @ J.T

    def local(self, nav: NavState, nav_to: NavState) -> Array:
        return difference(nav, np.zeros((0, 3)), nav_to, np.zeros((0, 3)))

    def perturbed_arms(self, nav: NavState, arms: Array, pose: Array, landmark: Array) -> Array:
        """As `retract` does: R^T (arm + J_r(xi) (dl - dp + arm x xi)); linear but for J_r."""
        dp, xi = pose[..., :3], pose[..., 3:]
        shift = landmark - dp + np.cross(arms, xi)
        return (arms + _turned_back(so3_left_jacobian(xi), shift)) @ nav.T_map_body.R  # J_r = J_l^T


class Ordinary15(RightInvariant15):
    """The same states with the usual additive correction, without transport."""

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

    def local(self, nav: NavState, nav_to: NavState) -> Array:
        return np.concatenate(
            [
                nav_to.T_map_body.t - nav.T_map_body.t,
                nav_to.v_map - nav.v_map,
                so3_log(nav_to.T_map_body.R @ nav.T_map_body.R.T),
                nav_to.gyro_bias - nav.gyro_bias,
                nav_to.accel_bias - nav.accel_bias,
            ]
        )

    def perturbed_arms(self, nav: NavState, arms: Array, pose: Array, landmark: Array) -> Array:
        return _turned_back(so3_exp(pose[..., 3:]), arms + landmark - pose[..., :3]) @ nav.T_map_body.R


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

    def local(self, nav: NavState, nav_to: NavState) -> Array:
        R, R_to = nav.T_map_body.R, nav_to.T_map_body.R
        turned = rpy_from_rotation(R_to) - rpy_from_rotation(R)
        return np.concatenate(
            [
                nav_to.T_map_body.t - nav.T_map_body.t,
                R_to.T @ nav_to.v_map - R.T @ nav.v_map,
                (turned + np.pi) % (2 * np.pi) - np.pi,
            ]
        )

    def perturbed_arms(self, nav: NavState, arms: Array, pose: Array, landmark: Array) -> Array:
        rpy = rpy_from_rotation(nav.T_map_body.R) + pose[..., 3:]
        R = rotation_from_rpy(rpy[..., 0], rpy[..., 1], rpy[..., 2])
        return _turned_back(R, arms + landmark - pose[..., :3])


def _turned_back(R: Array, vectors: Array) -> Array:
    """Return R^T v for broadcastable (..., 3, 3) and (..., 3)."""
    return np.asarray(np.einsum("...ij,...i->...j", R, vectors))


def _rotation_per_rpy(R: Array) -> Array:
    """Return E (3, 3) with xi = E d(roll, pitch, yaw) for R = Rz Ry Rx and a map-frame rotation vector xi."""
    _, pitch, yaw = rpy_from_rotation(R)
    sin, cos = np.sin(yaw), np.cos(yaw)
    return np.array([[cos * np.cos(pitch), -sin, 0.0], [sin * np.cos(pitch), cos, 0.0], [-np.sin(pitch), 0.0, 1.0]])


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


def chart_transport(vehicle: int, moved_position: Array, moved_velocity: Array, moved_landmarks: Array) -> Array:
    """Return B (vehicle + 3N, 3), which transports the errors of the right-invariant chart to a corrected mean.

    A plain error is dl = xi_l - [l]x xi. The invariant xi_l does not depend on the mean (up to the second-order reset
    Jacobian), so moving l to l+ gives dl+ = dl - [l+ - l]x xi; likewise for p and v. This is T = I - B E_xi^T, with
    E_xi the three columns of the rotation.

    Args:
        vehicle: rows of the vehicle.
        moved_position, moved_velocity: (3,) shifts of the mean [m], [m/s].
        moved_landmarks: (N, 3) shifts of the landmarks [m].
    """
    B = np.zeros((vehicle + 3 * len(moved_landmarks), 3))
    B[POSITION] = skew(moved_position)
    B[VELOCITY] = skew(moved_velocity)
    B[vehicle:] = skew(moved_landmarks).reshape(-1, 3)
    return B


MODELS: dict[str, type[StateModel]] = {"ri15": RightInvariant15, "so15": Ordinary15, "euler9": Euler9}
