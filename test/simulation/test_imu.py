# SPDX-License-Identifier: Apache-2.0
"""IMU errors have the configured size."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import IMU_GRADES
from uav_vslam.simulation.imu import ideal_imu, simulate_imu
from uav_vslam.simulation.scenario import SCENARIOS, simulate_vehicle

TRUTH = simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], frames=200), 0).truth
STAMPS = TRUTH.start_ns + np.arange(0, 25_000_000_000, 5_000_000, dtype=np.int64)


@pytest.mark.parametrize("grade", sorted(IMU_GRADES))
def test_white_noise_is_density_times_root_rate(grade: str) -> None:
    config = IMU_GRADES[grade]
    imu = simulate_imu(TRUTH, STAMPS, config, rng=np.random.default_rng(3))
    ideal = ideal_imu(TRUTH, STAMPS, gravity=config.gravity)
    gyro_noise = imu.gyro - ideal.gyro - imu.gyro_bias
    accel_noise = imu.accel - ideal.accel - imu.accel_bias
    assert gyro_noise.std() == pytest.approx(config.gyro_noise * np.sqrt(200.0), rel=0.03)
    assert accel_noise.std() == pytest.approx(config.accel_noise * np.sqrt(200.0), rel=0.03)


def test_biases_start_with_their_sigma_and_walk() -> None:
    config = IMU_GRADES["consumer"]
    runs = [simulate_imu(TRUTH, STAMPS[:400], config, rng=np.random.default_rng(k)) for k in range(200)]
    start = np.array([r.accel_bias[0] for r in runs])
    walked = np.array([r.accel_bias[-1] - r.accel_bias[0] for r in runs])
    assert start.std() == pytest.approx(config.accel_bias_sigma, rel=0.1)
    assert walked.std() == pytest.approx(config.accel_bias_walk * np.sqrt(399 * 0.005), rel=0.1)


def test_samples_equal_the_arrays() -> None:
    imu = simulate_imu(TRUTH, STAMPS[:5], IMU_GRADES["adis16480"], rng=np.random.default_rng(0))
    samples = imu.samples()
    assert [s.stamp_ns for s in samples] == STAMPS[:5].tolist()
    np.testing.assert_array_equal(np.array([s.gyro for s in samples]), imu.gyro)
    np.testing.assert_array_equal(np.array([s.accel for s in samples]), imu.accel)
