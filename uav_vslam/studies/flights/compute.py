# SPDX-License-Identifier: Apache-2.0
"""Rendered flights of the default estimator."""

from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.flights import Method, kagaru_configs

IMUS = ("adis16480", "consumer")


def methods(frames: int) -> list[Method]:
    """Rendered images through the front end, with both grades of inertial unit."""
    (config,) = kagaru_configs({"": {}}).values()
    return [
        Method("ri15", f"rendered, {frames} frames, {imu}", Scenario(frames=frames, imu=imu), config, rendered=True)
        for imu in IMUS
    ]
