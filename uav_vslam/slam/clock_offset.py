# SPDX-License-Identifier: Apache-2.0
"""Linearises the offset of the cameras' clock again where the frames find it far from where that was done.

The filter estimates the offset along with the rest. But it starts at zero, and frames that are linearised there bend
velocity, attitude and biases to what tens of milliseconds cost in a gust, with the certainty of tracked points. So
once the offset is found to be elsewhere, a copy of the back end from before uses the same images and readings again,
about the offset that was found, until it stays there.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation.rig_belief import TimeOffset
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.frame_queue import Frame
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.health import MIN_FEATURES
from uav_vslam.types import NS_PER_S, ImuIncrement, StereoFeatures

FAR_S = 0.002  # from where it is linearised, and more than its standard deviation
KNOWN_S, KNOWN_AFTER_S = 0.0005, 1.0  # standard deviation of an offset that no later frame moves far, and of how many
MOST_TIMES = 8  # that frames are used again because of it
EVERY_S, KEPT = 3.0, 2  # between the back ends that are kept, and how many
MISSED = 2  # frames in a row that an offset far beyond its sigma explains; a third one contradicts the start
SOUGHT_S = -0.01, 0.01, -0.02, 0.02, -0.03, 0.03, -0.04, 0.04
WARNED_S = 0.005


@dataclass(slots=True)
class _Past:
    """A back end as it was, and the frames that the present one has processed since."""

    backend: SlamBackend
    frames: list[Frame] = field(default_factory=list)

    @property
    def stamp_ns(self) -> int:
        return self.backend.stamp_ns


class ClockOffsetMonitor:
    """Watches a back end until the offset is known; after a recovery another one has to."""

    def __init__(self, backend: SlamBackend) -> None:
        """Begin with a back end that is to process the next frame."""
        self._past = [_Past(copy.deepcopy(backend))]
        self._about_s = backend.time_offset_s
        self._times = self._missed = 0

    @property
    def is_known(self) -> bool:
        """Whether the offset is known, so that nothing is watched any more."""
        return not self._past

    def check(
        self,
        backend: SlamBackend,
        features: StereoFeatures,
        increment: ImuIncrement | None,
        report: FrameReport,
        config: VehicleConfig,
    ) -> tuple[SlamBackend, FrameReport, str]:
        """Return the back end to go on with after a frame, the report of that frame, and a warning.

        Args:
            backend: has processed the frame.
            features: of the frame.
            increment: up to the frame.
            report: of the frame.
            config: the present one.
        """
        if self.is_known or report.recovery or report.time_offset is None:
            return backend, report, ""
        for past in self._past:
            past.frames.append((features, increment))
        before = backend
        is_missed = report.coasted and report.could_correct(landmarks=0) >= MIN_FEATURES
        self._missed = self._missed + 1 if is_missed else 0
        if self._missed == MISSED:
            backend, report = self._sought(backend, config) or (backend, report)
        while (found := report.time_offset) is not None and report.tracked and self._is_far(found):
            self._times += 1
            again = self._replayed(found.mean_s, backend, config, goes_on=_is_no_recovery)
            if again is None:
                break
            backend, report = again
        if backend is not before:  # what has been kept since is linearised elsewhere
            self._past = self._past[:1]
        return backend, report, "" if found is None else self._settle(backend, found)

    def _is_far(self, found: TimeOffset) -> bool:
        """Return whether an offset is to be linearised again; not for ever."""
        return self._times < MOST_TIMES and abs(found.mean_s - self._about_s) > max(FAR_S, found.sigma_s)

    def _sought(self, present: SlamBackend, config: VehicleConfig) -> tuple[SlamBackend, FrameReport] | None:
        """Return the first of back ends about other offsets that most tracks of each frame fit; None without one."""
        before_s = self._about_s
        for offset_s in SOUGHT_S:
            found = self._replayed(offset_s, present, config, goes_on=_is_explained)
            if found is not None:
                return found
        self._about_s = before_s
        return None

    def _replayed(
        self, about_s: float, present: SlamBackend, config: VehicleConfig, *, goes_on: Callable[[FrameReport], bool]
    ) -> tuple[SlamBackend, FrameReport] | None:
        """Return a back end that is linearised about an offset, and its last report; None where it does not go on."""
        self._about_s = about_s
        backend = self._past[0].backend.to_replace(present, config)
        try:
            backend.expect_time_offset(about_s)
        except FilterDivergence:  # when it was kept; the present one goes on
            return None
        for frame in self._past[0].frames:
            report = backend.process(*frame)
            if not goes_on(report):
                return None
        return backend, report

    def _settle(self, backend: SlamBackend, found: TimeOffset) -> str:
        """Stop watching once the offset is known, and return a warning if it is large; else keep the back end."""
        if found.sigma_s < KNOWN_S and backend.stamp_ns - self._past[0].stamp_ns > KNOWN_AFTER_S * NS_PER_S:
            self._past.clear()
            backend.keep_time_offset()
            return _warning(found)
        if backend.stamp_ns - self._past[-1].stamp_ns > EVERY_S * NS_PER_S:
            self._past = [*self._past, _Past(copy.deepcopy(backend))][-KEPT:]
        return ""


def _is_no_recovery(report: FrameReport) -> bool:
    return not report.recovery


def _is_explained(report: FrameReport) -> bool:
    """Return whether most tracks of a frame, if it has any, are where they are predicted."""
    return not report.tracked or 2 * report.associated > report.tracked


def _warning(found: TimeOffset) -> str:
    """Return what to do about an offset, if it is large."""
    if abs(found.mean_s) < WARNED_S:
        return ""
    side = "after" if found.mean_s > 0.0 else "before"
    return (
        f"the images are exposed {1e3 * abs(found.mean_s):.1f} ms {side} their stamps, by the IMU's clock: add "
        f"{found.mean_s:+.4f} to timeshift_cam_imu in the calibration, or mend the stamps"
    )
