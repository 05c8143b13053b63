# SPDX-License-Identifier: Apache-2.0
"""Maps of simulated flights with their true landmarks."""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from uav_vslam.config import RigConfig, VehicleConfig
from uav_vslam.offline.track import track_vehicle
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.landmarks import LandmarkField, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.saved_map import MapSection, SavedMap
from uav_vslam.vision.matching.nn_ratio import squared_distances


@dataclass(frozen=True)
class Mapped:
    """A flight that kept its map, and the fleet over the same ground."""

    vehicles: list[SimulatedVehicle]
    field: LandmarkField
    config: VehicleConfig
    track: VehicleTrack

    @property
    def saved(self) -> SavedMap:
        """The map."""
        assert self.track.saved_map is not None
        return self.track.saved_map

    def errors_m(self, section: MapSection) -> np.ndarray:
        """Return (N, 3) position errors: the nearest descriptor tells which landmark each is."""
        nearest = squared_distances(section.descriptors, self.field.descriptors).argmin(axis=1)
        return section.positions - self.field.points_world[nearest]


@functools.cache
def _mapped(seed: int, *, frames: int = 48, rig: RigConfig | None = None) -> Mapped:
    vehicles = simulate_fleet(Scenario(seed=seed, frames=frames))
    field = scatter_landmarks(vehicles)
    config = VehicleConfig(imu=vehicles[0].scenario.imu_config, rig=rig or RigConfig())
    track = track_vehicle(SimulatedSource(vehicles[0], field), config, keep_map=True)
    return Mapped(vehicles, field, config, track)


@pytest.fixture(scope="session")
def mapped() -> Callable[..., Mapped]:
    """Return a factory of maps: `mapped(seed, frames=48, rig=None)`."""
    return _mapped


@pytest.fixture(scope="session")
def saved(mapped: Callable[..., Mapped]) -> SavedMap:
    """Return a map that was started from another one, and whose datum is known."""
    of_flight = mapped(1).saved
    origin = dataclasses.replace(of_flight.origin, other_sources=("uav7/3",), datum=(-28.2, 153.0, 20.0))
    return SavedMap(origin, of_flight.sections)
