# SPDX-License-Identifier: Apache-2.0
"""A flight of one vehicle with made-up errors, for what reads and writes results."""

import numpy as np

from uav_vslam.evaluation.result import FlightResult, VehicleResult
from uav_vslam.evaluation.trajectory import Trajectory

RNG = np.random.default_rng(11)


def track(error_m: float, *, rate_hz: int = 10, known: bool = True) -> Trajectory:
    """Return 20 s eastward at 10 m/s with a random walk of the position."""
    count = 20 * rate_hz
    t = np.arange(count) / rate_hz
    walk = np.cumsum(RNG.normal(0.0, error_m / rate_hz, (count, 3)), axis=0)
    positions = np.stack([10.0 * t, 3.0 * np.sin(0.3 * t), 50.0 + t], axis=1) + walk
    covariance = np.tile(0.25 * np.eye(6), (count, 1, 1)) if known else None
    stamps_ns = 1_700_000_000_000_000_007 + (10**9 // rate_hz) * np.arange(count, dtype=np.int64)
    return Trajectory(stamps_ns, positions, np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), covariance)


TRUTH = track(0.0, rate_hz=100, known=False)
VEHICLE = VehicleResult(
    "uav1", TRUTH, track(3.0, rate_hz=50), track(0.5), track(0.3), frames_in=200, frames_processed=200
)
FLIGHT = FlightResult("made up", None, "wideband", 20.0, 0.0, {"uav1": VEHICLE})
