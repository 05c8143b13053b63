# SPDX-License-Identifier: Apache-2.0
"""A simulated flight and the readings of an ideal IMU."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from uav_vslam.simulation.imu import ideal_imu
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle
from uav_vslam.types import NS_PER_S, ImuSample

Readings = Callable[[float, float, int], list[ImuSample]]


@pytest.fixture(scope="session")
def flight() -> SimulatedVehicle:
    """A rough, turning flight of 8 s."""
    return simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], frames=60), 0)


@pytest.fixture(scope="session")
def readings(flight: SimulatedVehicle) -> Readings:
    """Return a function for error-free readings of `count` intervals over `duration_s` from `start_s`."""

    def make(start_s: float, duration_s: float, count: int) -> list[ImuSample]:
        start_ns = flight.truth.start_ns + round(start_s * NS_PER_S)
        stamps = start_ns + np.round(np.arange(count + 1) * (duration_s * NS_PER_S / count)).astype(np.int64)
        return ideal_imu(flight.truth, stamps, gravity=flight.scenario.imu_config.gravity).samples()

    return make
