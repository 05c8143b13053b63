# SPDX-License-Identifier: Apache-2.0
"""Warns when readings or tracks are noisier than configured, see `ins.white_noise` and `slam.track_noise`."""

from uav_vslam.config import ImuConfig
from uav_vslam.types import ImuIncrement

STEADY_S = 1.0  # after which noise that begins has been measured


class NoiseMonitor:
    """Watches increments and tracks and warns once of each sensor."""

    def __init__(self, imu: ImuConfig) -> None:
        self._watching_tracks = True
        self._loud_s: dict[str, float] = {}
        self._configured = {"imu.gyro_noise": imu.gyro_noise, "imu.accel_noise": imu.accel_noise}

    def add_tracks(self, sigma_px: float, *, configured_px: float) -> str:
        """Add the noise that tracks have now and return a warning, normally empty."""
        if not self._watching_tracks or sigma_px <= configured_px:
            return ""
        self._watching_tracks = False
        return (
            f"tracked points are {sigma_px:.2f} px off their epipolar lines, {sigma_px / configured_px:.1f} times "
            "backend.track_sigma_px, and are weighted so: the images are noisy, blurred or of weak texture"
        )

    def add(self, increment: ImuIncrement) -> str:
        """Add an increment and return a warning, normally empty."""
        seen = {"imu.gyro_noise": increment.gyro_noise, "imu.accel_noise": increment.accel_noise}
        louder = {name: seen[name] / sigma for name, sigma in self._configured.items() if seen[name] > sigma}
        self._loud_s = {name: self._loud_s.get(name, 0.0) + increment.dt_s for name in louder}
        noisy = {name: ratio for name, ratio in louder.items() if self._loud_s[name] >= STEADY_S}
        if not noisy:
            return ""
        self._configured = {name: sigma for name, sigma in self._configured.items() if name not in noisy}
        times = " and ".join(f"{ratio:.1f} times {name}" for name, ratio in noisy.items())
        return (
            f"the readings of the IMU have {times}, and are weighted so: check their units (rad/s, m/s^2), set what "
            "`uav-vslam check` measures over a recording, or isolate the IMU from vibration"
        )
