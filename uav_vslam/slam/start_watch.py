# SPDX-License-Identifier: Apache-2.0
"""What follows from first frames that contradict the start state: a warning, or a filter that doubts it."""

import dataclasses

from uav_vslam.config import ImuConfig
from uav_vslam.ins.preintegrator import dead_reckoned
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.recovery import doubted_start
from uav_vslam.slam.start_monitor import StartMonitor
from uav_vslam.types import ImuIncrement, NavEstimate, StereoFeatures


class StartWatch:
    """Watches the start by what two filters make of it: one that trusts the calibration, and one that doesn't.

    If both contradict it, the filter is re-initialised from dead reckoning at any speed: what the frames have made of
    a wrong start is certain and wrong.
    """

    def __init__(self, initial: NavEstimate, method: str, imu: ImuConfig) -> None:
        """Begin at a start state that was found by `start.method`."""
        self._method = method
        self._trusting, self._doubting = StartMonitor(method), StartMonitor(method, scaled=True)
        self._doubted, self._imu = doubted_start(initial), imu  # dead reckoning from a start state that may be wrong

    def add_motion(self, increment: ImuIncrement) -> None:
        """Add the motion up to the next frame."""
        self._doubted = dead_reckoned(self._doubted, increment, self._imu)

    def stop(self, stamp_ns: int) -> None:
        """Stop watching: from now on the state does not depend on the start."""
        for monitor in (self._trusting, self._doubting):
            monitor.stop(stamp_ns)

    def trusts(self, stamp_ns: int) -> bool:
        """Return whether the start was accepted by this time, or a wrong calibration explains the first frames."""
        return self._trusting.trusts(stamp_ns) or self._doubting.trusts(stamp_ns)

    def check(
        self, backend: SlamBackend, report: FrameReport, features: StereoFeatures, unaided: NavEstimate
    ) -> tuple[FrameReport, str]:
        """Return a frame's report, and a warning if it contradicts the start.

        Args:
            backend: has processed the frame; it may be re-initialised.
            report: of the frame.
            features: of the frame.
            unaided: dead reckoning from the start state to the frame, never corrected.
        """
        finding = self._trusting.add(report, unaided)
        doubting = dataclasses.replace(report, as_calibrated=report.doubting or report.as_calibrated)
        contradiction = self._doubting.add(doubting, unaided)
        if not contradiction:  # a wrong calibration explains the finding, and the filter expects one
            return report, finding
        self._trusting = StartMonitor(self._method)
        return backend.recovered(report, features, contradiction, start=self._doubted), ""
