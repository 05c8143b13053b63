# SPDX-License-Identifier: Apache-2.0
"""Simulated flights as bags: instruments, rendered images and the truth."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from uav_vslam.datasets.flight_writer import FlightRecording, ImageCoding, write_flights
from uav_vslam.datasets.messages import TruthSample
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.terrain import Ground, ground_of
from uav_vslam.types import NS_PER_S

TRUTH_RATE_HZ = 50


def record(
    scenario: Scenario,
    out: Path,
    *,
    coding: ImageCoding | None = None,
    storage: str = "mcap",
    zstd: bool = False,
    on_frame: Callable[[], None] = lambda: None,
) -> None:
    """Simulate a whole fleet into one bag.

    Raises:
        BagError: `out` exists.
        ConfigError: the scenario's texture can't be read.
    """
    ground = ground_of(scenario)
    flights = [recording_of(vehicle, ground) for vehicle in simulate_fleet(scenario)]
    write_flights(out, flights, coding=coding, storage=storage, zstd=zstd, on_frame=on_frame)


def recording_of(vehicle: SimulatedVehicle, ground: Ground) -> FlightRecording:
    """Return what is recorded of one simulated vehicle; images are drawn as they are written."""
    return FlightRecording(
        vehicle=vehicle.name,
        rig=vehicle.rig,
        imu=vehicle.imu.samples(),
        truth=_truth(vehicle),
        frames=RenderedFlight(vehicle, ground),
        initial=vehicle.initial,
    )


def _truth(vehicle: SimulatedVehicle) -> Iterator[TruthSample]:
    """Yield the true motion at a fixed rate and at each frame."""
    frames = vehicle.frame_stamps_ns
    regular = np.arange(frames[0], frames[-1] + 1, NS_PER_S // TRUTH_RATE_HZ)
    stamps = np.union1d(regular, frames)
    truth, t = vehicle.truth, vehicle.truth.time_s(stamps)
    columns = zip(
        stamps, truth.rotation(t), truth.position(t), truth.velocity(t), truth.angular_rate_body(t), strict=True
    )
    for stamp, R, p, v, rate in columns:
        yield TruthSample(int(stamp), Pose(R, p), v, rate)
