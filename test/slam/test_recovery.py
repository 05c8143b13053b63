# SPDX-License-Identifier: Apache-2.0
"""Re-initialised estimates: wider, but never so wide that the next filter fails at once."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import VehicleConfig
from uav_vslam.estimation.filters import make_filter
from uav_vslam.ins.propagation import GYRO_BIAS, POSITION, ROTATION, VELOCITY
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle
from uav_vslam.slam.recovery import INFLATION, MOST_POSITION_SIGMA, reinitialised
from uav_vslam.types import NavEstimate

IMU = VehicleConfig().imu
RECOVERIES = 60


@pytest.fixture(scope="module")
def vehicle() -> SimulatedVehicle:
    return simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], frames=3, vehicles=1, seed=3), 0)


def test_a_good_estimate_is_inflated_by_the_factor(vehicle: SimulatedVehicle) -> None:
    start = dataclasses.replace(vehicle.initial, covariance=0.1 * vehicle.initial.covariance)
    again = reinitialised(start, since_s=10.0, imu=IMU)
    assert again.state is start.state
    np.testing.assert_allclose(again.covariance, INFLATION * start.covariance, rtol=1e-12)


def test_however_many_follow_each_other_no_axis_is_wider_than_when_nothing_is_known(vehicle: SimulatedVehicle) -> None:
    estimate = vehicle.initial
    for _ in range(RECOVERIES):
        estimate = reinitialised(estimate, since_s=0.2, imu=IMU)
        make_filter(estimate, rig=vehicle.rig, config=VehicleConfig())
    sigma, speed = np.sqrt(np.diag(estimate.covariance)), np.linalg.norm(estimate.state.v_map)
    assert sigma[ROTATION].max() < np.pi
    assert sigma[VELOCITY].max() < speed + 15.1
    assert sigma[GYRO_BIAS].max() <= np.hypot(IMU.gyro_bias_sigma, np.linalg.norm(estimate.state.gyro_bias)) + 1e-12
    assert sigma[POSITION].max() < 0.2 * np.sqrt(RECOVERIES) * (speed + 16.0)


@pytest.mark.parametrize("damage", ["indefinite", "not finite", "too large"])
def test_a_damaged_covariance_becomes_one_that_a_filter_can_start_with(vehicle: SimulatedVehicle, damage: str) -> None:
    P = vehicle.initial.covariance.copy()
    if damage == "indefinite":
        P[0, 3] = P[3, 0] = 2.0 * np.sqrt(P[0, 0] * P[3, 3])
    else:
        P[6, 6] = np.nan if damage == "not finite" else 1e30
    again = reinitialised(NavEstimate(vehicle.initial.state, P), since_s=1e6, imu=IMU)
    started = make_filter(again, rig=vehicle.rig, config=VehicleConfig()).nav_estimate()
    assert np.isfinite(started.covariance).all()
    assert np.sqrt(np.diag(started.covariance)[POSITION]).max() <= MOST_POSITION_SIGMA
