# SPDX-License-Identifier: Apache-2.0
"""Rendered flights of the default estimator."""

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.flights import Method, kagaru_configs

DEFAULT = "ri15"  # the configuration as it is

NOTES = {
    "Errors": "root mean squares over the seeds and vehicles, in the common frame; ate_rms_m and height_rms_m without "
    "alignment. Relative errors (rpe) are of the motion over segments of the path, along and across a segment's chord "
    "and in height; attitude is the angle of the rotation about all axes",
    "Times": "processor time for a frame of one vehicle: ms_front_end without rendering, ms_per_frame of all after it; "
    "of the smoothed track, ms_per_frame is that of smoothing alone",
}


def scenario_of(args: argparse.Namespace) -> Scenario:
    """Return the flight that the arguments describe.

    Raises:
        ConfigError: a pattern is not known, or a number out of range.
    """
    return Scenario(
        frames=args.frames,
        vehicles=args.vehicles,
        pattern=args.pattern,
        frame_rate_hz=args.rate,
        contrast=args.contrast,
        blur_px=args.blur,
    )


def notes(scenario: Scenario) -> dict[str, str]:
    """Return what was flown and what the figures mean."""
    flown = f"pattern {scenario.pattern}, {scenario.frames} rendered frames at {scenario.frame_rate_hz:g} Hz"
    seen = f"contrast {scenario.contrast:g}, motion blur {scenario.blur_px:g} px"
    vehicles = f"{scenario.vehicles} vehicle(s)"
    return {"Flights": f"{flown}, {seen}, {vehicles}; the condition is the class of inertial unit"} | NOTES


def methods(
    scenario: Scenario, imus: Sequence[str], variants: Mapping[str, dict[str, Any]], *, smoothing: bool
) -> list[Method]:
    """Return every variant of the configuration with each grade of inertial unit.

    Args:
        scenario: the flight.
        imus: names of `IMU_GRADES`.
        variants: overrides by name; none flies the configuration as it is.
        smoothing: smooth each whole flight afterwards.
    """
    configs = kagaru_configs(variants or {DEFAULT: {}})
    return [
        Method(name, imu, dataclasses.replace(scenario, imu=imu), config, rendered=True, smoothing=smoothing)
        for imu in imus
        for name, config in configs.items()
    ]
