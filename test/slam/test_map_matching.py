# SPDX-License-Identifier: Apache-2.0
"""Whatever the configured associator, the back end recognises its landmarks with it."""

import numpy as np
import pytest

from uav_vslam.config import ASSOCIATIONS, load_vehicle
from uav_vslam.offline.track import track_vehicle
from uav_vslam.simulation.landmarks import LandmarkField, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource

FRAMES = 8


@pytest.fixture(scope="module")
def flight() -> tuple[SimulatedVehicle, LandmarkField]:
    vehicle = simulate_vehicle(Scenario(frames=FRAMES, vehicles=1), 0)
    return vehicle, scatter_landmarks([vehicle])


@pytest.mark.parametrize("association", ASSOCIATIONS)
def test_every_associator_sustains_a_flight(flight: tuple[SimulatedVehicle, LandmarkField], association: str) -> None:
    """A landmark is new or leaves the image in some frames: of 44 in view some 30 are known."""
    config = load_vehicle(None, overrides={"backend.association": association})
    vehicle, field = flight
    track = track_vehicle(SimulatedSource(vehicle, field), config)
    associated = np.array([output.report.associated for output in track.outputs])[1:]
    least = 4 if association == "cds" else 15
    assert (associated >= least).all(), associated
    end = track.outputs[-1].report.pose.T_map_body.t
    truth = vehicle.truth.position(float(vehicle.frame_times_s[-1]))
    assert np.linalg.norm(end - truth) < 0.5
