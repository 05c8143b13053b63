# SPDX-License-Identifier: Apache-2.0
"""Tests the start state against the first frames.

Start position and heading define the map, so they can't be wrong as such. But a wrong velocity, tilt, or heading
relative to the velocity shows as a velocity correction beyond its uncertainty. With P_r the covariance of dead
reckoning from the start state and P that of the filter, a velocity correction d has covariance P_r - P. This is the
innovation test reduced to three numbers: among the hundreds of pixels of a frame, ten sigmas of velocity do not show.
Frames whose innovations are too large as a whole, or that associate no landmark and use no track, are evidence as well.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.ins.propagation import VELOCITY
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.health import MIN_FEATURES
from uav_vslam.types import NS_PER_S, NavEstimate

WATCHED_S = 5.0  # later the start hardly matters
SIGNIFICANCE = 1e-4  # false-alarm probability per frame of a correct start
NEGLIGIBLE = 0.01  # [m/s] corrections below are negligible at any covariance
MOST_SCALED = 1.0 / 3.0  # of the speed: no calibration scales by more
MAX_NIS_PER_DOF = 2.0  # of all updates since the start; a consistent filter is within a few percent of 1
MAX_COASTED = 3  # frames with enough features, but none that the prediction explains

OF_BIASES = "imu.gyro_bias_sigma and imu.accel_bias_sigma"
CHECKED = {  # by `start.method`, besides what can be wrong with any start
    "given": "initial_state and its covariance",
    "static": f"that the vehicle was at rest, {OF_BIASES}",
    "in_flight": OF_BIASES,
    "map": f"the map, {OF_BIASES}",
}


class StartMonitor:
    """Monitors the frames after the start and warns once."""

    def __init__(self, method: str = "given", *, scaled: bool = False) -> None:
        """Begin before the first frame.

        Args:
            method: of the start.
            scaled: the calibration may be wrong, which scales all that is seen: the speed is no evidence, unless it is
                far off.
        """
        self._scaled = scaled
        self._remedy = f"check {CHECKED[method]}, the IMU (units, axes, noise), the clocks and the calibration"
        self._end_ns: int | None = None
        self._nis, self._dof, self._coasted, self._landmarks = 0.0, 0, 0, 0
        self._warned = False

    def stop(self, stamp_ns: int) -> None:
        """Stop monitoring: from now on the state does not depend on the start."""
        self._end_ns = stamp_ns

    def trusts(self, stamp_ns: int) -> bool:
        """Return whether the start was accepted: monitoring is over by this time and found nothing."""
        return not self._warned and self._end_ns is not None and stamp_ns > self._end_ns

    def add(self, report: FrameReport, dead_reckoned: NavEstimate) -> str:
        """Add a frame and return a warning, normally empty, and empty after the first.

        Args:
            report: result of the frame.
            dead_reckoned: dead reckoning from the start state to the frame, never corrected.
        """
        if self._end_ns is None:
            self._end_ns = report.pose.stamp_ns + round(WATCHED_S * NS_PER_S)
        if self._warned or report.pose.stamp_ns > self._end_ns:
            return ""
        finding = self._finding(report, dead_reckoned)
        self._landmarks = report.landmarks
        self._warned = finding != ""
        return f"{finding}; {self._remedy}" if finding else ""

    def _finding(self, report: FrameReport, dead_reckoned: NavEstimate) -> str:
        if report.innovation is not None and report.innovation.dof > 0:
            self._nis += report.innovation.nis
            self._dof += report.innovation.dof
        elif report.could_correct(self._landmarks) >= MIN_FEATURES:
            self._coasted += 1
        nav = report.as_calibrated or report.nav
        speed, expected = (np.linalg.norm(one.state.v_map) for one in (nav, dead_reckoned))
        scaled = self._scaled and bool(abs(speed - expected) <= MOST_SCALED * expected)
        times = velocity_correction(nav, dead_reckoned, scaled=scaled)
        axes = 2 if scaled else 3
        if times > np.sqrt(chdtri(axes, SIGNIFICANCE) / axes):
            return f"the first frames correct the start's velocity by {times:.1f} times what its sigmas allow"
        if self._nis > MAX_NIS_PER_DOF * max(self._dof, 1):
            times = np.sqrt(self._nis / self._dof)
            return f"innovations after the start are {times:.1f} times larger than the start's sigmas allow"
        if self._coasted >= MAX_COASTED:
            return f"{self._coasted} of the first frames show nothing where the start predicts it"
        return ""


def velocity_correction(nav: NavEstimate, dead_reckoned: NavEstimate, *, scaled: bool = False) -> float:
    """Return the root mean square of the velocity correction in sigmas of P_r - P, over three axes.

    If `scaled`, over the two that are across the velocity.
    """
    v = dead_reckoned.state.v_map
    across = np.linalg.svd(v[None, :])[2][1:].T if scaled else np.eye(3)
    d = across.T @ (nav.state.v_map - v)
    P = dead_reckoned.covariance[VELOCITY, VELOCITY] - nav.covariance[VELOCITY, VELOCITY]
    values, axes = np.linalg.eigh(across.T @ P @ across)
    variance: NDArray[np.float64] = np.maximum(values, 0.0) + NEGLIGIBLE**2
    return float(np.sqrt(np.mean((axes.T @ d) ** 2 / variance)))
