# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.offline.track import track_vehicle
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.simulation.terrain import ground_of
from uav_vslam.studies.engine.flights import kagaru_configs
from uav_vslam.studies.engine.kept_flights import kept_flights

SCENARIO = Scenario(seed=2, frames=8, scale=0.5, vehicles=1)


@pytest.mark.slow
def test_features_found_beforehand_give_the_poses_of_the_pipeline_and_each_image_its_view() -> None:
    (flight,) = kept_flights(SCENARIO, ground_of(SCENARIO))
    config = kagaru_configs({"": {}})[""]
    reference = track_vehicle(SimulatedSource(flight.simulated), config)
    assert len(reference.outputs) == SCENARIO.frames
    for ours, output in zip(flight.poses("s_slam"), reference.outputs, strict=True):
        np.testing.assert_array_equal(ours.T_map_body.matrix, output.report.pose.T_map_body.matrix)
    views = list(flight.views("smoothed"))
    assert [view.stamp_ns for view in views] == flight.simulated.frame_stamps_ns.tolist()
    placed = flight.simulated.truth.pose(0.0) @ flight.simulated.rig.T_body_left
    np.testing.assert_allclose(next(flight.views("truth")).T_map_cam.matrix, placed.matrix, atol=1e-9)
