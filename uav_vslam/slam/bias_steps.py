# SPDX-License-Identifier: Apache-2.0
"""Notices that the IMU's biases have stepped in flight, after a knock or a thermal shock, and goes back to before.

The random walk of the biases allows for no step: the images then correct velocity, attitude and biases by more than the
covariance allows, or contradict the prediction altogether, and the filter becomes confidently wrong. So its estimate is
compared with what the IMU alone makes of an earlier one, as `StartMonitor` does with the start. If they are too far
apart, a copy of the back end from back then uses the same images and readings once more, with biases that may walk as
far as a step goes, and replaces the present one if it finds that they have.
"""

import copy
import dataclasses
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

from uav_vslam.config import ImuConfig, VehicleConfig
from uav_vslam.estimation.filters import is_of_thesis
from uav_vslam.estimation.models import difference
from uav_vslam.ins.preintegrator import advance
from uav_vslam.ins.propagation import ACCEL_BIAS, GYRO_BIAS, VELOCITY
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.health import MIN_FEATURES
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate, StereoFeatures

EVERY_S, KEPT = 1.0, 4  # between the back ends that are kept, and how many: the oldest one is from before the step
LONGEST_S = 6.0  # since the oldest one; after a longer time without images, a step can't be told from drift
SETTLED_S = 5.0  # since the start, or a recovery: until then a wrong start or calibration looks the same

SIGNIFICANCE = 1e-5  # false-alarm probability: of a comparison, or of a trial that follows frames without one, and
CONFIRMED = 0.5  # of a trial that follows a comparison
SHOWN_S = 0.4  # for which a step is over when it shows; the first trial is made then, or when nothing fits for so long,
LONGER = 1.5  # and the next one after so much longer, and so on
SHOWN_FRAMES = 2  # that it must explain since: with biases that may step, any one frame fits, even a misleading one
STEP_SIGMA = 0.05, 1.0  # of a step [rad/s], [m/s^2]

COMPARED = slice(VELOCITY.start, ACCEL_BIAS.stop)
BIASES = slice(GYRO_BIAS.start, ACCEL_BIAS.stop)
NEGLIGIBLE = np.repeat([0.01, 0.001, 1e-4, 2e-3], 3)  # [m/s], [rad], [rad/s], [m/s^2]
DIFFERENT = chdtri(len(NEGLIGIBLE), SIGNIFICANCE)


@dataclass(slots=True)
class _Past:
    """A back end as it was, and what the present one has processed since.

    Attributes:
        backend: as it was.
        unaided: its estimate, propagated by the IMU alone since.
        frames: since.
    """

    backend: SlamBackend
    unaided: NavEstimate
    frames: list[tuple[StereoFeatures, ImuIncrement]] = field(default_factory=list)

    @property
    def age_s(self) -> float:
        """Time since [s]."""
        return (self.unaided.state.stamp_ns - self.backend.nav.state.stamp_ns) / NS_PER_S

    def add(self, features: StereoFeatures, increment: ImuIncrement, imu: ImuConfig) -> None:
        """Add a frame."""
        self.frames.append((features, increment))
        self.unaided = advance(self.unaided, increment, imu)


class BiasStepMonitor:
    """Watches a back end, frame by frame; after a recovery, or a gap in the readings, another one has to."""

    def __init__(self) -> None:
        self._past: deque[_Past] = deque(maxlen=KEPT)
        self._settling_ns: int | None = None  # since when
        self._suspected_s = self._tried_s = 0.0  # for how long there has been a suspicion; the same at the last trial

    def check(
        self,
        backend: SlamBackend,
        features: StereoFeatures,
        increment: ImuIncrement | None,
        report: FrameReport,
        config: VehicleConfig,
    ) -> tuple[SlamBackend, FrameReport]:
        """Return the back end to go on with after a frame, and the report of that frame.

        The thesis's filters may have no biases. Frames without tracks are kept, but not judged: landmarks alone are not
        exact enough to tell a step from a wrong calibration.

        Args:
            backend: has processed the frame.
            features: of the frame.
            increment: up to the frame.
            report: of the frame.
            config: the present one.
        """
        if is_of_thesis(config) or increment is None or report.recovery:
            return backend, report
        for past in self._past:
            past.add(features, increment, config.imu)
        replayed = self._judge(backend, increment, report, config) if report.tracked else None
        if self._past and self._past[0].age_s > LONGEST_S:
            self._past.clear()
        return replayed or (backend, report)

    def _judge(
        self, backend: SlamBackend, increment: ImuIncrement, report: FrameReport, config: VehicleConfig
    ) -> tuple[SlamBackend, FrameReport] | None:
        """Return the back end and report that replace those of a frame after a step; see `check`."""
        if not self._is_suspect(report, increment):
            self._suspected_s = self._tried_s = 0.0
            self._remember(backend, report)
            return None
        if self._suspected_s < max(SHOWN_S, LONGER * self._tried_s):
            return None
        self._tried_s = self._suspected_s
        constant_s, significance = self._suspected_s, CONFIRMED
        if report.coasted:  # after a large step it takes several frames until one fits
            constant_s, significance = max(SHOWN_S, 0.5 * self._suspected_s), SIGNIFICANCE
        return _replayed(self._past[0], backend, config, constant_s=constant_s, significance=significance)

    def _is_suspect(self, report: FrameReport, increment: ImuIncrement) -> bool:
        """Return whether the biases may have stepped, and count for how long that is so."""
        if not self._past or self._past[0].age_s < EVERY_S:
            return False
        missed = report.coasted and report.could_correct(report.landmarks) >= MIN_FEATURES
        shows = not report.coasted and correction(report.nav, self._past[0].unaided) > DIFFERENT
        if missed or self._suspected_s > 0.0:
            self._suspected_s += increment.dt_s
        elif shows:
            self._suspected_s = SHOWN_S
        return missed or shows

    def _remember(self, backend: SlamBackend, report: FrameReport) -> None:
        """Keep the back end from time to time, while images confirm it."""
        now_ns = report.pose.stamp_ns
        if self._settling_ns is None:
            self._settling_ns = now_ns
        settled = now_ns - self._settling_ns >= SETTLED_S * NS_PER_S
        if settled and not report.coasted and not (self._past and self._past[-1].age_s < EVERY_S):
            self._past.append(_Past(copy.deepcopy(backend), report.nav))


def correction(nav: NavEstimate, unaided: NavEstimate) -> float:
    """Return the squared correction of velocity, attitude and biases over its covariance, which is P_unaided - P.

    Where P has grown instead, as the velocity's along the flight does when the disparity is no longer trusted, the mean
    may have moved by as much.
    """
    none = np.zeros((0, 3))
    d = difference(unaided.state, none, nav.state, none)[COMPARED] / NEGLIGIBLE
    P = (unaided.covariance - nav.covariance)[COMPARED, COMPARED] / np.outer(NEGLIGIBLE, NEGLIGIBLE)
    values, axes = np.linalg.eigh(P)
    return float(np.sum((axes.T @ d) ** 2 / (np.abs(values) + 1.0)))


def _replayed(
    past: _Past, present: SlamBackend, config: VehicleConfig, *, constant_s: float, significance: float
) -> tuple[SlamBackend, FrameReport] | None:
    """Return a back end that has allowed for a step, and its report of the last frame; None if it found none.

    Args:
        past: from before the step.
        present: the back end that is replaced.
        config: the present one.
        constant_s: the biases have not changed for that time, by which they are known.
        significance: probability with which biases that have not stepped are found to have.
    """
    if past.age_s <= constant_s:
        return None
    gyro_walk, accel_walk = (sigma / (past.age_s - constant_s) ** 0.5 for sigma in STEP_SIGMA)
    stepping = dataclasses.replace(config.imu, gyro_bias_walk=gyro_walk, accel_bias_walk=accel_walk)
    open_until_ns = past.unaided.state.stamp_ns - constant_s * NS_PER_S
    backend = past.backend.to_replace(present, config)
    shown = 0
    for features, increment in past.frames:
        is_over = increment.stamp_ns > open_until_ns
        backend.set_imu(config.imu if is_over else stepping)
        report = backend.process(features, increment)
        if report.recovery or (is_over and report.coasted and report.tracked):
            return None
        shown += is_over and not report.coasted
    if shown < SHOWN_FRAMES:
        return None
    before, nav = past.backend.nav.state, report.nav
    gyro, accel = nav.state.gyro_bias - before.gyro_bias, nav.state.accel_bias - before.accel_bias
    step = np.concatenate([gyro, accel])
    if step @ np.linalg.solve(nav.covariance[BIASES, BIASES], step) < chdtri(len(step), significance):
        return None
    reason = (
        f"as it was {past.age_s:.1f} s ago, because the IMU's biases have stepped since, by "
        f"{np.linalg.norm(gyro):.2g} rad/s and {np.linalg.norm(accel):.2g} m/s^2: check its mount and supply, or "
        "clocks and calibration, which look the same if they are far off"
    )
    return backend, dataclasses.replace(report, recovery=reason)
