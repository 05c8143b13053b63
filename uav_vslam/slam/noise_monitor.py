# SPDX-License-Identifier: Apache-2.0
"""Tells when readings are noisier than configured, see `ins.white_noise`."""

from uav_vslam.config import ImuConfig
from uav_vslam.types import ImuIncrement


class NoiseMonitor:
    """Watches the increments and warns once of each sensor."""

    def __init__(self, imu: ImuConfig) -> None:
        self._configured = {"imu.gyro_noise": imu.gyro_noise, "imu.accel_noise": imu.accel_noise}

    def add(self, increment: ImuIncrement) -> str:
        """Add an increment and return a warning, normally empty."""
        seen = {"imu.gyro_noise": increment.gyro_noise, "imu.accel_noise": increment.accel_noise}
        loud = {name: seen[name] / told for name, told in self._configured.items() if seen[name] > told}
        if not loud:
            return ""
        self._configured = {name: told for name, told in self._configured.items() if name not in loud}
        times = " and ".join(f"{ratio:.1f} times {name}" for name, ratio in loud.items())
        return (
            f"the readings of the IMU have {times}, and are weighted so: set what `uav-vslam check` measures over a "
            "recording, or isolate the IMU from vibration"
        )
