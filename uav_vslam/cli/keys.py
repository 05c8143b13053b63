# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam keys`: make the key that a fleet's vehicles share, and check that they have the same."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "make or check the key that a fleet's vehicles share"
EXAMPLES = """examples:
  uav-vslam keys new fleet.key                       32 random bytes, readable by the owner; then, in the fleet file:
                                                     fleet_key: fleet.key
  uav-vslam keys check fleet.yaml                    every vehicle's file, its fingerprint and what is wrong
  uav-vslam keys check fleet.yaml --vehicle uav1     of this computer's vehicle; compare the fingerprints
"""
FAULTY = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    new = actions.add_parser("new", help="write a new key, never over another", description="Write a new key.")
    new.add_argument("file", type=Path, metavar="FILE", help="where; copy it to every vehicle's computer")
    new.set_defaults(act=_new)
    check = actions.add_parser(
        "check", help="compare the vehicles' keys", description="Compare the keys; exit code 1 if any is wrong."
    )
    check.add_argument("fleet", type=Path, metavar="FLEET.yaml", help="fleet file")
    check.add_argument("--vehicle", action="append", default=[], metavar="NAME", help="only this one; may be repeated")
    check.set_defaults(act=_check)


def run(args: argparse.Namespace) -> int:
    """Do what was chosen."""
    return int(args.act(args))


def _new(args: argparse.Namespace) -> int:
    from uav_vslam.cooperation.keys import new_key

    print(f"{args.file}: key {new_key(args.file)}")
    return 0


def _check(args: argparse.Namespace) -> int:
    from uav_vslam.config import load_fleet
    from uav_vslam.cooperation.keys import check_keys

    reports = check_keys(load_fleet(args.fleet), args.vehicle)
    for one in reports:
        file = "" if one.file in one.fault else one.file
        about = " ".join(part for part in (file, one.fingerprint) if part)
        print(f"{one.vehicle}: {', '.join(part for part in (about, one.fault or 'good') if part)}")
    return FAULTY if any(one.fault for one in reports) else 0
