# SPDX-License-Identifier: Apache-2.0
"""The IMU elsewhere in the body reads what a rigid body feels there."""

import numpy as np

from uav_vslam.geometry.pose import Pose
from uav_vslam.ins.mounting import ImuMounting
from uav_vslam.simulation.imu import ideal_imu
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.studies.recordings.ways import T_BODY_IMU, twice_as_fast


def test_readings_of_the_other_imu_average_to_the_plain_ones() -> None:
    vehicle = simulate_vehicle(Scenario(seed=2, vehicles=1, frames=10), 0)
    fast = twice_as_fast(vehicle, Pose.identity())
    stamps = np.array([sample.stamp_ns for sample in fast])
    assert len(stamps) == 2 * len(vehicle.imu.stamps_ns)
    true = ideal_imu(vehicle.truth, stamps, gravity=vehicle.scenario.imu_config.gravity).gyro
    errors = (np.array([sample.gyro for sample in fast]) - true).reshape(-1, 2, 3)
    plain = ideal_imu(vehicle.truth, vehicle.imu.stamps_ns, gravity=vehicle.scenario.imu_config.gravity).gyro
    np.testing.assert_allclose(errors.mean(axis=1), vehicle.imu.gyro - plain, atol=1e-12)
    noise = np.std(errors[:, 1] - errors[:, 0], axis=0)
    np.testing.assert_allclose(noise, 2.0 * 1.2e-4 * np.sqrt(200.0), rtol=0.2)  # of a difference at 400 Hz


def test_moved_back_to_the_body_they_are_those_of_an_imu_there() -> None:
    vehicle = simulate_vehicle(Scenario(seed=2, vehicles=1, frames=10), 0)
    mounting = ImuMounting(T_BODY_IMU)
    moved = [mounting.to_body(sample) for sample in twice_as_fast(vehicle, T_BODY_IMU)]
    expected = twice_as_fast(vehicle, Pose.identity())
    np.testing.assert_allclose([s.gyro for s in moved], [s.gyro for s in expected], atol=1e-12)
    apart = np.array([s.accel for s in moved[1:]]) - [s.accel for s in expected[1:]]
    # dw/dt of two noisy readings, times the arm: white, and it telescopes in the velocity
    assert abs(apart.mean(axis=0)).max() < 2e-3
    sigma = 1.2e-4 * 20.0 * 0.3 * np.sqrt(2.0)  # of the velocity [m/s]
    assert abs(np.cumsum(apart, axis=0)).max() / 400.0 < 6.0 * sigma
