# SPDX-License-Identifier: Apache-2.0
"""Statistics of a stream of IMU readings."""

import numpy as np

from uav_vslam.config import ImuConfig
from uav_vslam.ins.gaps import SLOWEST_HZ, UsualSpacing
from uav_vslam.ins.white_noise import WhiteNoise
from uav_vslam.types import ImuSample

MANY = 200  # readings: a gyroscope that has read only zero so often is none, though one without noise may at rest


class ImuStatistics:
    """The usual spacing of readings and their white noise, as of the newest one."""

    def __init__(self, configured: ImuConfig) -> None:
        self._spacing, self._noise = UsualSpacing(), WhiteNoise(configured)
        self._first: ImuSample | None = None
        self._zeros, self._varies = 0, False  # first readings without a rate, -1 after one with; the acceleration

    @property
    def period_s(self) -> float:
        """Usual spacing [s]; 0 before the second reading."""
        return self._spacing.period_s

    @property
    def fault(self) -> str:
        """What is wrong with the newest readings or their stamps; normally empty."""
        if self._zeros >= MANY and self._varies:
            return (
                "the gyroscope reads zero and nothing else, while the accelerometer varies: is it on a topic of its "
                "own? Record one that holds both (unite them in the driver)"
            )
        if self._spacing.bursts_hz is not None:
            within_hz, mean_hz = self._spacing.bursts_hz
            return (
                f"IMU readings are stamped in bursts, {within_hz:.0f} Hz within and {mean_hz:.0f} Hz on average "
                "outside gaps: motion is integrated at wrong times, and the covariance does not allow for it; let the "
                "driver stamp the time of each reading"
            )
        if self._spacing.slow_hz is not None:
            return (
                f"IMU readings come at {self._spacing.slow_hz:.0f} Hz: the motion between them is lost, and the "
                f"covariance does not allow for it; let the driver publish {SLOWEST_HZ:.0f} a second or more"
            )
        return ""

    @property
    def imu(self) -> ImuConfig:
        """The configuration, with the measured noise if that is far larger."""
        return self._noise.imu

    def add(self, sample: ImuSample) -> None:
        """Add a reading, later than those before."""
        self._spacing.add(sample.stamp_ns)
        self._count_zero(sample)
        self._noise.add(sample, self._spacing.period_s)

    def _count_zero(self, sample: ImuSample) -> None:
        """Count the first readings of which the rate is zero; one that is not settles that there is a gyroscope."""
        self._first = self._first or sample
        if self._zeros < 0 or sample.gyro.any():
            self._zeros = -1
            return
        self._zeros += 1
        self._varies = self._varies or not np.array_equal(sample.accel, self._first.accel)
