# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam launch`: start a fleet's node graph, one process a node, and end it with its replay."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.cli.arguments import MODES, add_domain, add_rate
from uav_vslam.cli.messages import say, warn_each

if TYPE_CHECKING:
    from uav_vslam.config import FleetConfig, LinkConfig, VehicleConfig
    from uav_vslam.ros.fleet_commands import NodeSpec

LOG_LEVELS = ("debug", "info", "warn", "error")
HELP = "start a fleet's node graph, one process a node"
EXAMPLES = """examples:
  uav-vslam launch config/fleet_demo.yaml                                 replay the file's recordings, in lock-step
  uav-vslam launch config/fleet_demo.yaml --bag flight --rate 1           another recording, in real time
  uav-vslam launch config/fleet_demo.yaml --mode none --record out/alone  without cooperation, estimates recorded
  uav-vslam launch config/fleet_demo.yaml --mode narrowband --link bad_radio    over 9.6 kbit/s with 20 % loss
  uav-vslam launch fleet.yaml --vehicle uav1                              the vehicle of this computer alone

The end of the replay ends the fleet, as do SIGINT, SIGTERM, a terminal that closes and, with --on-failure stop, a node
that dies. Under nohup, or disowned, a fleet outlives its terminal.

exit codes: 0 done, or, without recordings, ended by SIGINT or SIGTERM; 1 a node failed or a vehicle processed no frame;
2 wrong input or configuration; 130 interrupted
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("fleet", type=Path, metavar="FLEET.yaml", help="vehicles, recordings to replay, and the mode")
    parser.add_argument(
        "--vehicle",
        action="append",
        metavar="NAME",
        help="start only this one, the others have their own computers; may be repeated",
    )
    parser.add_argument("--bag", type=Path, action="append", metavar="BAG", help="replay this instead; may be repeated")
    add_rate(parser, "as in FLEET.yaml")
    parser.add_argument("--mode", choices=MODES, help="how the vehicles communicate")
    parser.add_argument("--link", metavar="NAME", help="emulated radio link: YAML file or name of one in config/links/")
    parser.add_argument("--record", type=Path, metavar="DIR", help="record the estimates into this new bag")
    parser.add_argument("--map", type=Path, metavar="DIR", help="map the surface in flight, each vehicle into DIR/NAME")
    parser.add_argument("--log-dir", type=Path, metavar="DIR", help="also keep each process's output in a file here")
    parser.add_argument(
        "--use-sim-time", action="store_true", help="take the time from /clock, as with a replay of others"
    )
    parser.add_argument("--log-level", choices=LOG_LEVELS, help="of all nodes (default info)")
    parser.add_argument(
        "--on-failure",
        choices=("restart", "stop"),
        help="of a node: start it again, from its checkpoint, or end all (default: stop with recordings, else restart)",
    )
    add_domain(parser)
    parser.add_argument(
        "--no-parameter-services", action="store_true", help="nobody can read or change parameters in flight"
    )


def run(args: argparse.Namespace) -> int:
    """Launch and return the exit code of the first process that failed, or 0."""
    from uav_vslam.config import load_link

    vehicles = args.vehicle or ()
    fleet = read_fleet(args.fleet, bags=args.bag, rate=args.rate, mode=args.mode, vehicles=vehicles)
    return launch(
        fleet,
        record=args.record,
        log_dir=args.log_dir,
        domain_id=args.domain,
        link=load_link(args.link) if args.link else None,
        vehicles=vehicles,
        use_sim_time=args.use_sim_time or None,
        maps=str(args.map.resolve()) if args.map else "",
        log_level=args.log_level or "",
        restarts=args.on_failure == "restart" or not (args.on_failure or fleet.replay.bags),
        parameter_services=not args.no_parameter_services,
    )


def read_fleet(
    path: Path,
    *,
    bags: Sequence[Path] | None,
    rate: float | None,
    mode: str | None,
    vehicles: Collection[str] = (),
) -> FleetConfig:
    """Read a fleet file; the arguments override its values, and recordings are checked for the vehicles to start.

    Raises:
        ConfigError: the file or a value is wrong, or there is nothing to replay at a rate.
        BagError: there is no such recording, or it lacks what a vehicle needs.
        CalibrationError: a recorded calibration contradicts itself or the images.
    """
    from uav_vslam.config import load_fleet
    from uav_vslam.errors import ConfigError

    fleet = load_fleet(path).changed(bags=bags, rate=rate, mode=mode)
    here = fleet.chosen(vehicles)
    if fleet.replay.bags:
        _check_recordings(fleet.replay.bags, here)
    elif rate is not None:
        raise ConfigError(f"{path} names no recordings to replay at a rate; leave out --rate, or give --bag")
    return fleet


def _check_recordings(bags: Sequence[Path], vehicles: Mapping[str, VehicleConfig]) -> None:
    """Refuse unusable recordings before anything is started: nodes would only drop their messages."""
    from uav_vslam.cli.recordings import open_flights
    from uav_vslam.errors import BagError

    for bag in bags:
        if not bag.exists():
            raise BagError(f"{bag}: no such recording; give an existing one in the fleet file or with --bag")
    open_flights(bags, vehicles)


def launch(
    fleet: FleetConfig,
    *,
    record: Path | None = None,
    log_dir: Path | None = None,
    domain_id: int | None = None,
    link: LinkConfig | None = None,
    vehicles: Collection[str] = (),
    use_sim_time: bool | None = None,
    maps: str = "",
    log_level: str = "",
    restarts: bool = False,
    parameter_services: bool = True,
    on_line: Callable[[str, str], None] | None = None,
) -> int:
    """Run a fleet's processes to their end.

    Args:
        fleet: what to start.
        record: bag to record the estimates into.
        log_dir: folder for the output of each process.
        domain_id: ROS domain; None takes the environment's.
        link: emulated radio link to put between the vehicles.
        vehicles, use_sim_time, maps: see `node_specs`.
        log_level: of all nodes; empty for their default.
        restarts: nodes that fail are started again; otherwise the first failure ends all.
        parameter_services: vehicles' parameters can be read and changed in flight.
        on_line: called with (process, line) for each line of output; the default prints it.

    Returns:
        The exit code of the first process that failed, 128 + the signal that interrupted a replay, or 0.
    """
    from uav_vslam.config import idle_radio, separate_maps
    from uav_vslam.ros.command import node_command
    from uav_vslam.ros.domain import check_domain
    from uav_vslam.ros.fleet_commands import node_specs, without_parameter_services
    from uav_vslam.ros.supervisor import ESCALATION, SAVING, Supervisor
    from uav_vslam.ros.vehicle_lock import only_launch_of

    check_domain(domain_id)
    here = fleet.chosen(vehicles)
    _check_places(record, maps, here)
    _check_files(here)
    bag = str(record) if record else ""
    specs = node_specs(fleet, link=link, vehicles=vehicles, use_sim_time=use_sim_time, record=bag, maps=maps)
    if not parameter_services:
        specs = [without_parameter_services(spec) for spec in specs]
    supervisor = Supervisor(
        _environment(domain_id, log_dir, own_radio=fleet.radio.domain_id >= 0 or not vehicles),
        restarts=restarts,
        log_dir=log_dir,
        on_line=on_line,
        escalation=SAVING if maps else ESCALATION,
    )
    with only_launch_of(here):
        _remove_leftovers()
        _warn_without_key(fleet)
        warn_each(
            text
            for text in (separate_maps(fleet.vehicles), idle_radio(fleet, vehicles), _little_shared_memory(specs))
            if text
        )
        try:
            return supervisor.run([node_command(spec, log_level) for spec in specs])
        finally:
            _remove_leftovers()


def _check_places(record: Path | None, maps: str, vehicles: Collection[str]) -> None:
    """Refuse folders that can't be made or are taken before anything is started: nodes would fail one by one."""
    from uav_vslam.datasets.unfinished import require_place
    from uav_vslam.errors import BagError
    from uav_vslam.mapping.surface.tiles import TILES, require_no_grid

    if record is not None:
        if record.exists():
            raise BagError(f"{record} exists already; remove it, or choose another name for --record")
        require_place(record)
    for name in vehicles if maps else ():
        require_place(Path(maps) / name)
        require_no_grid(Path(maps) / name / TILES)


def _check_files(vehicles: Mapping[str, VehicleConfig]) -> None:
    """Refuse keys and saved maps that can't be read before anything is started: each node would say so by itself."""
    from uav_vslam.cooperation.authentication import authentication_for
    from uav_vslam.slam.saved_map import load_map

    for name, config in vehicles.items():
        authentication_for(name, config.fusion)
        if config.start.map:
            load_map(config.start.map)


def _environment(domain_id: int | None, log_dir: Path | None, *, own_radio: bool) -> dict[str, str]:
    """Return the variables of the processes in addition to ours."""
    environment = discovery_environment(os.environ, own_radio=own_radio)
    if domain_id is not None:
        environment["ROS_DOMAIN_ID"] = str(domain_id)
    if log_dir is not None:
        environment["ROS_LOG_DIR"] = str(log_dir.resolve() / "ros")
    return environment


def discovery_environment(given: Mapping[str, str], *, own_radio: bool) -> dict[str, str]:
    """Return what keeps the vehicles' domain on this host, unless the environment says otherwise.

    Args:
        given: environment of this process.
        own_radio: vehicles on other computers, if any, are on a domain of their own.
    """
    from uav_vslam.ros.transport import DISCOVERY_RANGE

    return {DISCOVERY_RANGE: "LOCALHOST"} if own_radio and DISCOVERY_RANGE not in given else {}


def _remove_leftovers() -> None:
    """Free the shared memory of nodes that were killed."""
    from uav_vslam.ros.shared_memory import FOLDER, remove_leftovers

    removed = remove_leftovers()
    size_mb = removed.size_bytes / 1e6
    if size_mb >= 0.5:  # not "0 MB"
        say(f"{size_mb:.0f} MB of {FOLDER} that killed processes had left are free again")


def _little_shared_memory(specs: Sequence[NodeSpec]) -> str:
    """Return what to do about a computer, or a container, with little shared memory; normally empty."""
    from uav_vslam.ros.fleet_commands import IN_SHARED_MEMORY
    from uav_vslam.ros.shared_memory import lack_of_room
    from uav_vslam.ros.transport import is_for_images

    return lack_of_room(sum(spec.executable in IN_SHARED_MEMORY for spec in specs)) if is_for_images() else ""


def _warn_without_key(fleet: FleetConfig) -> None:
    """Say once that anybody on the radio can send packets in the vehicles' names."""
    from uav_vslam.cooperation.keys import without_key

    names = without_key(fleet)
    if names:
        who = "the vehicles have" if len(names) == len(fleet.vehicles) else f"{', '.join(names)} has"
        risk = "whoever is on the radio can send packets in their names"
        say(f"{who} no key: {risk} (uav-vslam keys --help)")
