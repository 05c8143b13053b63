# SPDX-License-Identifier: Apache-2.0
"""One filter over a vehicle and its landmarks, for every form of the belief and every linearisation.

A `JointState` is what is estimated, with the belief over its errors; a `Linearisation` supplies F, Q, H and R. The
thesis's four filters differ only in belief and linearisation:

    ekf   covariance form     Jacobians       section 4.2
    eif   information form    Jacobians       section 4.5
    ukf   square-root form    cubature        section 4.3
    uhf   as ukf, with an H-infinity bound on the navigation block, section 4.4
"""

import copy
import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from uav_vslam.config import EXACT_RIG, ImuConfig, RigConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation.belief import NO_ROWS, Belief, Indices, Observation, Update, VehicleObservation
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.h_infinity import bounded
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.estimation.iterated_update import Correction, iterated
from uav_vslam.estimation.joint_state import JointState, stamped
from uav_vslam.estimation.linearisation import (
    Camera,
    Jacobians,
    Linearisation,
    PredictedObservation,
    camera_points,
    pixel_jacobians,
)
from uav_vslam.estimation.mean import Mean
from uav_vslam.estimation.models import POSE
from uav_vslam.estimation.observation import in_left_camera, projectable, smoothed, triangulation_covariance
from uav_vslam.estimation.past_poses import COPY_VARIANCE
from uav_vslam.estimation.track_consensus import trusted
from uav_vslam.estimation.track_linearisation import LinearisedTracks, Move, fitting
from uav_vslam.estimation.tracks import Tracks, observe_tracks
from uav_vslam.estimation.turning import Gusts, Turning
from uav_vslam.estimation.weighted_update import Innovation, huber_weights, whitened
from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.stereo import STEREO_DOF, StereoRig
from uav_vslam.ins.propagation import ROTATION
from uav_vslam.numerics import submatrix, symmetrise
from uav_vslam.types import ImuIncrement, NavEstimate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FEW = 12  # landmarks that may be in a line
AMBIGUOUS_RAD = 0.1  # of an unknown tilt, and of a shift as a share of the depth


class Filter(JointState):
    """Predicts over inertial increments and updates with landmarks and tracks.

    `sigma_px`, the standard deviation of each pixel coordinate, may be set at any time.
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
        track_sigma_px: float = 1.0,
    ) -> None:
        """Start without landmarks.

        Args:
            initial: start state.
            rig: calibration.
            imu: noise.
            model: name in `models.MODELS`.
            form: of the belief.
            linearisation: default `Jacobians`.
            gamma: of the H-infinity bound; None for no bound.
            sigma_px: standard deviation of each pixel coordinate.
            depth_sigma_ratio: see `observation.smoothed`.
            robust: down-weight observations with large posterior residuals, see `weighted_update`.
            rig_config: uncertainty of the calibration; an exact one unless given.
            track_sigma_px: standard deviation of a tracked point's right pixel about the left one, see `tracks`.
        """
        super().__init__(initial, rig, model, form, rig_config or EXACT_RIG)
        self.imu, self._gamma = imu, gamma
        self._linear: Linearisation = linearisation or Jacobians()
        self.sigma_px, self._depth_sigma_ratio, self._robust = sigma_px, depth_sigma_ratio, robust
        self._turning: Turning | None = None  # at the end of the last increment
        self._gusts = Gusts()
        self.track_sigma_px = track_sigma_px
        self._of_tracks: VehicleObservation | None = None  # for the next update
        self.feasibility = np.inf  # ratio of gamma^2 to the least feasible one of the H-infinity bound

    @property
    def can_add_landmarks(self) -> bool:
        """Whether landmarks can be added.

        If the time offset is a state, their positions depend on the angular rate: it is known from the first increment
        on, whether propagated over it or given it by `starts` or `ends`.
        """
        return not self._errors.has_time_offset or self._turning is not None

    def starts(self, increment: ImuIncrement) -> None:
        """Take over how the vehicle turns at the start of an increment, where the estimate is."""
        self._turning = turning = Turning.at_start(increment, self.nav)
        parts = {"rate_map": turning.rate_map, "rate_slope_map": turning.slope_map}
        self._set_mean(past=self.past.with_newest(self.nav.stamp_ns, **parts))

    def ends(self, increment: ImuIncrement) -> None:
        """Take over how the vehicle turns at the end of an increment, where the estimate is."""
        self._turning = Turning.at_end(increment, self.nav)

    def predict(self, increment: ImuIncrement) -> None:
        """Propagate over an increment."""
        nav_dim = self._model.nav_dim
        later_s = self.rig_state.time_offset_s
        if self._turning is not None:
            self._gusts = self._gusts.added(self._turning, Turning.at_start(increment, self.nav))
        if later_s > 0.0:  # the readings at the exposure have come only now
            self.starts(increment)
        with stamped(increment.stamp_ns):
            process = self._linear.process(self._model, self.nav, self.belief, increment, self.imu)
            F, Q = np.eye(self._chart.present), np.zeros((self._chart.present, self._chart.present))
            F[:nav_dim, :nav_dim], Q[:nav_dim, :nav_dim] = process.F, process.Q
            Q[ROTATION, ROTATION] += self._gusts.rotation_variance(later_s) * np.eye(3)
            Q[self._errors.rows, self._errors.rows] = np.diag(self._errors.noise_variance(increment.dt_s))
            self.belief = self.belief.predicted(F, Q)
            if self._errors.has_vibration:
                rows = np.arange(self._errors.vibration.start, self._errors.vibration.stop)
                self.belief = self.belief.reset_rows(rows, self._errors.vibration_variance)
                self._set_mean(rig=self._errors.reset_vibration(self.rig_state))
            if self._gamma is not None:
                self.belief, self.feasibility = bounded(self.belief, self._gamma)
        self._set_mean(nav=process.nav)
        self.ends(increment)

    def keep_pose(self) -> None:
        """Keep the present pose in the state, as the newest past one; not with `euler9`."""
        self.belief = self.belief.cloned(POSE, COPY_VARIANCE)
        self._set_mean(past=self.past.followed_by(self.nav, self._turning or Turning.none()))

    def observe_tracks(
        self, tracks: Tracks, *, probability: float, become_landmarks: Mask, others: Callable[[], Tracks] | None = None
    ) -> Mask:
        """Take in tracks of points that are no landmarks; the next `update` uses what they say about the past poses.

        Args:
            tracks: pixels at the past poses, at least `tracks.MIN_VIEWS` of each.
            probability: of the chi-square gate.
            become_landmarks: (T,) whose points are appended to the landmarks, if they pass the gate.
            others: makes tracks that only help to find the wrong ones, see `track_consensus`.

        Returns:
            (T,) which have passed.
        """
        if len(tracks) == 0:
            return np.zeros(0, bool)
        with stamped(self.nav.stamp_ns):
            P, first = self.belief.covariance(NO_ROWS), self._linearised_tracks(tracks, self.mean)
            passed = trusted(
                first.seen,
                (lambda: self._linearised_tracks(others(), self.mean).seen) if others else None,
                submatrix(P, first.rows),
                probability,
            )
            if not passed.any():
                return passed
            passed, linearised, said = fitting(
                first, passed, P, lambda delta: self._linearised_tracks_at(tracks, delta), probability
            )
            if passed.any():
                self._of_tracks = said
                self._append_points(linearised, passed & become_landmarks)
        return passed

    def _linearised_tracks(self, tracks: Tracks, mean: Mean) -> LinearisedTracks:
        """Linearise tracks at a mean."""
        past, rig = mean.past.at_exposure(mean.rig.time_offset_s), self._rig_with(mean.rig)
        sigma_px = self.sigma_px if tracks.detected else self.track_sigma_px
        seen = observe_tracks(tracks, past, rig=rig, errors=self._errors, sigma_px=sigma_px)
        return LinearisedTracks(seen, np.r_[self._errors.rows, self._chart.past(mean)], self.vehicle)

    def _linearised_tracks_at(self, tracks: Tracks, delta: Array) -> LinearisedTracks:
        """Linearise tracks where (vehicle,) `delta` moves the mean."""
        move = Move.by(delta, self.mean.without_landmarks(), self._chart)
        return dataclasses.replace(self._linearised_tracks(tracks, move.after), move=move)

    @property
    def has_tracks(self) -> bool:
        """Whether tracks are waiting for the next update."""
        return self._of_tracks is not None

    def with_tracks(
        self, tracks: Tracks, *, probability: float, become_landmarks: Mask
    ) -> tuple[Self, Mask, Innovation]:
        """Return a copy of this filter that has used tracks, see `observe_tracks`, and its innovation.

        For tracks that go on: the copy is the best estimate of the present, while here they can be used once they are
        complete.
        """
        other = copy.copy(self)
        passed = other.observe_tracks(tracks, probability=probability, become_landmarks=become_landmarks)
        return other, passed, other.update(NO_ROWS, np.zeros((0, STEREO_DOF)))

    def without_landmarks(self) -> Self:
        """Return a copy of the vehicle alone: with its marginal covariance, an update costs nothing for landmarks."""
        other = copy.copy(self)
        with stamped(self.nav.stamp_ns):
            other.belief = CovarianceBelief(self.belief.covariance(NO_ROWS), self.vehicle)
        other.mean = self.mean.without_landmarks()
        return other

    def points_left(self) -> Array:
        """Return the (N, 3) landmarks in the left camera frame [m]."""
        return in_left_camera(self.rig, self._camera().nav, self.landmarks)

    def predict_observations(self, landmarks: Indices) -> PredictedObservation:
        """Predict stereo observations of landmarks; they must be projectable."""
        with stamped(self.nav.stamp_ns):
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
        """Update with stereo observations of landmarks, linearised again where they move the mean far.

        While the tilt is unknown, as after a second without IMU readings, a few landmarks that lead far are rejected:
        seven in a line may put the vehicle 33 m away, at a tilt that fits as well, with a sigma of 0.3 m.

        Args:
            landmarks: (M,) rows of `landmarks`, each at most once.
            pixels: (M, 4) undistorted stereo pixels.
            linearise_at: T_map_body to linearise at instead of the mean, for a mean known to be far off; no effect on
                a model that is not invariant. The prior is then too wide to regress over, so regression uses the
                posterior, as in [garcia15].
            significance: probability with which a correct set of observations is rejected.
            weights: (M,) divide the noise variance; None for ones.
        """
        weights = np.ones(len(landmarks)) if weights is None else weights
        with stamped(self.nav.stamp_ns):
            found = self._correction(landmarks, pixels, weights, linearise_at)
            if self._of_tracks is None and self._model.invariant and len(landmarks):
                found = iterated(
                    found,
                    depth_m=self._depth_m(landmarks),
                    leads_to=self._leads_to,
                    correct=lambda at: self._correction(landmarks, pixels, weights, at),
                    cost=lambda other: self._cost(other, landmarks, pixels),
                )
            dof = STEREO_DOF * len(landmarks) + (0 if self._of_tracks is None else self._of_tracks.dof)
            accepted = dof == 0 or bool(chdtrc(dof, found.update.nis) >= significance)
            if self._of_tracks is None and 0 < len(landmarks) < FEW:
                accepted = accepted and not self._is_ambiguous(found, landmarks)
            if accepted:
                self._of_tracks = None
                self._apply(found)
        return Innovation(found.update.nis, dof, accepted, found.outliers)

    def _correction(self, landmarks: Indices, pixels: Array, weights: Array, at: Pose | None) -> Correction:
        """Return an update that is not applied, linearised at a pose; None for the mean."""
        before = (self.mean, self.belief)
        try:
            prior, predicted = self._linearised(landmarks, at)
            nu = pixels - predicted.expected
            observation = Observation(landmarks, predicted.H_vehicle, predicted.H_landmark, nu)
            update, outliers = self._updated(predicted, nu - observation.apply(prior), weights)
            return Correction(self.mean, prior + update.delta, update, outliers, observation, predicted.R, weights)
        finally:
            self.mean, self.belief = before

    def _apply(self, found: Correction) -> None:
        """Move the mean and set the belief."""
        self.mean = found.mean
        self.correct(found.update.belief, found.delta)

    def _leads_to(self, found: Correction) -> Pose:
        """Return T_map_body after an update."""
        nav, _ = self._model.retract(found.mean.nav, np.zeros((0, 3)), found.delta[: self._model.nav_dim])
        return nav.T_map_body

    def _depth_m(self, landmarks: Indices) -> float:
        """Return the median depth of some landmarks in the left camera [m]."""
        return float(np.median(self.points_left()[landmarks, 2]))

    def _is_ambiguous(self, found: Correction, landmarks: Indices) -> bool:
        """Return whether an update shifts the position by what might as well be a tilt, which is unknown."""
        tilt_rad = np.sqrt(np.diagonal(self.belief.covariance(NO_ROWS))[ROTATION][:2].max())
        shift_m = float(np.linalg.norm(self._leads_to(found).t - self.nav.T_map_body.t))
        return bool(tilt_rad > AMBIGUOUS_RAD and shift_m > AMBIGUOUS_RAD * self._depth_m(landmarks))

    def _cost(self, found: Correction, landmarks: Indices, pixels: Array) -> float:
        """Return what an update leaves of squared errors, those of the prior included; infinite if that diverges."""
        other = copy.copy(self)
        try:
            other._apply(found)
            return found.cost(pixels - other._predicted(landmarks, other.belief).expected)
        except (FilterDivergence, np.linalg.LinAlgError):
            return np.inf

    def _linearised(self, landmarks: Indices, at: Pose | None) -> tuple[Array, PredictedObservation]:
        """Move the linearisation point, if wished; return the prior mean as an error from it, and the prediction."""
        if at is None or not self._model.invariant:
            return np.zeros(self.belief.size), self._predicted(landmarks, self.belief)
        self._of_tracks = None  # linearised elsewhere, at a pose known to be far off
        prior = self._move_linearisation(self.mean.at(at))
        return prior, self._predicted(landmarks, self._belief_for_regression(landmarks))

    def update_with_points(
        self, points: Tracks, landmarks: Indices, pixels: Array, *, at: Mean, weights: Array, probability: float
    ) -> Mask:
        """Update with landmarks and with points that are landmarks from here on, all linearised at other poses.

        Args:
            points: T tracks, whose pixels at the past poses include the present one's.
            landmarks, pixels, weights: see `update`.
            at: has the poses, the present one and those past.
            probability: of the chi-square gate of each point's views.

        Returns:
            (T,) which have passed: these are appended to the landmarks, the others are not used.
        """
        with stamped(self.nav.stamp_ns):
            prior = self._move_linearisation(self.mean.at_poses_of(at))
            tracks = self._linearised_tracks(points, self.mean)
            P = submatrix(self.belief.covariance(NO_ROWS), tracks.rows)
            passed, _ = tracks.seen.gated(P, probability, mean=prior[tracks.rows])
            self._of_tracks = tracks.of_vehicle(passed).about(-prior[: self.vehicle])
            predicted = self._predicted(landmarks, self._belief_for_regression(landmarks))
            observation = Observation(landmarks, predicted.H_vehicle, predicted.H_landmark, pixels - predicted.expected)
            update, _ = self._updated(predicted, observation.nu - observation.apply(prior), weights)
            self._of_tracks = None
            self.correct(update.belief, prior + update.delta)
            there = self._linearised_tracks(points, self.mean)
            passed &= there.seen.good
            self._append_points(there, passed)
        return passed

    def _append_points(self, tracks: LinearisedTracks, which: Mask) -> None:
        """Append the points of some tracks to the landmarks."""
        points, H, R = tracks.of_points(which)
        self.belief = self.belief.appended(H, R)
        self._set_mean(landmarks=np.vstack([self.landmarks, points]))

    def add_landmarks(self, pixels: Array) -> Mask:
        """Append landmarks at their triangulated positions; see `can_add_landmarks`.

        The four pixel coordinates are projected to the three that determine the point; the fourth, the epipolar error,
        is unused.

        Args:
            pixels: (M, 4) undistorted stereo pixels.

        Returns:
            (M,) which of them triangulate; the others make no landmark.
        """
        camera = self._camera()
        points_left = camera.rig.triangulate(pixels)
        triangulated = np.asarray(np.isfinite(points_left).all(axis=1))
        points_left = points_left[triangulated]
        sigma_px = self.sigma_px * camera.rig.magnification(pixels[triangulated])
        T_map_left = camera.nav.T_map_body @ camera.rig.T_body_left
        landmarks = T_map_left.apply(points_left)
        _, J_vehicle, J_landmark = camera_points(camera, landmarks)
        at = smoothed(
            points_left,
            triangulation_covariance(camera.rig, points_left, self.sigma_px)[:, 2, 2],
            depth_sigma_ratio=self._depth_sigma_ratio,
            known=partial(self._in_view, camera),
        )
        H_vehicle, H_landmark = pixel_jacobians(camera, points_left, at, J_vehicle, J_landmark)
        kept = np.linalg.qr(H_landmark).Q.transpose(0, 2, 1) / sigma_px[:, None, None]
        self.belief = self.belief.appended(kept @ H_vehicle, kept @ H_landmark)
        self._set_mean(landmarks=np.vstack([self.landmarks, landmarks]))
        return triangulated

    def _in_view(self, camera: Camera) -> tuple[Array, Array]:
        """Return the (K, 3) landmarks in view in the left camera frame [m], and the variances of their depths [m^2].

        Those are what one view tells.
        """
        known = self.points_left()
        known = known[projectable(camera.rig, known)]
        return known, triangulation_covariance(camera.rig, known, self.sigma_px)[:, 2, 2]

    def _predicted(self, landmarks: Indices, belief: Belief) -> PredictedObservation:
        return self._linear.observation(
            self._camera(), landmarks, self.landmarks[landmarks], belief.marginals(landmarks)
        )

    def _belief_for_regression(self, landmarks: Indices) -> Belief:
        """Return the posterior after observations of some landmarks, linearised by Jacobians."""
        if not self._linear.regresses:
            return self.belief
        marginals, M = self.belief.marginals(landmarks), len(landmarks)
        first = Jacobians().observation(self._camera(), landmarks, self.landmarks[landmarks], marginals)
        return self.belief.updated(whitened(first, np.zeros((M, STEREO_DOF)), np.ones(M))).belief

    def _camera(self) -> Camera:
        turning = self._turning or Turning.none()
        return Camera(
            rig=self.rig,
            errors=self._errors,
            model=self._model,
            nav=self._errors.at_exposure(self.rig_state, self.nav, turning),
            rate_map=turning.rate(self.rig_state.time_offset_s),
            sigma_px=self.sigma_px,
            depth_sigma_ratio=self._depth_sigma_ratio,
            past_rows=POSE_DIM * len(self.past),
        )

    def _updated(self, predicted: PredictedObservation, nu: Array, weights: Array) -> tuple[Update, Indices]:
        """Update, and once more with Huber's weights if there are large posterior residuals; return their rows."""
        observation = whitened(predicted, nu, weights, of_vehicle=self._of_tracks)
        update = self.belief.updated(observation)
        huber = huber_weights(observation, update.delta) if self._robust else np.ones(len(nu))
        if not (huber < 1.0).any():
            return update, NO_ROWS
        observation = whitened(predicted, nu, huber * weights, of_vehicle=self._of_tracks)
        return self.belief.updated(observation), np.flatnonzero(huber < 1.0)
