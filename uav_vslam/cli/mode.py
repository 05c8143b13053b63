# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam mode`: read or switch a flying vehicle's communication mode, without the `ros2` command."""

import argparse

from uav_vslam.argument_types import namespace, positive_seconds
from uav_vslam.cli.arguments import MODES, add_domain

HELP = "read or switch the communication mode of a flying vehicle"
EXAMPLES = """examples:
  uav-vslam mode uav1                 print it
  uav-vslam mode uav1 narrowband      switch: wideband, narrowband or none
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("vehicle", type=_vehicle, metavar="VEHICLE", help="its name")
    parser.add_argument("mode", nargs="?", choices=MODES, help="new mode; without it the present one is printed")
    add_domain(parser)
    parser.add_argument(
        "--wait", type=positive_seconds, default=5.0, metavar="S", help="time to find the vehicle [s] (default 5)"
    )


def _vehicle(text: str) -> str:
    """Return a vehicle's name, which may be given as its namespace, with slashes; /fleet/uav1 has two levels."""
    return "/".join(namespace(level) for level in text.strip("/").split("/"))


def run(args: argparse.Namespace) -> int:
    """Switch and print the mode that the vehicle has afterwards."""
    from uav_vslam.ros.mode_switch import current_mode, switch_mode
    from uav_vslam.ros.topic_tools import observer

    with observer(args.domain) as node:
        if args.mode is not None:
            switch_mode(node, args.vehicle, args.mode, wait_s=args.wait)
        print(f"{args.vehicle}: {current_mode(node, args.vehicle, wait_s=args.wait)}")
    return 0
