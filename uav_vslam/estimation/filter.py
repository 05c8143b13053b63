# SPDX-License-Identifier: Apache-2.0
"""One filter over a vehicle and its landmarks, whatever form its belief is kept in and however things are made linear.

The mean (navigation state, rig errors, landmarks) lives on a manifold and is kept here; a `Belief` holds the Gaussian
over its errors; a `Linearisation` supplies F, Q, H and R. The thesis's four filters differ in these two alone:

    ekf   covariance form     Jacobians       section 4.2
    eif   information form    Jacobians       section 4.5
    ukf   square-root form    cubature        section 4.3
    uhf   as ukf, and the navigation block bounded in the H-infinity sense, section 4.4
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from uav_vslam.config import ImuConfig, RigConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation.belief import Belief, Indices, Observation, Update
from uav_vslam.estimation.h_infinity import bounded
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.estimation.linearisation import (
    Camera,
    Jacobians,
    Linearisation,
    PredictedObservation,
    camera_points,
    pixel_jacobians,
)
from uav_vslam.estimation.models import MODELS, POSE, StateModel, difference, shear
from uav_vslam.estimation.observation import smoothed, triangulation_covariance
from uav_vslam.estimation.rig_errors import RigErrors, RigState
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.propagation import ROTATION
from uav_vslam.numerics import cholesky, symmetrise
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate, NavState

Array = NDArray[np.float64]

STEREO_DOF = 4
NOTHING_LEARNT = 1e-6  # share of the prior variance: below it, the data say nothing about the rig in that direction
HUBER_PROBABILITY = 0.999  # a right observation is weighed down as rarely as 1 minus this


@dataclass(frozen=True, slots=True)
class Innovation:
    """How an update agreed with the prediction.

    Attributes:
        nis: nu^T S^-1 nu, chi-square with `dof` degrees of freedom.
        dof: pixel coordinates.
        log_likelihood: of the observation, given all before.
        accepted: an update that was not has changed nothing.
        weighed_down: landmarks that a robust kernel trusted less.
    """

    nis: float
    dof: int
    log_likelihood: float = 0.0
    accepted: bool = True
    weighed_down: int = 0


class Filter:
    """The filter; `nav`, `rig_state` and `landmarks` (N, 3) are its mean, `belief` the Gaussian over their errors.

    Rows of the error: navigation state in the model's coordinates, rig errors, landmarks (map frame).
    """

    def __init__(
        self,
        initial: NavEstimate,
        *,
        rig: StereoRig,
        imu: ImuConfig,
        model: str = "ri15",
        form: type[Belief] = InformationBelief,
        linearisation: Linearisation | None = None,
        gamma: float | None = None,
        sigma_px: float = 1.0,
        depth_sigma_ratio: float = 0.0,
        robust: bool = False,
        rig_config: RigConfig | None = None,
    ) -> None:
        """Start without landmarks.

        Args:
            initial: start state.
            rig: calibration.
            imu: noise.
            model: name in `models.MODELS`.
            form: of the belief.
            linearisation: Jacobians unless given.
            gamma: of the H-infinity bound; None for none.
            sigma_px: standard deviation of each pixel coordinate.
            depth_sigma_ratio: see `observation.smoothed`.
            robust: weigh observations down that fit badly after the update, as [huber64] does.
            rig_config: how far the rig is trusted; wholly unless given.
        """
        self._imu, self._gamma = imu, gamma
        self._linear: Linearisation = linearisation or Jacobians()
        self._model: StateModel = MODELS[model]()
        self._errors = RigErrors(rig, rig_config or RigConfig(rigid_sigma_deg=0.0), self._model.nav_dim)
        self._sigma_px, self._depth_sigma_ratio, self._robust = sigma_px, depth_sigma_ratio, robust
        self._rate_map: Array | None = None  # [rad/s] at the end of the last increment
        self.nav: NavState = initial.state
        self.rig_state = RigState()
        self._rig_at, self._rig = self.rig_state, self._errors.rig(self.rig_state)
        self.landmarks: Array = np.zeros((0, 3))
        C = self._model.from_map(initial.state)
        self.belief: Belief = form.from_covariance(self._with_rig_prior(C @ initial.covariance @ C.T))
        self.feasibility = np.inf  # how far gamma^2 lies above what the H-infinity bound needs at least

    @property
    def rig(self) -> StereoRig:
        """The rig with its estimated errors."""
        if self._rig_at is not self.rig_state:  # asked for a dozen times a frame, and dear
            self._rig_at, self._rig = self.rig_state, self._errors.rig(self.rig_state)
        return self._rig

    @property
    def vehicle(self) -> int:
        """Rows of the error that are the vehicle's."""
        return self._model.nav_dim + self._errors.dim

    @property
    def places_landmarks(self) -> bool:
        """Tell whether landmarks can be added.

        Where the time offset is a state, not before the first increment: where they lie depends on how fast the vehicle
        turned when they were seen.
        """
        return self._rate_map is not None or self._errors.time_offset.start == self._errors.time_offset.stop

    def covariance(self) -> Array:
        """Return (vehicle + 3N, vehicle + 3N), the whole covariance in the model's coordinates."""
        return self.belief.covariance(np.arange(len(self.landmarks))).copy()

    def predict(self, increment: ImuIncrement) -> None:
        """Propagate over an increment."""
        nav_dim = self._model.nav_dim
        with _stamped(increment.stamp_ns):
            process = self._linear.process(self._model, self.nav, self.belief, increment, self._imu)
            F, Q = np.eye(self.vehicle), np.zeros((self.vehicle, self.vehicle))
            F[:nav_dim, :nav_dim], Q[:nav_dim, :nav_dim] = process.F, process.Q
            Q[self._errors.rows, self._errors.rows] = np.diag(self._errors.noise_variance(increment.dt_s))
            self.belief = self.belief.predicted(F, Q)
            if self._errors.vibration_variance > 0:
                rows = np.arange(self._errors.vibration.start, self._errors.vibration.stop)
                self.belief = self.belief.reset_rows(rows, self._errors.vibration_variance)
                self.rig_state = self._errors.renew(self.rig_state)
            if self._gamma is not None:
                self.belief, self.feasibility = bounded(self.belief, nav_dim, self._gamma)
        self.nav = process.nav
        self._rate_map = self.nav.T_map_body.R @ (increment.rate_end - self.nav.gyro_bias)

    def points_left(self) -> Array:
        """Return the (N, 3) landmarks in the left camera frame [m]."""
        return camera_points(self._camera(), self.landmarks)[0]

    def predict_observations(self, landmarks: Indices) -> PredictedObservation:
        """Return what should be seen of the chosen landmarks; they must be projectable."""
        with _stamped(self.nav.stamp_ns):
            return self._predicted(landmarks, self.belief)

    def joint_innovation(self, landmarks: Indices, pixels: Array) -> tuple[Array, Array]:
        """Return the innovations (M, 4) of stereo observations and their joint covariance (4M, 4M) [px], [px^2]."""
        predicted = self.predict_observations(landmarks)
        m, count = self.vehicle, len(landmarks)
        H = np.zeros((count, 4, m + 3 * count))
        H[:, :, :m] = predicted.H_vehicle
        own = m + np.arange(3 * count).reshape(count, 1, 3)
        H[np.arange(count)[:, None, None], np.arange(4)[:, None], own] = predicted.H_landmark
        H_all = H.reshape(4 * count, m + 3 * count)
        S = H_all @ self.belief.covariance(landmarks) @ H_all.T
        S.reshape(count, 4, count, 4)[np.arange(count), :, np.arange(count)] += predicted.R
        return pixels - predicted.expected, symmetrise(S)

    def update(
        self,
        landmarks: Indices,
        pixels: Array,
        *,
        linearise_at: Pose | None = None,
        significance: float = 0.0,
        weights: Array | None = None,
    ) -> Innovation:
        """Correct by stereo observations of landmarks.

        Args:
            landmarks: (M,) rows of `landmarks`, each at most once.
            pixels: (M, 4) undistorted stereo pixels.
            linearise_at: T_map_body where to linearise instead of at the mean; for a mean known to be far off. No line
                fits over the belief of so vague a mean, so a regression is made over what the update will leave of it,
                as in [garcia15].
            significance: the update is refused if right observations were as far off together with less probability.
            weights: (M,) by which the noise's variance is divided; None for ones.
        """
        before = (self.nav, self.belief)
        prior = np.zeros(self.belief.size)
        with _stamped(self.nav.stamp_ns):
            if linearise_at is not None and self._model.invariant:
                prior = self._move_linearisation(linearise_at)
                predicted = self._predicted(landmarks, self._belief_to_regress_over(landmarks))
            else:
                predicted = self._predicted(landmarks, self.belief)
            nu = pixels - predicted.expected
            nu = nu - Observation(landmarks, predicted.H_vehicle, predicted.H_landmark, nu).apply(prior)
            update, weights, weighed_down = self._updated(
                predicted, nu, np.ones(len(nu)) if weights is None else weights
            )
        dof = STEREO_DOF * len(landmarks)
        log_det_R = float(np.linalg.slogdet(predicted.R)[1].sum() - STEREO_DOF * np.log(weights).sum())
        innovation = Innovation(
            nis=update.nis,
            dof=dof,
            log_likelihood=-0.5 * (update.nis + update.log_det + log_det_R + dof * np.log(2.0 * np.pi)),
            accepted=dof == 0 or bool(chdtrc(dof, update.nis) >= significance),
            weighed_down=weighed_down,
        )
        if innovation.accepted:
            with _stamped(self.nav.stamp_ns):
                self.correct(update.belief, prior + update.delta)
        else:
            self.nav, self.belief = before
        return innovation

    def add_landmarks(self, pixels: Array) -> None:
        """Append landmarks at their triangulated positions; see `places_landmarks`.

        The four pixel coordinates are reduced to the three that the point follows; the fourth, off the epipolar line,
        is left unused.

        Args:
            pixels: (M, 4) undistorted stereo pixels that triangulate to finite points.
        """
        camera = self._camera()
        points_left = camera.rig.triangulate(pixels)
        T_map_left = camera.nav.T_map_body @ camera.rig.T_body_left
        landmarks = T_map_left.apply(points_left)
        _, J_vehicle, J_landmark = camera_points(camera, landmarks)
        variance = triangulation_covariance(camera.rig, points_left, self._sigma_px)[:, 2, 2]
        at = smoothed(points_left, variance, depth_sigma_ratio=self._depth_sigma_ratio)
        H_vehicle, H_landmark = pixel_jacobians(camera, points_left, at, J_vehicle, J_landmark)
        kept = np.linalg.qr(H_landmark).Q.transpose(0, 2, 1) / self._sigma_px
        self.belief = self.belief.appended(kept @ H_vehicle, kept @ H_landmark)
        self.landmarks = np.vstack([self.landmarks, landmarks])

    def marginalise(self, landmarks: Indices) -> None:
        """Take landmarks out of the state; what they taught about the rest stays."""
        with _stamped(self.nav.stamp_ns):
            self.belief = self.belief.marginalised(landmarks)
        self.landmarks = np.delete(self.landmarks, landmarks, axis=0)

    def nav_estimate(self) -> NavEstimate:
        """Return the navigation state with its (15, 15) map-frame covariance; states a model lacks have none.

        Raises:
            FilterDivergence: the covariance is not positive definite.
        """
        C, nav_dim = self._model.to_map(self.nav), self._model.nav_dim
        with _stamped(self.nav.stamp_ns):
            P = self.belief.covariance(np.zeros(0, np.int64))[:nav_dim, :nav_dim]
            cholesky(P, "covariance of the navigation state")
        return NavEstimate(self.nav, symmetrise(C @ P @ C.T))

    def pose_landmark_information(self) -> Array:
        """Return (6+3N, 6+3N) information over position, xi and landmarks, the rest of the state marginalised out."""
        nav_dim, m = self._model.nav_dim, self.vehicle
        C = np.eye(m)
        C[:nav_dim, :nav_dim] = self._model.to_map(self.nav)[:nav_dim]
        rows = np.concatenate([POSE, np.arange(m, self.belief.size)])
        with _stamped(self.nav.stamp_ns):
            return self.belief.predicted(C, np.zeros((m, m))).information(rows)

    def rig_evidence(self) -> float:
        """Return how strongly the data speak against the calibrated attitude, chi-square with 3 degrees of freedom.

        If the prior was right, the estimate a has covariance P_0 - P. Zero where the attitude is not a state.
        """
        rows = self._errors.attitude
        if rows.stop == rows.start:
            return 0.0
        prior = np.diag(self._errors.prior_variance[: rows.stop - rows.start])
        learnt = prior - self.belief.covariance(np.zeros(0, np.int64))[rows, rows]
        values, vectors = np.linalg.eigh(symmetrise(learnt))
        along = vectors.T @ self.rig_state.attitude
        known = values > NOTHING_LEARNT * prior[0, 0]
        return float(np.sum(along[known] ** 2 / values[known]))

    def _predicted(self, landmarks: Indices, belief: Belief) -> PredictedObservation:
        return self._linear.observation(
            self._camera(), landmarks, self.landmarks[landmarks], belief.marginals(landmarks)
        )

    def _belief_to_regress_over(self, landmarks: Indices) -> Belief:
        """Return the belief that observations of some landmarks will leave, by their Jacobians."""
        if not self._linear.regresses:
            return self.belief
        marginals, M = self.belief.marginals(landmarks), len(landmarks)
        first = Jacobians().observation(self._camera(), landmarks, self.landmarks[landmarks], marginals)
        return self.belief.updated(_whitened(first, np.zeros((M, STEREO_DOF)), np.ones(M))).belief

    def _camera(self) -> Camera:
        rate_map = np.zeros(3) if self._rate_map is None else self._rate_map
        return Camera(
            rig=self.rig,
            errors=self._errors,
            model=self._model,
            nav=self._errors.at_exposure(self.rig_state, self.nav, rate_map),
            rate_map=rate_map,
            sigma_px=self._sigma_px,
            depth_sigma_ratio=self._depth_sigma_ratio,
        )

    def _updated(self, predicted: PredictedObservation, nu: Array, weights: Array) -> tuple[Update, Array, int]:
        """Update, and once more with less weight on what fits badly afterwards.

        Return the update, its (M,) weights, and how many fitted badly.
        """
        observation = _whitened(predicted, nu, weights)
        update = self.belief.updated(observation)
        if not self._robust or not len(nu):
            return update, weights, 0
        left = np.linalg.norm(observation.nu - observation.apply(update.delta), axis=1)
        trust = np.minimum(1.0, np.sqrt(chdtri(STEREO_DOF, 1.0 - HUBER_PROBABILITY)) / np.maximum(left, 1e-12))
        if (trust < 1.0).any():
            weights = trust * weights
            update = self.belief.updated(_whitened(predicted, nu, weights))
        return update, weights, int((trust < 1.0).sum())

    def _with_rig_prior(self, P_nav: Array) -> Array:
        nav_dim = self._model.nav_dim
        P = np.zeros((self.vehicle, self.vehicle))
        P[:nav_dim, :nav_dim] = symmetrise(P_nav)
        P[nav_dim:, nav_dim:] = np.diag(self._errors.prior_variance)
        return P

    def _move_linearisation(self, T_map_body: Pose) -> Array:
        """Move the mean's pose and return where the prior mean lies from there."""
        before = self.nav
        self.nav = dataclasses.replace(before, T_map_body=T_map_body)
        B = shear(self.vehicle, T_map_body.t - before.T_map_body.t, np.zeros(3), np.zeros_like(self.landmarks))
        self.belief = self.belief.coordinates_changed(B, ROTATION)
        offset = difference(self.nav, self.landmarks, before, self.landmarks)
        nav_dim = self._model.nav_dim
        return np.concatenate([offset[:nav_dim], np.zeros(self._errors.dim), offset[nav_dim:]])

    def correct(self, belief: Belief, delta: Array) -> None:
        """Move the mean by (vehicle + 3N,) `delta` and take over a belief about the error that is left."""
        before, landmarks = self.nav, self.landmarks
        on_manifold = np.delete(delta, np.arange(self._errors.rows.start, self._errors.rows.stop))
        self.nav, self.landmarks = self._model.retract(before, landmarks, on_manifold)
        self.rig_state = self._errors.retract(self.rig_state, delta)
        if self._model.invariant:
            moved_p = self.nav.T_map_body.t - before.T_map_body.t
            B = shear(self.vehicle, moved_p, self.nav.v_map - before.v_map, self.landmarks - landmarks)
            belief = belief.coordinates_changed(B, ROTATION)
        self.belief = belief


def _whitened(predicted: PredictedObservation, nu: Array, weights: Array) -> Observation:
    """Return the observation with unit noise: divided by the factor of R, times the root of its weight."""
    L_inv = np.linalg.inv(np.linalg.cholesky(predicted.R)) * np.sqrt(weights)[:, None, None]
    return Observation(
        predicted.landmarks,
        L_inv @ predicted.H_vehicle,
        L_inv @ predicted.H_landmark,
        np.einsum("nij,nj->ni", L_inv, nu),
    )


class _stamped:
    """Adds the time to a `FilterDivergence`; a matrix that numpy can't factor or invert is one too."""

    def __init__(self, stamp_ns: int) -> None:
        self._stamp_ns = stamp_ns

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, FilterDivergence | np.linalg.LinAlgError):
            raise FilterDivergence(f"at {self._stamp_ns / NS_PER_S:.3f} s: {error}") from error
