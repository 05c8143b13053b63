# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam monitor`: watch a running node graph in the terminal."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.argument_types import namespace, positive_seconds
from uav_vslam.cli.arguments import add_domain

if TYPE_CHECKING:
    from uav_vslam.monitor import Fleet
    from uav_vslam.ros.fleet_monitor import GraphListener

HELP = "watch a running node graph: rates, claimed accuracy, radio, health"
EXAMPLES = """examples:
  uav-vslam monitor                                every vehicle on the ROS domain, until Ctrl-C
  uav-vslam monitor config/fleet_demo.yaml         those of a fleet file, absent ones too
  uav-vslam monitor --vehicles uav1 uav2 --once    one table after 5 s; exit code 1 if one of them sent nothing
  uav-vslam monitor --every 10 >> flight.log       one line a vehicle each 10 s, as the output is no terminal
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    who = parser.add_mutually_exclusive_group()
    who.add_argument("fleet", type=Path, nargs="?", metavar="FLEET.yaml", help="watch the vehicles of this file")
    who.add_argument(
        "--vehicles", nargs="+", type=namespace, metavar="NAME", default=[], help="watch these (default: all found)"
    )
    parser.add_argument("--once", action="store_true", help="print one table and exit: 1 if a vehicle sent nothing")
    parser.add_argument(
        "--wait", type=positive_seconds, default=5.0, metavar="S", help="with --once: after S seconds (default 5)"
    )
    parser.add_argument(
        "--every", type=positive_seconds, default=1.0, metavar="S", help="renew the view each S seconds (default 1)"
    )
    add_domain(parser)


def run(args: argparse.Namespace) -> int:
    """Watch until Ctrl-C, or once."""
    from uav_vslam.config import load_fleet
    from uav_vslam.monitor import Fleet
    from uav_vslam.ros.fleet_monitor import GraphListener
    from uav_vslam.ros.topic_tools import observer

    fleet = Fleet(list(load_fleet(args.fleet).vehicles) if args.fleet else args.vehicles)
    with observer(args.domain, "uav_vslam_monitor") as node:
        graph = GraphListener(node, fleet)
        if args.once:
            return _show_once(graph, fleet, args.wait)
        show = _show_live if sys.stdout.isatty() else _print_lines
        show(graph, fleet, args.every)
    return 0


def _show_once(graph: GraphListener, fleet: Fleet, wait_s: float) -> int:
    from uav_vslam.report.layout import wide
    from uav_vslam.report.live_table import live_view

    graph.spin(wait_s)
    wide(None).print(live_view(fleet, time.monotonic()))
    return 0 if fleet.is_complete else 1


def _show_live(graph: GraphListener, fleet: Fleet, every_s: float) -> None:
    from rich.live import Live

    from uav_vslam.report.live_table import live_view

    with Live(live_view(fleet, time.monotonic()), auto_refresh=False) as live:
        while True:
            graph.spin(every_s)
            live.update(live_view(fleet, time.monotonic()), refresh=True)


def _print_lines(graph: GraphListener, fleet: Fleet, every_s: float) -> None:
    from uav_vslam.report.live_table import live_lines

    while True:
        graph.spin(every_s)
        for line in live_lines(fleet, time.monotonic()):
            print(time.strftime("%H:%M:%S"), line, flush=True)
