# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam topic`: inspect live topics where ROS came from PyPI, without its `ros2` command."""

import argparse
from typing import Any

from uav_vslam.argument_types import non_negative, positive_seconds
from uav_vslam.cli.arguments import add_domain

HELP = "list, print or measure live topics"
EXAMPLES = """examples:
  uav-vslam topic list
  uav-vslam topic echo /uav1/odometry --count 1
  uav-vslam topic hz /uav1/stereo_features --domain 7
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    _add_options(parser, domain=None, wait=2.0)
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    commands = [actions.add_parser("list", help="print every topic with its type")]
    for action, summary in (("echo", "print messages, long arrays shortened"), ("hz", "print the rate once a second")):
        command = actions.add_parser(action, help=summary)
        command.add_argument("topic", metavar="TOPIC")
        text = "end after N messages or reports (default: never)"
        command.add_argument("--count", type=non_negative, default=0, metavar="N", help=text)
        commands.append(command)
    for command in commands:  # options may stand before the action and after it
        _add_options(command, domain=argparse.SUPPRESS, wait=argparse.SUPPRESS)


def _add_options(parser: argparse.ArgumentParser, *, domain: Any, wait: Any) -> None:
    """Declare where to look and for how long, with these defaults."""
    add_domain(parser, domain)
    parser.add_argument(
        "--wait", type=positive_seconds, default=wait, metavar="S", help="time to discover the graph [s] (default 2)"
    )


def run(args: argparse.Namespace) -> int:
    """Inspect the graph until done or Ctrl-C."""
    from uav_vslam.ros import topic_tools

    with topic_tools.observer(args.domain) as node:
        if args.action == "list":
            topic_tools.print_topics(node, wait_s=args.wait)
        else:
            act = topic_tools.echo if args.action == "echo" else topic_tools.print_rate
            act(node, args.topic, wait_s=args.wait, count=args.count)
    return 0
