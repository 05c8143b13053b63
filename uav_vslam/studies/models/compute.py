# SPDX-License-Identifier: Apache-2.0
"""The default estimator and its variations, at landmark level."""

from uav_vslam.config import VehicleConfig
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.flights import Method, with_backend


def methods(frames: int) -> list[Method]:
    """Landmark level, 1 px: the default, and variants with one component changed."""
    scenario = Scenario(frames=frames)
    condition = f"landmarks, {frames} frames, 1 px, {scenario.imu}"
    default = VehicleConfig()
    return [
        Method("ri15", condition, scenario, default),
        Method("ri15, no depth smoothing", condition, scenario, with_backend(default, depth_sigma_ratio=0.0)),
        Method("so15", condition, scenario, with_backend(default, model="so15")),
        Method("euler9", condition, scenario, with_backend(default, model="euler9", depth_sigma_ratio=0.0)),
    ]
