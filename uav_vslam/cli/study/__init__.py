# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study`: methods compared over many runs. One module a study: HELP, EXAMPLES, add_arguments, run."""

from __future__ import annotations

import argparse

from uav_vslam.cli.study import (
    association,
    euroc,
    faults,
    features,
    filters,
    flights,
    frames,
    front_end,
    fusion,
    live,
    long,
    models,
    outliers,
    radio,
    revisit,
    rig,
    start,
    thesis,
)

HELP = "compare methods over many flights"
EXAMPLES = """examples:
  uav-vslam study models --seeds 20        landmark level: INS, S-SLAM, C-SLAM and the thesis's model; minutes
  uav-vslam study fusion                   landmark level: ways to fuse, bad radios, large fleets; over an hour
  uav-vslam study frames                   landmark level: maps that lie anywhere, landmarks mistaken; minutes
  uav-vslam study thesis                   landmark level: the thesis's cooperative simulation; half an hour
  uav-vslam study flights --seeds 8        rendered images, both inertial grades; about a quarter of an hour
  uav-vslam study radio                    rendered images, the node graph over DDS in both packet modes; an hour
  uav-vslam study live                     rendered images, the node graph in real time on this machine; a minute
  uav-vslam study filters                  landmark level: every filter with every state model; an hour
  uav-vslam study long                     landmark level: 2.8 km with each retention policy; minutes
  uav-vslam study revisit                  landmark level and rendered: back over the start after 2 km; an hour
  uav-vslam study rig                      rendered images, a right camera that vibrates or is turned; an hour
  uav-vslam study outliers                 landmark level: wrong matches, far ones and look-alikes; an hour
  uav-vslam study features                 extractors on image pairs of several places and bands; minutes
  uav-vslam study front_end                rendered images: points followed, points matched anew; an hour
  uav-vslam study faults                   rendered images: cameras that fail for a while; an hour
  uav-vslam study euroc V1_01_easy/mav0    a recording with truth, by every filter from many starts; an hour
  uav-vslam study association              rendered images: every associator and matcher; a quarter of an hour
  uav-vslam study start                    landmark level: no start state, and wrong ones; minutes
  uav-vslam study STUDY --help             arguments and examples of one study
"""
STUDIES = {
    "models": models,
    "fusion": fusion,
    "thesis": thesis,
    "frames": frames,
    "features": features,
    "flights": flights,
    "front_end": front_end,
    "faults": faults,
    "live": live,
    "radio": radio,
    "filters": filters,
    "long": long,
    "revisit": revisit,
    "rig": rig,
    "outliers": outliers,
    "euroc": euroc,
    "start": start,
    "association": association,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the studies."""
    studies = parser.add_subparsers(title="studies", metavar="STUDY", required=True)
    for name, module in STUDIES.items():
        study = studies.add_parser(
            name,
            help=module.HELP,
            description=module.HELP[:1].upper() + module.HELP[1:] + ".",
            epilog=module.EXAMPLES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(study)
        study.set_defaults(run_study=module.run)


def run(args: argparse.Namespace) -> int:
    """Run the chosen study."""
    return int(args.run_study(args))
