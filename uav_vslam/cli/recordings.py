# SPDX-License-Identifier: Apache-2.0
"""Recordings and vehicles on the command line; a refused recording comes with the command that lists its faults."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uav_vslam.config import InputConfig, VehicleConfig
    from uav_vslam.datasets.bag_flight import BagFlight


def add_configuration(parser: argparse.ArgumentParser) -> None:
    """Declare which vehicles' recordings are read, and with which settings."""
    parser.add_argument("--config", metavar="NAME", help="one YAML file, or name of one in config/ (bags only)")
    parser.add_argument("--vehicles", nargs="+", metavar="NAME", help="only these (bags only)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override one setting of all vehicles; may be repeated",
    )


def bags_and_configs(
    args: argparse.Namespace,
    vehicles: Callable[[Sequence[str] | None, tuple[Path, ...], InputConfig], list[str]],
    more: Mapping[str, object] = MappingProxyType({}),
) -> tuple[tuple[Path, ...], dict[str, VehicleConfig]]:
    """Return the bags and each vehicle's configuration: of a fleet file, or of bags with one configuration for all.

    Args:
        args: inputs, and what `add_configuration` declares.
        vehicles: returns those of bags, by name, from what `--vehicles` names.
        more: settings that the verb's other options stand for, by dotted name.

    Raises:
        ConfigError: a fleet file comes with other inputs, a file, key or value is wrong, or a setting is given twice.
    """
    from uav_vslam.cli.overrides import overrides
    from uav_vslam.config import find_config, load_fleet, load_vehicle
    from uav_vslam.errors import ConfigError

    changed = overrides(args.set)
    if twice := sorted(changed.keys() & more.keys()):
        raise ConfigError(f"setting {twice[0]} is given twice, by --set and by an option of its own; leave one out")
    changed |= more
    file = next((path for path in args.inputs if path.suffix in {".yaml", ".yml"}), None)
    if file is not None:
        if len(args.inputs) > 1 or args.vehicles or args.config:
            raise ConfigError(
                f"{file} is a fleet file: it names the recordings, the vehicles and their configurations, so "
                "no other input, --vehicles or --config goes with it; change the file, or use --set"
            )
        fleet = load_fleet(file, overrides=changed)
        if not fleet.replay.bags:
            raise ConfigError(f"{file}: replay.bags is empty; name the recordings")
        return fleet.replay.bags, fleet.vehicles
    bags = tuple(args.inputs)
    config = load_vehicle(find_config(args.config) if args.config else None, overrides=changed)
    return bags, dict.fromkeys(vehicles(args.vehicles, bags, config.input), config)


def open_flights(bags: Sequence[Path], configs: Mapping[str, VehicleConfig]) -> dict[str, BagFlight]:
    """Open each vehicle's recording and check its first images.

    Raises:
        BagError: a path is missing or not a bag, or a topic is missing.
        CalibrationError: a sensor's place is unknown, or calibration and images contradict each other.
    """
    from uav_vslam.config import differences
    from uav_vslam.datasets.bag import open_flight
    from uav_vslam.datasets.rosbag import topics_of
    from uav_vslam.errors import BagError, CalibrationError

    topics_of(bags)  # of what is no bag, nothing else can be said
    try:
        flights = {name: open_flight(bags, name, config.input) for name, config in configs.items()}
        for flight in flights.values():
            flight.check_images()
    except (BagError, CalibrationError) as error:
        text = f"{error}" if f"{error}".endswith("?") else f"{error}."
        same = ", with the same configuration" if any(map(differences, configs.values())) else ""
        raise type(error)(f"{text} All faults: uav-vslam check {shlex.join(map(str, bags))}{same}") from None
    return flights
