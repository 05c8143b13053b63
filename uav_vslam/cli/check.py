# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam check`: judge recordings before they are run, all faults at once."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.cli.arguments import output_file
from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.recordings import add_configuration, bags_and_configs

if TYPE_CHECKING:
    from uav_vslam.config import InputConfig, VehicleConfig
    from uav_vslam.datasets.survey import Survey
    from uav_vslam.inspection.recording import Inspection

HELP = "judge a recording before it is run: topics, stamps, IMU, calibration, images, start, truth"
EXAMPLES = """examples:
  uav-vslam check flight                              every vehicle of a bag, with the default settings
  uav-vslam check flight --config mine.yaml           with your topics, calibration and IMU noise
  uav-vslam check config/fleet_demo.yaml              a fleet file: vehicles, configurations, recordings
  uav-vslam check flight --json check.json            for programs as well

exit codes: 0 the graph can run (warnings allowed), 1 it can't, 2 wrong arguments or no readable bag
"""
CANT_RUN = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("inputs", nargs="+", type=Path, metavar="BAG|FLEET.yaml", help="bags, or one fleet file")
    add_configuration(parser)
    parser.add_argument("--json", type=output_file, metavar="FILE", help="also write the findings into a file")


def run(args: argparse.Namespace) -> int:
    """Check, print, and return whether the graph can run."""
    import cv2

    from uav_vslam.evaluation.files.writing import write_json
    from uav_vslam.inspection.report import text, tree

    cv2.setNumThreads(1)
    bags, configs = bags_and_configs(args, _vehicles)
    judged = _judge(bags, configs)
    try:
        print("\n\n".join(text(survey, inspection) for survey, inspection in judged))  # a full disk must not cost it
    finally:  # nor a reader that has closed the pipe the file
        if args.json:
            write_json(args.json, {"vehicles": [tree(survey, inspection) for survey, inspection in judged]})
    return 0 if all(inspection.usable for _, inspection in judged) else CANT_RUN


def _vehicles(requested: Sequence[str] | None, bags: tuple[Path, ...], config: InputConfig) -> list[str]:
    """Return the vehicles to check: those requested, or all in the bags."""
    from uav_vslam.datasets.rosbag import topics_of
    from uav_vslam.errors import ConfigError
    from uav_vslam.inspection.vehicles import vehicles_of

    topics = topics_of(bags)
    found = vehicles_of(topics, config)
    recorded = [name for name in found if any(topic.startswith(f"/{name}/") for topic in topics)]
    unknown = sorted(set(requested or ()) - set(recorded))
    if recorded and unknown:
        raise ConfigError(f"--vehicles {' '.join(unknown)}: not recorded; the bag holds {', '.join(recorded)}")
    return list(requested or found)


def _judge(bags: tuple[Path, ...], configs: dict[str, VehicleConfig]) -> list[tuple[Survey, Inspection]]:
    """Read and judge each vehicle's recording."""
    from uav_vslam.datasets.rosbag import topics_of
    from uav_vslam.inspection.recording import inspect_bags, messages_to_read

    recorded = topics_of(bags)
    messages = sum(messages_to_read(recorded, name, config) for name, config in configs.items())
    with progress_bar("checking", messages) as advance:
        return [inspect_bags(bags, name, config, advance) for name, config in configs.items()]
