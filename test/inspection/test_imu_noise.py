# SPDX-License-Identifier: Apache-2.0
"""The noise density comes out as simulated, whatever the rate and the motion below the band."""

import numpy as np
import pytest

from uav_vslam.config import ImuConfig
from uav_vslam.inspection.finding import Severity
from uav_vslam.inspection.imu_noise import at_rest, check_noise, noise_levels, recommended
from uav_vslam.types import NS_PER_S

IMU = ImuConfig(gyro_noise=2e-4, accel_noise=3e-3)
SHARE = 0.08  # 3 sigma of a density over 20 s at 100 Hz: 750 degrees of freedom, and the windows' overlap


def readings(rate_hz: float, seconds: float, *, moving: bool, seed: int = 1) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    count = round(rate_hz * seconds)
    stamps = np.round(np.arange(count) * NS_PER_S / rate_hz).astype(np.int64)
    t = np.arange(count)[:, None] / rate_hz
    motion = np.sin(2 * np.pi * np.array([1.1, 2.3, 3.7]) * t) if moving else np.zeros((count, 3))
    gyro = 0.3 * motion + 0.01 + rng.normal(0.0, IMU.gyro_noise * np.sqrt(rate_hz), (count, 3))
    accel = 2.0 * motion + [0.0, 0.0, 9.81] + rng.normal(0.0, IMU.accel_noise * np.sqrt(rate_hz), (count, 3))
    return stamps, gyro, accel


@pytest.mark.parametrize("rate_hz", [100.0, 200.0, 400.0])
@pytest.mark.parametrize("moving", [False, True])
def test_the_density_is_found_at_rest_and_in_flight(rate_hz: float, moving: bool) -> None:
    stamps, gyro, accel = readings(rate_hz, 20.0, moving=moving)
    levels = noise_levels(stamps, gyro, accel, IMU, at_rest(stamps, gyro, accel))
    for sensor, true in (("gyroscope", IMU.gyro_noise), ("accelerometer", IMU.accel_noise)):
        measured = levels[sensor].flight if moving else levels[sensor].rest
        assert measured is not None
        np.testing.assert_allclose(measured, true, rtol=SHARE)
    assert all(finding.severity is Severity.OK for finding in check_noise(levels))
    assert recommended(levels) == {}


def test_vibration_of_one_axis_is_named_with_the_density_to_set() -> None:
    stamps, gyro, accel = readings(200.0, 20.0, moving=True)
    accel[:, 1] += np.random.default_rng(2).normal(0.0, 0.02 * np.sqrt(200.0), len(accel))
    levels = noise_levels(stamps, gyro, accel, IMU, at_rest(stamps, gyro, accel))
    (loud,) = [finding for finding in check_noise(levels) if finding.severity is Severity.WARNING]
    assert loud.subject == "accelerometer noise"
    assert "too much on y (" in loud.seen
    assert "x (" not in loud.seen
    setting = recommended(levels)
    assert list(setting) == ["imu.accel_noise"]
    assert setting["imu.accel_noise"] == pytest.approx(np.hypot(0.02, IMU.accel_noise), rel=SHARE)


def test_vibration_at_one_frequency_is_measured_but_nothing_to_configure() -> None:
    stamps, gyro, accel = readings(200.0, 20.0, moving=True)
    accel[:, 2] += 1.0 * np.sin(2 * np.pi * 73.0 * stamps / NS_PER_S)
    levels = noise_levels(stamps, gyro, accel, IMU, at_rest(stamps, gyro, accel))
    flight = levels["accelerometer"].flight
    assert flight is not None
    assert flight[2] == pytest.approx(np.sqrt(0.5 / 75.0 / 2.0), rel=0.1)  # its power, spread over the band
    assert recommended(levels) == {}


def test_a_gap_and_a_rest_before_the_flight_do_not_change_the_densities() -> None:
    stamps, gyro, accel = readings(200.0, 40.0, moving=True)
    quiet = readings(200.0, 20.0, moving=False, seed=5)
    gyro[: len(quiet[1])], accel[: len(quiet[2])] = quiet[1], quiet[2]
    kept = np.r_[0:5000, 5400 : len(stamps)]
    stamps, gyro, accel = stamps[kept], gyro[kept], accel[kept]
    levels = noise_levels(stamps, gyro, accel, IMU, at_rest(stamps, gyro, accel))
    for measured in (levels["gyroscope"].rest, levels["gyroscope"].flight):
        assert measured is not None
        np.testing.assert_allclose(measured, IMU.gyro_noise, rtol=SHARE)


def test_without_readings_nothing_is_said() -> None:
    empty = np.zeros((0, 3))
    levels = noise_levels(np.zeros(0, np.int64), empty, empty, IMU, np.zeros(0, bool))
    assert check_noise(levels) == []
    assert recommended(levels) == {}
