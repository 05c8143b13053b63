# SPDX-License-Identifier: Apache-2.0
"""Linearisation of the process and the stereo observation: by Jacobians, or by cubature points.

`Jacobians`  Eq. (4.2.4) of [thesis], the observation's evaluated at the smoothed depth (see `observation`).
`Cubature`   statistical regression over points of equal positive weight, the third-degree spherical rule of
             [arasaratnam09]: the unscented transform of section 4.3.1 without negative weights. The points span only
             the function's arguments (the navigation state; pose and one landmark), so they stay within a few sigmas
             for any number of landmarks.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.estimation.belief import NO_ROWS, Belief, Indices, Marginals
from uav_vslam.estimation.models import POSE, StateModel
from uav_vslam.estimation.observation import MIN_DEPTH_M, point_jacobian, smoothed
from uav_vslam.estimation.rig_errors import RigErrors
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.propagation import POSITION, ROTATION, propagate, transition
from uav_vslam.numerics import cholesky
from uav_vslam.types import ImuIncrement, NavState

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Process:
    """The predicted navigation state at the end of an increment, and its error e <- F e + noise of covariance Q.

    Attributes:
        nav: predicted mean.
        F, Q: (nav_dim, nav_dim) in the model's coordinates.
    """

    nav: NavState
    F: Array
    Q: Array


@dataclass(frozen=True, slots=True)
class Camera:
    """Estimated state of the cameras at the exposure of an image.

    Attributes:
        rig: calibration corrected by its estimated errors.
        errors: layout of the error states.
        model: error coordinates of the navigation state.
        nav: navigation state at the exposure.
        rate_map: (3,) angular rate at the exposure [rad/s].
        sigma_px: of each raw pixel coordinate.
        depth_sigma_ratio: see `observation.smoothed`.
        past_rows: number of rows of past poses, the last ones of the vehicle's error.
    """

    rig: StereoRig
    errors: RigErrors
    model: StateModel
    nav: NavState
    rate_map: Array
    sigma_px: float
    depth_sigma_ratio: float
    past_rows: int = 0


@dataclass(frozen=True, slots=True)
class PredictedObservation:
    """Predicted observation of M landmarks and its Jacobians.

    Attributes:
        landmarks: (M,) indices.
        expected: (M, 4) stereo pixels.
        H_vehicle: (M, 4, vehicle), H_landmark: (M, 4, 3).
        R: (M, 4, 4) noise [px^2].
        P: marginals of the vehicle and the landmarks.
    """

    landmarks: Indices
    expected: Array
    H_vehicle: Array
    H_landmark: Array
    R: Array
    P: Marginals

    def innovation_covariance(self) -> Array:
        """Return S, the (M, 4, 4) covariances of the innovations [px^2]; a gate needs them, an update does not."""
        return _innovation_covariance(self.H_vehicle, self.H_landmark, self.P) + self.R


class Linearisation(Protocol):
    """A linearisation of process and observation.

    Attributes:
        regresses: linearises by regression over the belief, which is inaccurate if the belief is too wide.
    """

    regresses: bool

    def process(
        self, model: StateModel, nav: NavState, belief: Belief, increment: ImuIncrement, imu: ImuConfig
    ) -> Process:
        """Predict the navigation state over an increment."""

    def observation(self, camera: Camera, which: Indices, landmarks: Array, P: Marginals) -> PredictedObservation:
        """Predict observations of (M, 3) landmarks.

        Args:
            camera: at the exposure.
            which: (M,) their indices, passed through.
            landmarks: (M, 3) [m]; in front of the cameras.
            P: of the vehicle and these landmarks.
        """


class Jacobians:
    """First-order expansion."""

    regresses = False

    def process(
        self, model: StateModel, nav: NavState, belief: Belief, increment: ImuIncrement, imu: ImuConfig
    ) -> Process:
        F15, Q15 = transition(nav, increment, imu)
        moved = propagate(nav, increment, gravity=imu.gravity)
        to_map, from_map = model.to_map(nav), model.from_map(moved)
        return Process(moved, from_map @ F15 @ to_map, from_map @ Q15 @ from_map.T)

    def observation(self, camera: Camera, which: Indices, landmarks: Array, P: Marginals) -> PredictedObservation:
        return _expanded(camera, which, landmarks, P)[0]


class Cubature:
    """Regression over cubature points; the rig's error states are small and keep their Jacobians."""

    regresses = True

    def process(
        self, model: StateModel, nav: NavState, belief: Belief, increment: ImuIncrement, imu: ImuConfig
    ) -> Process:
        none = np.zeros((0, 3))
        P_nav = belief.covariance(NO_ROWS)[: model.nav_dim, : model.nav_dim]
        L = cholesky(P_nav, "covariance of the navigation state")
        centre = propagate(nav, increment, gravity=imu.gravity)
        ends = []
        for offset in cubature_offsets(L):
            start, _ = model.retract(nav, none, offset)
            ends.append(model.local(centre, propagate(start, increment, gravity=imu.gravity)))
        shift, F, extra = regress(np.array(ends), np.zeros(len(L)), L)
        moved, _ = model.retract(centre, none, shift)
        _, Q15 = transition(nav, increment, imu)
        from_map = model.from_map(moved)
        return Process(moved, F, from_map @ Q15 @ from_map.T + extra)

    def observation(self, camera: Camera, which: Indices, landmarks: Array, P: Marginals) -> PredictedObservation:
        """Regress where all points of a landmark are in front of the cameras; elsewhere as `Jacobians`."""
        first, points_left, at = _expanded(camera, which, landmarks, P)
        if len(landmarks) == 0:
            return first
        L = np.asarray(np.linalg.cholesky(_pose_landmark_covariance(P)), dtype=np.float64)
        offsets = cubature_offsets(L)
        points = perturbed_points(camera, landmarks[:, None], offsets[..., :6], offsets[..., 6:])
        points += (at - points_left)[:, None]
        near = np.minimum(points[..., 2], camera.rig.T_right_left.apply(points)[..., 2]).min(axis=1)
        good = near > MIN_DEPTH_M
        seen = camera.rig.project(np.where(good[:, None, None], points, [0.0, 0.0, 1.0]))
        shift, A, extra = regress(seen, camera.rig.project(at), L)
        H_vehicle, H_landmark = first.H_vehicle.copy(), first.H_landmark.copy()
        H_vehicle[np.ix_(good, np.arange(4), POSE)] = A[good, :, :6]
        H_landmark[good] = A[good, :, 6:]
        R = first.R + extra * good[:, None, None]
        expected = first.expected + shift * good[:, None]
        return PredictedObservation(which, expected, H_vehicle, H_landmark, R, P)


def perturbed_points(camera: Camera, landmarks: Array, pose: Array, landmark: Array) -> Array:
    """Return (..., 3) landmarks in the left camera frame under errors of pose and landmark [m].

    Args:
        camera: at the exposure.
        landmarks: (..., 3) means [m].
        pose, landmark: (..., 6) and (..., 3) errors as of `StateModel.perturbed_arms`; all three are broadcast.
    """
    arms = landmarks - camera.nav.T_map_body.t
    in_body = camera.model.perturbed_arms(camera.nav, arms, pose, landmark)
    return np.asarray((in_body - camera.rig.T_body_left.t) @ camera.rig.T_body_left.R)


def camera_points(camera: Camera, landmarks: Array) -> tuple[Array, Array, Array]:
    """Return (M, 3) landmarks in the left camera frame and their derivatives (M, 3, vehicle) and (3, 3)."""
    jacobian = point_jacobian(camera.rig, camera.nav, landmarks)
    nav_dim = camera.model.nav_dim
    J = np.zeros((len(landmarks), 3, camera.errors.rows.stop + camera.past_rows))
    J[:, :, :nav_dim] = jacobian.nav @ camera.model.to_map(camera.nav)
    if camera.errors.has_time_offset:
        motion = np.zeros(jacobian.nav.shape[2])
        motion[POSITION], motion[ROTATION] = camera.nav.v_map, camera.rate_map
        J[:, :, camera.errors.time_offset] = (jacobian.nav @ motion)[:, :, None]
    return jacobian.points_left, J, jacobian.landmark


def pixel_jacobians(
    camera: Camera, points_left: Array, at: Array, J_vehicle: Array, J_landmark: Array
) -> tuple[Array, Array]:
    """Return H_vehicle (M, 4, vehicle) and H_landmark (M, 4, 3), the projection's Jacobian evaluated at `at` (M, 3)."""
    H_c = camera.rig.project_jacobian(at)
    H_vehicle = H_c @ J_vehicle
    if camera.errors.dim:
        H_vehicle[:, :, camera.errors.rows] += camera.errors.pixel_jacobian(camera.rig, points_left)
    return H_vehicle, H_c @ J_landmark


def cubature_offsets(L: Array) -> Array:
    """Return (..., 2d, d) offsets: the columns of sqrt(d) L for a (..., d, d) factor of the covariance, then minus."""
    columns = np.sqrt(L.shape[-1]) * np.swapaxes(L, -1, -2)
    return np.concatenate([columns, -columns], axis=-2)


def regress(values: Array, centre: Array, L: Array) -> tuple[Array, Array, Array]:
    """Linearise a function by regression over its cubature points.

    Args:
        values: (..., 2d, k) at the points of `cubature_offsets`.
        centre: (..., k) at the mean.
        L: (..., d, d) lower factor of the covariance of the argument.

    Returns:
        The mean of the function minus `centre` (..., k), its slope A (..., k, d), and the covariance (..., k, k) of
        the linearisation error.
    """
    d = L.shape[-1]
    plus, minus = values[..., :d, :], values[..., d:, :]
    slope = (plus - minus) / (2.0 * np.sqrt(d))  # row j: along column j of L
    bend = 0.5 * (plus + minus) - centre[..., None, :]
    shift = bend.mean(axis=-2)
    bend = bend - shift[..., None, :]
    A = np.swapaxes(np.linalg.solve(np.swapaxes(L, -1, -2), slope), -1, -2)
    return shift, A, np.swapaxes(bend, -1, -2) @ bend / d


def _expanded(
    camera: Camera, which: Indices, landmarks: Array, P: Marginals
) -> tuple[PredictedObservation, Array, Array]:
    """Return the first-order expansion of `Linearisation.observation`.

    Also return the (M, 3) landmarks in the left camera frame, and where the Jacobians are evaluated [m].
    """
    points_left, J_vehicle, J_landmark = camera_points(camera, landmarks)
    at = smoothed(points_left, _depth_variance(J_vehicle, J_landmark, P), depth_sigma_ratio=camera.depth_sigma_ratio)
    H_vehicle, H_landmark = pixel_jacobians(camera, points_left, at, J_vehicle, J_landmark)
    expected = camera.rig.project(points_left)
    sigma_px = camera.sigma_px * camera.rig.magnification(expected)
    R = sigma_px[:, None, None] ** 2 * np.eye(4)
    return PredictedObservation(which, expected, H_vehicle, H_landmark, R, P), points_left, at


def _depth_variance(J_vehicle: Array, J_landmark: Array, P: Marginals) -> Array:
    """Return (M,) variances of the landmarks' depths in the camera frame."""
    own = np.broadcast_to(J_landmark[2:], (len(J_vehicle), 1, 3))
    return _innovation_covariance(J_vehicle[:, 2:], own, P)[:, 0, 0]


def _innovation_covariance(H_vehicle: Array, H_landmark: Array, P: Marginals) -> Array:
    """Return (M, k, k) H P H^T for the vehicle and each landmark separately."""
    count, k, m = H_vehicle.shape
    half = 0.5 * (H_vehicle.reshape(count * k, m) @ P.vehicle).reshape(count, k, m)
    half += H_landmark @ np.swapaxes(P.cross, -1, -2)
    S = half @ np.swapaxes(H_vehicle, -1, -2) + 0.5 * (H_landmark @ P.landmarks @ np.swapaxes(H_landmark, -1, -2))
    return S + np.swapaxes(S, -1, -2)


def _pose_landmark_covariance(P: Marginals) -> Array:
    """Return (M, 9, 9) covariances of the pose and each landmark."""
    joint = np.empty((len(P.landmarks), 9, 9))
    joint[:, :6, :6] = P.vehicle[np.ix_(POSE, POSE)]
    joint[:, :6, 6:] = P.cross[:, POSE]
    joint[:, 6:, :6] = np.swapaxes(joint[:, :6, 6:], -1, -2)
    joint[:, 6:, 6:] = P.landmarks
    return joint
