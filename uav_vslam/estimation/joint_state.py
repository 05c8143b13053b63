# SPDX-License-Identifier: Apache-2.0
"""What is estimated of a vehicle, its rig and its landmarks, and all that takes no measurement.

A `Mean` is what is estimated; a `Belief` holds the Gaussian over its errors, in the coordinates of a `Chart`. `Filter`
adds prediction and updates.
"""

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import RigConfig
from uav_vslam.errors import CalibrationError, FilterDivergence
from uav_vslam.estimation.belief import NO_ROWS, Belief, Indices
from uav_vslam.estimation.disparity_prior import DisparityPrior
from uav_vslam.estimation.mean import Chart, Mean
from uav_vslam.estimation.models import MODELS, POSE, StateModel
from uav_vslam.estimation.past_poses import PastPoses
from uav_vslam.estimation.rig_belief import (
    DisparityEstimate,
    TimeOffset,
    claimed_belief,
    claimed_covariance,
    claimed_variance,
    disparity_variance,
    rig_evidence,
)
from uav_vslam.estimation.rig_errors import RigErrors, RigState
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.numerics import cholesky, submatrix, symmetrise
from uav_vslam.types import NS_PER_S, NavEstimate, NavState, PoseEstimate

Array = NDArray[np.float64]

PRIOR_TOLERANCE = 0.1  # of the logarithm of the disparity's variance a priori, before it is exchanged


class JointState:
    """`belief` is the Gaussian over the errors of `mean`, with the rows that `Chart` gives them."""

    def __init__(
        self, initial: NavEstimate, rig: StereoRig, model: str, form: type[Belief], rig_config: RigConfig
    ) -> None:
        """Start without landmarks; see `Filter`."""
        state_model = MODELS[model]()
        self._chart = Chart(state_model, RigErrors(rig, rig_config, state_model.nav_dim))
        self.mean = Mean.at_start(initial.state)
        self._rig_at, self._rig = self.rig_state, self._errors.rig(self.rig_state)
        self.miscalibrated = self._errors.disparity_prior.probability
        C, nav_dim = self._model.from_map(initial.state), self._model.nav_dim
        P = np.zeros((self.vehicle, self.vehicle))
        P[:nav_dim, :nav_dim] = symmetrise(C @ initial.covariance @ C.T)
        P[nav_dim:, nav_dim:] = self._errors.prior_covariance
        self.belief: Belief = form.from_covariance(P)

    @property
    def nav(self) -> NavState:
        """Mean of the navigation state."""
        return self.mean.nav

    @property
    def rig_state(self) -> RigState:
        """Mean of the rig's errors."""
        return self.mean.rig

    @property
    def past(self) -> PastPoses:
        """Mean of the past poses."""
        return self.mean.past

    @property
    def landmarks(self) -> Array:
        """Mean of the (N, 3) landmarks in the map frame [m]."""
        return self.mean.landmarks

    @property
    def _model(self) -> StateModel:
        return self._chart.model

    @property
    def _errors(self) -> RigErrors:
        return self._chart.errors

    @property
    def rig(self) -> StereoRig:
        """The rig with its estimated errors.

        Raises:
            FilterDivergence: no camera has these.
        """
        return self._rig_with(self.rig_state)

    def _rig_with(self, state: RigState) -> StereoRig:
        if self._rig_at is not state:  # cached: asked for a dozen times a frame
            try:
                self._rig_at, self._rig = state, self._errors.rig(state)
            except CalibrationError as error:
                raise FilterDivergence(f"errors of the calibration: {error}") from error
        return self._rig

    @property
    def vehicle(self) -> int:
        """Number of rows of the vehicle in the error."""
        return self._chart.vehicle(self.mean)

    def covariance(self) -> Array:
        """Return (vehicle + 3N, vehicle + 3N), the full covariance in the model's coordinates."""
        return self.belief.covariance(np.arange(len(self.landmarks))).copy()

    def past_estimate(self, number: int) -> PoseEstimate:
        """Return a past pose, as later frames have corrected it, with its covariance."""
        P = submatrix(self._claimed_covariance(), self._chart.past_rows(np.array([number])))
        return PoseEstimate(int(self.past.stamps_ns[number]), self.past.pose(number), symmetrise(P))

    def marginalise(self, landmarks: Indices, past: Indices = NO_ROWS) -> None:
        """Marginalise landmarks and past poses out of the state."""
        with stamped(self.nav.stamp_ns):
            self.belief = self.belief.marginalised(landmarks, self._chart.past_rows(past))
        self._set_mean(landmarks=np.delete(self.landmarks, landmarks, axis=0), past=self.past.without(past))

    def nav_estimate(self, *, as_calibrated: bool = False) -> NavEstimate:
        """Return the navigation state with its (15, 15) map-frame covariance, zero for states the model lacks.

        Args:
            as_calibrated: with the covariance that it has if the calibration is right, without the uncertainty of that.

        Raises:
            FilterDivergence: the covariance is not positive definite.
        """
        C, nav_dim = self._model.to_map(self.nav), self._model.nav_dim
        with stamped(self.nav.stamp_ns):
            P = self.belief.covariance(NO_ROWS) if as_calibrated else self._claimed_covariance()
            P = P[:nav_dim, :nav_dim]
            cholesky(P, "covariance of the navigation state")
        return NavEstimate(self.nav, symmetrise(C @ P @ C.T))

    def pose_landmark_information(self) -> Array:
        """Return (6+3N, 6+3N) information over position, xi and landmarks, the rest of the state marginalised."""
        nav_dim, m = self._model.nav_dim, self.vehicle
        C = self._model.to_map(self.nav)[:nav_dim]
        rows = np.concatenate([POSE, np.arange(m, self.belief.size)])
        with stamped(self.nav.stamp_ns):
            belief = claimed_belief(self.belief, self._errors, self.rig_state)
            return belief.predicted(C, np.zeros((nav_dim, nav_dim))).information(rows)

    def _claimed_covariance(self) -> Array:
        return claimed_covariance(self.belief, self._errors, self.rig_state)

    def rig_evidence(self) -> float:
        """Return how strongly the data contradict the calibration, see `rig_belief.rig_evidence`."""
        return rig_evidence(self.belief, self._errors, self.rig_state)

    def judge_disparity(self) -> None:
        """Exchange the prior of the disparity's error for what the measurements make of it, see `DisparityPrior`."""
        if not self._errors.has_disparity:
            return
        prior, mean = self._errors.disparity_variance, self.rig_state.disparity_px
        variance = disparity_variance(self.belief, self._errors)
        self.miscalibrated, now = self._errors.disparity_prior.given(mean, variance, prior=prior)
        self.expect_disparity(now)

    def expect_disparity(self, variance: float) -> None:
        """Exchange the prior of the disparity's error, if that is a state, as if the estimate had begun with this one.

        Args:
            variance: [px^2].
        """
        if not self._errors.has_disparity:
            return
        prior, mean = self._errors.disparity_variance, self.rig_state.disparity_px
        if abs(np.log(variance / prior)) < PRIOR_TOLERANCE:
            return
        row, change = self._errors.disparity.start, 1.0 / variance - 1.0 / prior
        with stamped(self.nav.stamp_ns):
            belief = self.belief.information_changed(row, change)
            self._set_disparity_prior(variance)
            self.correct(belief, -change * mean * belief.column(row))

    @property
    def disparity_prior(self) -> DisparityPrior:
        """What is known of the disparity's error before the flight."""
        return self._errors.disparity_prior

    def _set_disparity_prior(self, variance: float) -> None:
        self._chart = dataclasses.replace(self._chart, errors=self._errors.with_disparity_variance(variance))

    def discard_disparity_evidence(self) -> None:
        """Know no more of the disparity's error than before the flight; what depends on it still does."""
        if self._errors.has_disparity:
            self._restore_disparity(self._errors.disparity_prior.variance)

    def forget_disparity(self) -> None:
        """Let nothing depend on the disparity's error any more; the state stays as uncertain as is claimed."""
        if not self._errors.has_disparity:
            return
        prior = self._errors.disparity_prior
        self._restore_disparity(prior.claimed_variance)
        with stamped(self.nav.stamp_ns):
            self.belief = self.belief.reset_rows(np.array([self._errors.disparity.start]), prior.variance)
        self._set_disparity_prior(prior.variance)

    def _restore_disparity(self, variance: float) -> None:
        """Replace the marginal of the disparity's error by N(0, variance) [px^2]; the conditional of the rest stays."""
        row = self._errors.disparity.start
        with stamped(self.nav.stamp_ns):
            column = self.belief.column(row)
            belief = self.belief.information_changed(row, 1.0 / variance - 1.0 / float(column[row]))
            self._set_disparity_prior(variance)
            self.correct(belief, -self.rig_state.disparity_px / column[row] * column)

    def expect_time_offset(self, mean_s: float) -> None:
        """Move the offset of the cameras' clock [s], if it is a state, and what depends on it; no variance changes."""
        change_s = mean_s - self.rig_state.time_offset_s
        if self._errors.has_time_offset and change_s:  # a change takes a factor
            row = self._errors.time_offset.start
            column = self.belief.column(row)
            self.correct(self.belief, column / column[row] * change_s)

    @property
    def time_offset(self) -> TimeOffset | None:
        """The offset of the cameras' clock; None if it is no state."""
        if not self._errors.has_time_offset:
            return None
        row = self._errors.time_offset.start
        return TimeOffset(self.rig_state.time_offset_s, float(self.belief.covariance(NO_ROWS)[row, row]) ** 0.5)

    @property
    def disparity(self) -> DisparityEstimate | None:
        """What is known of the disparity's error; None if it is no state."""
        if not self._errors.has_disparity:
            return None
        mean, variance = self.rig_state.disparity_px, disparity_variance(self.belief, self._errors)
        claimed = claimed_variance(variance, self._errors, mean)
        return DisparityEstimate(mean, claimed**0.5, self.miscalibrated)

    def correct(self, belief: Belief, delta: Array) -> None:
        """Move the mean by (vehicle + 3N,) `delta` and set the belief over the remaining error."""
        before, self.mean = self.mean, self._chart.retract(self.mean, delta)
        self.belief = self._chart.transported(belief, before, self.mean)

    def _move_linearisation(self, to: Mean) -> Array:
        """Move the linearisation point and return the prior mean as an error from it."""
        prior, self.mean = self.mean, to
        self.belief = self._chart.transported(self.belief, prior, self.mean)
        return self._chart.local(self.mean, prior)

    def _set_mean(self, **parts: Any) -> None:
        """Exchange parts of the mean."""
        self.mean = dataclasses.replace(self.mean, **parts)


@contextmanager
def stamped(stamp_ns: int) -> Iterator[None]:
    """Add the time to a `FilterDivergence`; numpy's `LinAlgError` becomes one."""
    try:
        yield
    except (FilterDivergence, np.linalg.LinAlgError) as error:
        raise FilterDivergence(f"at {stamp_ns / NS_PER_S:.3f} s: {error}") from error
