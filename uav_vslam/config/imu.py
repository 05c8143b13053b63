# SPDX-License-Identifier: Apache-2.0
"""Noise of inertial measurement units; defaults and grades."""

import math
from dataclasses import dataclass

from uav_vslam.config.settings import Settings, setting


@dataclass(frozen=True, slots=True)
class ImuConfig(Settings):
    """Noise densities (continuous-time) and initial bias uncertainty of the inertial unit; defaults ADIS16480."""

    gyro_noise: float = setting(1.2e-4, "gyroscope white noise", unit="rad/s/sqrt(Hz)", above=0, at_most=1)
    accel_noise: float = setting(1.1e-3, "accelerometer white noise", unit="m/s^2/sqrt(Hz)", above=0, at_most=5)
    # With smaller walks the smoother's equations are singular to working precision.
    gyro_bias_walk: float = setting(1.0e-6, "gyroscope bias random walk", unit="rad/s^2/sqrt(Hz)", at_least=1e-10)
    accel_bias_walk: float = setting(1.0e-5, "accelerometer bias random walk", unit="m/s^3/sqrt(Hz)", at_least=1e-8)
    gyro_bias_sigma: float = setting(5.0e-4, "gyroscope turn-on bias left after warm-up", unit="rad/s", above=0)
    accel_bias_sigma: float = setting(5.0e-2, "accelerometer turn-on bias left after warm-up", unit="m/s^2", above=0)
    noise_from_readings: bool = setting(
        True, "take the white noise that the readings show where it is more than twice the configured one"
    )
    gravity: float = setting(9.80665, "local gravity, along -z of the map frame", unit="m/s^2", above=0)


THESIS_STEP_S = 0.14  # its control noise is drawn once per step; ours is white at the IMU rate, with the same effect
THESIS_NOISE = ((1.0, 1.8), (2.0, 3.6), (2.0, 5.6), (4.0, 11.2))  # w1 to w4 of section 4.7.1 [deg/s], [m/s^2]


def _thesis_noise(rate_deg: float, accel: float) -> ImuConfig:
    return ImuConfig(
        gyro_noise=math.radians(rate_deg) * math.sqrt(THESIS_STEP_S), accel_noise=accel * math.sqrt(THESIS_STEP_S)
    )


IMU_GRADES = {
    "adis16480": ImuConfig(),
    "consumer": ImuConfig(
        gyro_noise=5.0e-4,
        accel_noise=4.0e-3,
        gyro_bias_walk=1.0e-5,
        accel_bias_walk=1.0e-4,
        gyro_bias_sigma=3.0e-3,
        accel_bias_sigma=2.0e-1,
    ),
    "thesis_half": _thesis_noise(0.5, 0.9),  # sigma_w = 0.5 of section 7.3.2, taken as half of w1
} | {f"thesis_w{k}": _thesis_noise(rate_deg, accel) for k, (rate_deg, accel) in enumerate(THESIS_NOISE, start=1)}
