# SPDX-License-Identifier: Apache-2.0
"""Statistics of a stream of IMU readings."""

from uav_vslam.config import ImuConfig
from uav_vslam.ins.gaps import SLOWEST_HZ, UsualSpacing
from uav_vslam.ins.white_noise import WhiteNoise
from uav_vslam.types import ImuSample


class ImuStatistics:
    """The usual spacing of readings and their white noise, as of the newest one."""

    def __init__(self, configured: ImuConfig) -> None:
        self._spacing, self._noise = UsualSpacing(), WhiteNoise(configured)

    @property
    def period_s(self) -> float:
        """Usual spacing [s]; 0 before the second reading."""
        return self._spacing.period_s

    @property
    def fault(self) -> str:
        """What is wrong with the stamps of the newest readings; normally empty."""
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
        self._noise.add(sample, self._spacing.period_s)
