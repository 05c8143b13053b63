# SPDX-License-Identifier: Apache-2.0
"""Do the first frames agree with the start state, as certain as it says it is?

Position and heading at the start can't be wrong: nothing else knows them. But a wrong tilt or heading, and of course a
wrong velocity, shows as a velocity that the frames correct by more than its doubt allows. With P_r the covariance of
the dead reckoning from the start state and P that of the filter, a correction d of the velocity has covariance P_r - P.
That is the innovations' own test, but of three numbers: among the hundreds of pixels of one frame ten sigmas of
velocity are lost. Frames whose innovations are too large as a whole, or that fit nothing, are evidence as well.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.ins.propagation import VELOCITY
from uav_vslam.slam.backend import FrameReport
from uav_vslam.types import NS_PER_S, NavEstimate

WATCHED_S = 5.0  # later the start has little to do with what goes wrong
SIGNIFICANCE = 1e-4  # a right start looks as wrong as this so rarely, at one frame
NEGLIGIBLE = 0.01  # [m/s] a correction that nobody minds, whatever the covariances say
MAX_NIS_PER_DOF = 2.0  # of all updates since the start; an honest filter is within a few percent of 1
MAX_COASTED = 3  # frames with much to see and nothing recognised
MIN_FEATURES = 20  # fewer, in the frame or in the map, are not much

REMEDY = "check initial_state's covariance, the IMU noise or the calibration"


class StartMonitor:
    """Watches the frames after the start and warns once."""

    def __init__(self) -> None:
        self._end_ns: int | None = None
        self._nis, self._dof, self._coasted, self._landmarks = 0.0, 0, 0, 0
        self._warned = False

    def stop(self, stamp_ns: int) -> None:
        """End the watch: from here on the state does not come from the start."""
        self._end_ns = stamp_ns

    def trusts(self, stamp_ns: int) -> bool:
        """Tell whether the start has passed: the watch is over by this time and found nothing."""
        return not self._warned and self._end_ns is not None and stamp_ns > self._end_ns

    def add(self, report: FrameReport, reckoned: NavEstimate) -> str:
        """Take note of a frame and return a warning, empty as a rule and after the first.

        Args:
            report: what became of the frame.
            reckoned: dead reckoning from the start state to the frame, never corrected.
        """
        if self._end_ns is None:
            self._end_ns = report.pose.stamp_ns + round(WATCHED_S * NS_PER_S)
        if self._warned or report.pose.stamp_ns > self._end_ns:
            return ""
        finding = self._finding(report, reckoned)
        self._landmarks = report.landmarks
        self._warned = finding != ""
        return f"{finding}; {REMEDY}" if finding else ""

    def _finding(self, report: FrameReport, reckoned: NavEstimate) -> str:
        if report.innovation is not None:
            self._nis += report.innovation.nis
            self._dof += report.innovation.dof
        elif min(report.features, self._landmarks) >= MIN_FEATURES:
            self._coasted += 1
        times = velocity_correction(report.nav, reckoned)
        if times > np.sqrt(chdtri(3, SIGNIFICANCE) / 3):
            return f"the first frames correct the start's velocity by {times:.1f} times what its sigmas allow"
        if self._nis > MAX_NIS_PER_DOF * max(self._dof, 1):
            times = np.sqrt(self._nis / self._dof)
            return f"innovations after the start are {times:.1f} times larger than the start's sigmas allow"
        if self._coasted >= MAX_COASTED:
            return f"{self._coasted} of the first frames show much, but nothing where the start makes them expect it"
        return ""


def velocity_correction(nav: NavEstimate, reckoned: NavEstimate) -> float:
    """Return the root mean square, over three axes, of what frames moved the velocity by, in sigmas of P_r - P."""
    d = nav.state.v_map - reckoned.state.v_map
    values, axes = np.linalg.eigh(reckoned.covariance[VELOCITY, VELOCITY] - nav.covariance[VELOCITY, VELOCITY])
    variance: NDArray[np.float64] = np.maximum(values, 0.0) + NEGLIGIBLE**2
    return float(np.sqrt(np.mean((axes.T @ d) ** 2 / variance)))
