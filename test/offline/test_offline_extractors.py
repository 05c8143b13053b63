# SPDX-License-Identifier: Apache-2.0
"""Every extractor works in the whole pipeline: images, map, filter."""

import dataclasses

import pytest

from uav_vslam.config import FrontendConfig, VehicleConfig
from uav_vslam.offline.track import track_vehicle
from uav_vslam.simulation.scenario import SCENARIOS, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.vision.features import EXTRACTORS

ON_A_GRID = {"dsift", "phow_rgb", "phow_hsv", "phow_opponent"}


@pytest.fixture(scope="module")
def source() -> SimulatedSource:
    """Two frames: one initialises the map, one is matched with it."""
    return SimulatedSource(simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], frames=2, vehicles=1), 0))


@pytest.mark.parametrize("name", sorted(EXTRACTORS))
def test_a_pair_of_frames_is_tracked_with_each_extractor(source: SimulatedSource, name: str) -> None:
    scale = 0.125 if name == "asift" else 0.5  # it simulates 61 views
    config = VehicleConfig(frontend=FrontendConfig(extractor=name, scale=scale, max_features=500))
    track = track_vehicle(source, config)
    first, second = (output.report for output in track.outputs)
    assert track.dropped == {}
    if name not in ON_A_GRID:  # matches accurate to half a grid step: possibly none passes the stereo gate
        assert second.tracked > 20 or first.landmarks > 20
        assert second.associated > 10
