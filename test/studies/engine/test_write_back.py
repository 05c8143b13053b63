# SPDX-License-Identifier: Apache-2.0
"""The thesis's ways to share a map do what they were known to do: double-count until the filter believes too much."""

import numpy as np
import pytest

from uav_vslam.config import VehicleConfig
from uav_vslam.evaluation.consistency import nees
from uav_vslam.simulation.landmarks import LandmarkNoise
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.own_only import Flight, prepare, run_backend
from uav_vslam.studies.engine.write_back import WRITE_BACK, fly_with_write_back

FRAMES = 160


@pytest.fixture(scope="module")
def flights() -> list[Flight]:
    return prepare(Scenario(frames=FRAMES), LandmarkNoise())


def test_without_a_word_between_them_each_flies_as_if_alone(flights: list[Flight]) -> None:
    tracks = fly_with_write_back(flights, VehicleConfig(), lambda *_: None)
    for flight in flights:
        alone = run_backend(flight, config=VehicleConfig()).estimate
        np.testing.assert_array_equal(tracks[flight.vehicle.name].estimate.positions, alone.positions)


def test_intersecting_each_landmark_alone_grows_too_sure(flights: list[Flight]) -> None:
    tracks = fly_with_write_back(flights, VehicleConfig(), WRITE_BACK["landmark_ci"])
    for flight in flights:
        track, alone = tracks[flight.vehicle.name], run_backend(flight, config=VehicleConfig())
        assert not track.failure
        known, of_alone = (np.trace(t.estimate.covariance[-1][:3, :3]) for t in (track, alone))
        assert known < 0.5 * of_alone  # two equal vehicles can at best halve a variance
        found = nees(track.estimate, flight.truth)
        assert found is not None
        assert found.position[20:].mean() > 1.4


@pytest.mark.parametrize("name", ["overwrite", "deltas"])
def test_overwriting_and_deltas_break_the_filter_down(flights: list[Flight], name: str) -> None:
    tracks = fly_with_write_back(flights, VehicleConfig(), WRITE_BACK[name])
    for track in tracks.values():
        assert track.failure
        assert len(track.estimate) < FRAMES
