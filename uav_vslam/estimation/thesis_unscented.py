# SPDX-License-Identifier: Apache-2.0
"""The unscented filters as given in chapter 4 of [thesis]: baselines that show why ours differ.

Sigma points span the whole state with kappa = 3 - n (Eq. 4.3.3), so the centre's weight is (3 - n)/3: strongly
negative with landmarks. The transform's covariance is a positive part plus (beta - alpha^2) s s^T, with s the shift of
the mean: with beta = 2 it stays definite, with beta < alpha^2 it may not. The bound of Eq. (4.4.4) makes it indefinite
wherever an eigenvalue exceeds gamma^2. The remedies are the thesis's (section 4.8): "diagonal loading", and where that
does not help, the square root by singular values, which are the absolute values of the eigenvalues. The filter then
goes on with a covariance that no longer bounds its error. It raises `FilterDivergence` if a sigma point, up to sqrt(3)
sigmas away, puts an uncertain landmark behind the camera.

Symbols: chi sigma points as errors from the mean, W weights, D deviations from the weighted mean (rows are points).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import RigConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation.belief import NO_ROWS, Indices, Update, landmark_rows
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.linearisation import PredictedObservation, perturbed_points
from uav_vslam.estimation.models import POSE
from uav_vslam.geometry.stereo import STEREO_DOF
from uav_vslam.ins.propagation import propagate, transition
from uav_vslam.numerics import is_positive_definite, symmetrise
from uav_vslam.types import ImuIncrement, NavEstimate

Array = NDArray[np.float64]

SPREAD = np.sqrt(3.0)  # eta = sqrt(n + lambda), with alpha = 1
BETA = 2.0
LOADING = (0.0, 1e-12, 1e-9, 1e-6)  # tried in order: shares of the largest variance added to the diagonal


class ThesisUnscentedFilter(Filter):
    """Eq. (4.3.5) to (4.3.7); with `gamma` the updated covariance follows Eq. (4.4.4) instead."""

    def __init__(self, initial: NavEstimate, *, rig_config: RigConfig | None = None, **options: Any) -> None:
        """As `Filter`, but `rig_config` is ignored and the rig taken as exact: the thesis has no states for it."""
        super().__init__(initial, **options)

    def predict(self, increment: ImuIncrement) -> None:
        chi, mean_weights, weights = self._sigma_points()
        nav_dim, none = self._model.nav_dim, np.zeros((0, 3))
        centre = propagate(self.nav, increment, gravity=self.imu.gravity)
        ends = chi.copy()
        for row in np.flatnonzero(chi[:, :nav_dim].any(axis=1)):
            start, _ = self._model.retract(self.nav, none, chi[row, :nav_dim])
            moved = propagate(start, increment, gravity=self.imu.gravity)
            ends[row, :nav_dim] = self._model.local(centre, moved)
        shift = mean_weights @ ends
        D = ends - shift
        P = (D.T * weights) @ D
        _, Q = transition(self.nav, increment, self.imu)
        nav, landmarks = self._model.retract(centre, self.landmarks, shift)
        self._set_mean(nav=nav, landmarks=landmarks)
        from_map = self._model.from_map(self.nav)
        P[:nav_dim, :nav_dim] += from_map @ Q @ from_map.T
        self.belief = CovarianceBelief(definite(symmetrise(P)), self.vehicle)

    def _updated(
        self, predicted: PredictedObservation, nu: Array, observation_weights: Array
    ) -> tuple[Update, Indices]:
        chi, mean_weights, weights = self._sigma_points()
        P = self.covariance()
        seen = self._project(chi, predicted) / self.sigma_px
        expected = mean_weights @ seen
        D_y, D_x = seen - expected, chi - mean_weights @ chi
        P_yy, P_xy = (D_y.T * weights) @ D_y, (D_x.T * weights) @ D_y
        innovation = (nu + predicted.expected).ravel() / self.sigma_px - expected
        S = P_yy + np.diag(1.0 / np.repeat(observation_weights, STEREO_DOF))
        K = np.linalg.solve(S, P_xy.T).T
        after = symmetrise(P - K @ S @ K.T)
        if self._gamma is not None:
            after = bounded(after, self._gamma)
        nis = float(innovation @ np.linalg.solve(S, innovation))
        belief = CovarianceBelief(definite(after), self.vehicle)
        return Update(belief, K @ innovation, nis), NO_ROWS

    def _sigma_points(self) -> tuple[Array, Array, Array]:
        """Return chi (2n+1, n) and the weights of mean and covariance; Eq. (4.3.2)."""
        L = np.linalg.cholesky(definite(self.covariance()))
        n = len(L)
        chi = np.vstack([np.zeros(n), SPREAD * L.T, -SPREAD * L.T])
        mean_weights = np.full(2 * n + 1, 1.0 / (2.0 * SPREAD**2))
        mean_weights[0] = (SPREAD**2 - n) / SPREAD**2
        weights = mean_weights.copy()
        weights[0] += BETA
        return chi, mean_weights, weights

    def _project(self, chi: Array, predicted: PredictedObservation) -> Array:
        """Return (2n+1, 4M) pixels of the observed landmarks at each sigma point."""
        camera = self._camera()
        own = chi[:, landmark_rows(self.vehicle, predicted.landmarks)].reshape(len(chi), -1, 3)
        points_left = perturbed_points(camera, self.landmarks[predicted.landmarks], chi[:, None, POSE], own)
        if points_left[..., 2].min(initial=np.inf) <= 0.0:
            raise FilterDivergence("a sigma point puts a landmark behind the camera")
        return np.asarray(camera.rig.project(points_left).reshape(len(chi), -1))


def definite(P: Array) -> Array:
    """Return P if it has a Cholesky factor, else with diagonal loading, else from its singular values.

    P = U D V^T is symmetric, so U D U^T has the same eigenvectors and the absolute values of the eigenvalues.
    """
    if not np.isfinite(P).all():
        raise FilterDivergence(f"covariance of {len(P)} rows is not finite")
    loaded = _loaded(P)
    if loaded is None:
        U, D, _ = np.linalg.svd(P)
        loaded = _loaded(symmetrise((U * D) @ U.T))
    if loaded is None:
        raise FilterDivergence(f"covariance of {len(P)} rows has no square root")
    return loaded


def _loaded(P: Array) -> Array | None:
    """Return P with the smallest diagonal loading that gives it a Cholesky factor; None if none does."""
    for share in LOADING:
        loaded = P + share * np.abs(np.diagonal(P)).max() * np.eye(len(P)) if share else P
        if is_positive_definite(loaded):
            return loaded
    return None


def bounded(P: Array, gamma: float) -> Array:
    """Return Eq. (4.4.4) for a covariance P updated by Eq. (4.3.7): P + P (gamma^2 I - P)^-1 P.

    This is the Schur complement of the equation's first block, P_yy + R, in its block matrix, which leaves the limit
    gamma -> infinity, P itself, free of cancellation. It equals (P^-1 - gamma^-2 I)^-1: an eigenvalue above gamma^2
    turns negative.
    """
    return symmetrise(P + P @ np.linalg.solve(gamma**2 * np.eye(len(P)) - P, P))
