# SPDX-License-Identifier: Apache-2.0
"""Extended information filter over one vehicle and its landmarks; section 4.5 of [thesis], on a manifold.

Symbols: `Y` information, `P = Y^-1`, `F, Q` process, `H, R, nu` observation, `i = H^T R^-1 nu`, `I = H^T R^-1 H`.
On a manifold the information *state* of Eq. (4.5.3) has no meaning; the mean is kept instead, and the correction is
`delta = Y^-1 i` by a Cholesky solve. Updates are additive and batched over landmarks; new landmarks enter with zero
information, leaving ones are marginalised by a Schur complement. Nothing is ever inverted for a gain.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from uav_vslam.config import ImuConfig
from uav_vslam.estimation.models import MODELS, StateModel, difference, retangent
from uav_vslam.estimation.numerics import inverse_spd, marginalise_information, solve_spd, symmetrise
from uav_vslam.estimation.observation import point_jacobian, smoothed, triangulation_covariance
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.propagation import VELOCITY, propagate, transition
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate, NavState

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class PredictedObservation:
    """What the filter expects to see of some landmarks.

    Attributes:
        points_left: (N, 3) landmarks in the left camera frame [m].
        S: (N, 4, 4) innovation covariances, pixel noise included [px^2].
        H_nav: (N, 4, nav_dim), H_landmark: (N, 4, 3) Jacobians in the model's coordinates.
    """

    points_left: Array
    S: Array
    H_nav: Array
    H_landmark: Array


@dataclass(frozen=True, slots=True)
class Innovation:
    """How an update agreed with the prediction: nis is chi-square with dof degrees of freedom.

    An update that was not accepted has changed nothing.
    """

    nis: float
    dof: int
    accepted: bool = True


class ExtendedInformationFilter:
    """The filter; `nav` and `landmarks` (N, 3) are its mean, `Y` its information in the model's coordinates."""

    def __init__(
        self,
        initial: NavEstimate,
        *,
        rig: StereoRig,
        imu: ImuConfig,
        model: str = "ri15",
        sigma_px: float = 1.0,
        depth_sigma_ratio: float = 0.0,
    ) -> None:
        self._rig, self._imu = rig, imu
        self._model: StateModel = MODELS[model]()
        self._sigma_px = sigma_px
        self._depth_sigma_ratio = depth_sigma_ratio
        self.nav: NavState = initial.state
        self.landmarks: Array = np.zeros((0, 3))
        C = self._model.from_map(initial.state)
        self.Y: Array = inverse_spd(symmetrise(C @ initial.covariance @ C.T), "initial covariance")
        self._P: Array | None = None

    @property
    def P(self) -> Array:
        """(nav_dim + 3N, nav_dim + 3N) covariance in the model's coordinates, computed when asked for."""
        if self._P is None:
            self._P = inverse_spd(self.Y, f"information at {self.nav.stamp_ns / NS_PER_S:.3f} s")
        return self._P

    def predict(self, increment: ImuIncrement) -> None:
        """Propagate over an increment: Y <- (F Y^-1 F^T + Q)^-1 by the matrix inversion lemma on the vehicle block."""
        F15, Q15 = transition(self.nav, increment, self._imu)
        moved = propagate(self.nav, increment, gravity=self._imu.gravity)
        to_map, from_map = self._model.to_map(self.nav), self._model.from_map(moved)
        F, Q = from_map @ F15 @ to_map, from_map @ Q15 @ from_map.T
        m = self._model.nav_dim
        F_inv = np.linalg.inv(F)
        Y = self.Y.copy()
        Y[:m, :] = F_inv.T @ Y[:m, :]
        Y[:, :m] = Y[:, :m] @ F_inv
        # Q = L L^T may be singular: Y - Y_v L (I + L^T Y_vv L)^-1 L^T Y_v^T needs no inverse of it.
        values, vectors = np.linalg.eigh(symmetrise(Q))
        L = vectors * np.sqrt(np.maximum(values, 0.0))
        YL = Y[:, :m] @ L
        Y -= YL @ solve_spd(np.eye(m) + L.T @ YL[:m], YL.T, "process noise")
        self.nav = moved
        self._set(symmetrise(Y))

    def predict_observations(self, indices: Indices) -> PredictedObservation:
        """Return what should be seen of the chosen landmarks; they must be projectable."""
        jacobian = point_jacobian(self._rig, self.nav, self.landmarks[indices])
        J_nav = jacobian.nav @ self._model.to_map(self.nav)
        m = self._model.nav_dim
        columns = m + 3 * indices[:, None] + np.arange(3)
        P_nn, P_nl = self.P[:m, :m], self.P[:m, :][:, columns].transpose(1, 0, 2)
        P_ll = self.P[columns[:, :, None], columns[:, None, :]]
        cross = J_nav @ P_nl @ jacobian.landmark.T
        P_c = J_nav @ P_nn @ J_nav.transpose(0, 2, 1) + cross + cross.transpose(0, 2, 1)
        P_c += jacobian.landmark @ P_ll @ jacobian.landmark.T
        H_c = self._pixel_jacobian(jacobian.points_left, P_c[:, 2, 2])
        S = H_c @ P_c @ H_c.transpose(0, 2, 1) + self._sigma_px**2 * np.eye(4)
        return PredictedObservation(jacobian.points_left, symmetrise(S), H_c @ J_nav, H_c @ jacobian.landmark)

    def joint_innovation(self, indices: Indices, pixels: Array) -> tuple[Array, Array]:
        """Return the innovations (M, 4) of stereo observations and their joint covariance (4M, 4M) [px], [px^2]."""
        predicted = self.predict_observations(indices)
        m, count = self._model.nav_dim, len(indices)
        rows = np.arange(count)
        H = np.zeros((count, 4, m + 3 * count))
        H[:, :, :m] = predicted.H_nav
        H[rows[:, None, None], np.arange(4)[:, None], (m + 3 * rows[:, None] + np.arange(3))[:, None, :]] = (
            predicted.H_landmark
        )
        columns = np.concatenate([np.arange(m), (m + 3 * np.asarray(indices)[:, None] + np.arange(3)).ravel()])
        H_all = H.reshape(4 * count, m + 3 * count)
        S = H_all @ self.P[np.ix_(columns, columns)] @ H_all.T + self._sigma_px**2 * np.eye(4 * count)
        return pixels - self._rig.project(predicted.points_left), symmetrise(S)

    def update(
        self,
        indices: Indices,
        pixels: Array,
        *,
        linearise_at: Pose | None = None,
        significance: float = 0.0,
    ) -> Innovation:
        """Correct by stereo observations of landmarks.

        Args:
            indices: (M,) rows of `landmarks`, each at most once.
            pixels: (M, 4) undistorted stereo pixels.
            linearise_at: T_map_body where to linearise instead of at the mean; for a mean known to be far off.
            significance: the update is refused if right observations were as far off together with less probability.
        """
        before = (self.nav, self.Y)
        prior_offset = np.zeros(len(self.Y))
        if linearise_at is not None and self._model.invariant:
            prior_offset = self._move_linearisation(linearise_at)
        predicted = self.predict_observations(indices)
        nu = pixels - self._rig.project(predicted.points_left)
        information = _scatter_information(predicted, indices, len(self.Y), self._model.nav_dim) / self._sigma_px**2
        i = _scatter_vector(predicted, nu, indices, len(self.Y), self._model.nav_dim) / self._sigma_px**2
        if linearise_at is not None:
            i = i + self.Y @ prior_offset
        Y = self.Y + information
        delta = solve_spd(Y, i, f"information at {self.nav.stamp_ns / NS_PER_S:.3f} s")
        nis = float(np.sum(nu**2) / self._sigma_px**2 + prior_offset @ self.Y @ prior_offset - i @ delta)
        innovation = Innovation(nis, 4 * len(indices), chdtrc(4 * len(indices), nis) >= significance)
        if innovation.accepted:
            self._correct(Y, delta)
        else:
            self.nav = before[0]
            self._set(before[1])
        return innovation

    def add_landmarks(self, pixels: Array) -> None:
        """Append landmarks at their triangulated positions: zero information, then the observation's own.

        Args:
            pixels: (M, 4) undistorted stereo pixels that triangulate to finite points.
        """
        points_left = self._rig.triangulate(pixels)
        start, m = len(self.landmarks), self._model.nav_dim
        T_map_left = self.nav.T_map_body @ self._rig.T_body_left
        self.landmarks = np.vstack([self.landmarks, T_map_left.apply(points_left)])
        Y = np.zeros((m + 3 * len(self.landmarks),) * 2)
        Y[: len(self.Y), : len(self.Y)] = self.Y
        indices = np.arange(start, len(self.landmarks))
        jacobian = point_jacobian(self._rig, self.nav, self.landmarks[indices])
        variance = triangulation_covariance(self._rig, points_left, self._sigma_px)[:, 2, 2]
        H_c = self._pixel_jacobian(points_left, variance)
        observed = PredictedObservation(
            points_left, np.empty(0), H_c @ jacobian.nav @ self._model.to_map(self.nav), H_c @ jacobian.landmark
        )
        self._set(Y + _scatter_information(observed, indices, len(Y), m) / self._sigma_px**2)

    def marginalise(self, indices: Indices) -> None:
        """Take landmarks out of the state; what they taught about the rest stays."""
        keep = np.setdiff1d(np.arange(len(self.landmarks)), indices)
        m = self._model.nav_dim
        rows_keep = np.concatenate([np.arange(m), (m + 3 * keep[:, None] + np.arange(3)).ravel()])
        rows_drop = (m + 3 * np.asarray(indices)[:, None] + np.arange(3)).ravel()
        self.landmarks = self.landmarks[keep]
        self._set(marginalise_information(self.Y, rows_keep, rows_drop, "information of leaving landmarks"))

    def nav_estimate(self) -> NavEstimate:
        """Return the navigation state with its (15, 15) map-frame covariance; states a model lacks have none."""
        C, m = self._model.to_map(self.nav), self._model.nav_dim
        return NavEstimate(self.nav, symmetrise(C @ self.P[:m, :m] @ C.T))

    def pose_landmark_information(self) -> Array:
        """Return (6+3N, 6+3N) information over position, xi and landmarks, the rest of the state marginalised out."""
        m = self._model.nav_dim
        C_inv = np.linalg.inv(self._model.to_map(self.nav)[:m])
        Y = self.Y.copy()
        Y[:m, :] = C_inv.T @ Y[:m, :]
        Y[:, :m] = Y[:, :m] @ C_inv
        rows = np.arange(len(Y))
        nuisance = np.concatenate([rows[VELOCITY], rows[9:m]])
        return marginalise_information(Y, np.setdiff1d(rows, nuisance), nuisance, "information of velocity and biases")

    def _pixel_jacobian(self, points_left: Array, depth_variance: Array) -> Array:
        at = smoothed(points_left, depth_variance, depth_sigma_ratio=self._depth_sigma_ratio)
        return self._rig.project_jacobian(at)

    def _move_linearisation(self, T_map_body: Pose) -> Array:
        """Move the mean's pose and return where the prior mean lies from there."""
        before, landmarks = self.nav, self.landmarks
        self.nav = _with_pose(before, T_map_body)
        zero = np.zeros_like(landmarks)
        self._set(retangent(self.Y, self.nav.T_map_body.t - before.T_map_body.t, np.zeros(3), zero))
        return difference(self.nav, landmarks, before, landmarks)

    def _correct(self, Y: Array, delta: Array) -> None:
        before, landmarks = self.nav, self.landmarks
        self.nav, self.landmarks = self._model.retract(before, landmarks, delta)
        if self._model.invariant:
            moved_p = self.nav.T_map_body.t - before.T_map_body.t
            Y = retangent(Y, moved_p, self.nav.v_map - before.v_map, self.landmarks - landmarks)
        self._set(symmetrise(Y))

    def _set(self, Y: Array) -> None:
        self.Y, self._P = Y, None


def _with_pose(nav: NavState, T_map_body: Pose) -> NavState:
    return NavState(nav.stamp_ns, T_map_body, nav.v_map, nav.gyro_bias, nav.accel_bias)


def _scatter_information(observed: PredictedObservation, indices: Indices, size: int, m: int) -> Array:
    """Return (size, size) H^T H of all observations: dense in the vehicle, block-diagonal in the landmarks."""
    I = np.zeros((size, size))
    I[:m, :m] = np.einsum("nka,nkb->ab", observed.H_nav, observed.H_nav)
    columns = m + 3 * indices[:, None] + np.arange(3)
    cross = np.einsum("nka,nkb->nab", observed.H_nav, observed.H_landmark)
    I[:m, columns.ravel()] = cross.transpose(1, 0, 2).reshape(m, -1)
    I[columns.ravel(), :m] = I[:m, columns.ravel()].T
    I[columns[:, :, None], columns[:, None, :]] = np.einsum("nka,nkb->nab", observed.H_landmark, observed.H_landmark)
    return I


def _scatter_vector(observed: PredictedObservation, nu: Array, indices: Indices, size: int, m: int) -> Array:
    """Return (size,) H^T nu of all observations."""
    i = np.zeros(size)
    i[:m] = np.einsum("nka,nk->a", observed.H_nav, nu)
    columns = m + 3 * indices[:, None] + np.arange(3)
    i[columns] = np.einsum("nka,nk->na", observed.H_landmark, nu)
    return i
