# SPDX-License-Identifier: Apache-2.0
"""When the motion may judge the disparity's error.

Not while the tilt or the velocity may be wrong, whose corrections look like a wrong calibration; nor where readings of
the IMU are missing, since the motion is then no measure of it. What has been estimated by then stays as uncertain as a
calibration in doubt makes it.
"""

import copy

import numpy as np

from uav_vslam.estimation.filter import Filter
from uav_vslam.ins.increments import lacks_readings
from uav_vslam.ins.propagation import ROTATION
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate

LEVEL_RAD = 0.01  # 1 sigma of the tilt; while it is larger, its corrections look like a wrong calibration,
JUDGED_AFTER_S = 3.0  # and since then, or since the start, a wrong velocity does


class DisparityJudge:
    """Judges the disparity of one filter, from its start on.

    Before it does, a filter that uses tracks expects a wrong calibration: they are so exact that one which is trusted
    soon makes the state certain and wrong. What is reported of it trusts the calibration: a wrong start velocity must
    show as that. Landmarks alone are so noisy that a calibration doubted at the start is linearised too far from the
    truth.
    """

    def __init__(self) -> None:
        self._level_ns: int | None = None  # since when the tilt is known
        self._has_judged = self._has_ended = False
        self._was_tilted = False

    def before_prediction(self, slam_filter: Filter, increment: ImuIncrement) -> None:
        """End before the first motion that readings are missing of; what is not judged by then is trusted."""
        if self._has_ended or not lacks_readings(increment):
            return
        if not self._has_judged:
            _trust(slam_filter)
        self._has_ended = True

    def after_update(self, slam_filter: Filter, nav: NavEstimate, *, by_tracks: bool) -> None:
        """Judge, if it is time; what the motion said before the tilt was known is forgotten.

        Args:
            slam_filter: updated.
            nav: the last estimate.
            by_tracks: besides landmarks.
        """
        if self._has_ended:
            return
        if self._level_ns is None:
            if np.diagonal(nav.covariance)[ROTATION][:2].max() > LEVEL_RAD**2:
                slam_filter.discard_disparity_evidence()
                self._was_tilted = True
                return
            if self._was_tilted:
                slam_filter.forget_disparity()
            if by_tracks:
                slam_filter.expect_disparity(slam_filter.disparity_prior.unjudged_variance)
            self._level_ns = nav.state.stamp_ns
        if (nav.state.stamp_ns - self._level_ns) / NS_PER_S > JUDGED_AFTER_S:
            slam_filter.judge_disparity()
            self._has_judged = True

    @property
    def _is_over(self) -> bool:
        """Whether the disparity has been judged, or never will be."""
        return self._has_judged or self._has_ended

    @property
    def awaits_evidence(self) -> bool:
        """Whether the disparity has been forgotten but not judged yet: what the rest owes to it looks like evidence."""
        return self._was_tilted and self._level_ns is not None and not self._is_over

    def trusting(self, slam_filter: Filter) -> Filter:
        """Return a filter, or a copy that trusts the calibration as long as that is not judged.

        Args:
            slam_filter: as it is, or with what the tracks say.
        """
        if self._is_over:
            return slam_filter
        trusting = copy.copy(slam_filter)
        if self._level_ns is None:
            trusting.discard_disparity_evidence()  # that of the tracks, which the filter doesn't have yet
        else:
            _trust(trusting)
        return trusting


def _trust(slam_filter: Filter) -> None:
    """Go on as if the disparity had not been doubted."""
    slam_filter.expect_disparity(slam_filter.disparity_prior.variance)
