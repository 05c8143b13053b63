# SPDX-License-Identifier: Apache-2.0
"""Flights whose tracks have known errors."""

import numpy as np
import pytest

from uav_vslam.evaluation.result import FlightResult, LinkCounters, VehicleResult
from uav_vslam.evaluation.trajectory import Trajectory


def straight(offset_m: float, *, sigma_m: float = 0.5, north_m: float = 0.0) -> Trajectory:
    """Return 100 poses eastward at 20 m/s, `offset_m` too far north at the end."""
    t = 0.1 * np.arange(100)
    positions = np.stack([20 * t, north_m + offset_m * t / t[-1], np.full(100, 70.0)], axis=1)
    quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (100, 1))
    stamps_ns = 10**18 + 100_000_000 * np.arange(100, dtype=np.int64)
    return Trajectory(stamps_ns, positions, quaternions, np.tile(sigma_m**2 * np.eye(6), (100, 1, 1)))


def make_flight(*, peers: bool, truth_known: bool = True, ins_end_m: float = 30.0) -> FlightResult:
    """Return a flight of one vehicle, or of two that cooperate."""
    vehicles = {
        name: VehicleResult(
            name=name,
            truth=straight(0.0, north_m=north_m) if truth_known else None,
            ins=straight(ins_end_m, north_m=north_m),
            s_slam=straight(2.0, north_m=north_m),
            c_slam=straight(1.0, north_m=north_m) if peers else None,
            frames_in=101,
            frames_processed=100,
            link=LinkCounters(18234.0, 10, 9, 8, {"stale": 1}) if peers else LinkCounters(),
        )
        for name, north_m in (("uav1", 0.0), ("uav2", 40.0))[: 2 if peers else 1]
    }
    return FlightResult("test flight", 5 if peers else None, "wideband" if peers else "none", 9.9, 3.3, vehicles)


@pytest.fixture
def pair() -> FlightResult:
    """Two cooperating vehicles."""
    return make_flight(peers=True)


@pytest.fixture
def single() -> FlightResult:
    """One vehicle whose INS drifts far out of view."""
    return make_flight(peers=False, ins_end_m=5000.0)


@pytest.fixture
def blind() -> FlightResult:
    """One vehicle without ground truth."""
    return make_flight(peers=False, truth_known=False)
