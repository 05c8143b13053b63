# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam run`: recordings through the whole graph in this process, without ROS, as fast as the machine allows."""

from __future__ import annotations

import argparse
import shlex
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.argument_types import positive
from uav_vslam.cli.arguments import MODES, add_results
from uav_vslam.cli.messages import say, warn, warn_each, warn_of_truth
from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.recordings import add_configuration, bags_and_configs, open_flights

if TYPE_CHECKING:
    from uav_vslam.config import InputConfig, VehicleConfig
    from uav_vslam.datasets.bag_flight import BagFlight
    from uav_vslam.evaluation.result import FlightResult
    from uav_vslam.evaluation.trajectory import Trajectory
    from uav_vslam.offline.source import FlightSource
    from uav_vslam.pipeline import VehicleTrack

SHEET = 12  # images of the contact sheet
FIRST_FRAMES = 20  # that show how far apart the stamps of a pair are
HELP = "run recordings through the graph offline, without ROS, and evaluate"
EXAMPLES = """examples:
  uav-vslam run config/fleet_demo.yaml           a fleet file: vehicles, configurations, recordings
  uav-vslam run flight --config kagaru           every vehicle of a bag, one configuration for all
  uav-vslam run flight --config kagaru --vehicles uav2 --map results/latest/uav1_map.npz     start in an earlier map
  uav-vslam run v101 --config euroc --set backend.sigma_px=0.8
  uav-vslam run uav1_bag uav2_bag --config kagaru --mode none
  uav-vslam run flight --config kagaru --sheet 24 --video            pictures of the feature tracks
  uav-vslam run flight --config kagaru --mode narrowband --link bad_radio    over 9.6 kbit/s with 20 % loss
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("inputs", nargs="+", type=Path, metavar="BAG|FLEET.yaml", help="bags, or one fleet file")
    add_options(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare all but the inputs."""
    add_configuration(parser)
    parser.add_argument("--mode", choices=MODES, help="communication mode")
    parser.add_argument(
        "--map", type=Path, metavar="FILE", help="start in flight over the ground of an earlier run's <vehicle>_map.npz"
    )
    parser.add_argument("--link", metavar="NAME", help="emulated radio link: YAML file or name of one in config/links/")
    parser.add_argument("--name", help="of the results folder (default: that of the input)")
    add_results(parser)
    parser.add_argument("--workers", type=positive, default=2, help="processes, one a vehicle at most (default 2)")
    parser.add_argument("--no-smoothing", action="store_true", help="do not smooth each whole flight afterwards")
    parser.add_argument("--no-plots", action="store_true", help="draw no pictures of the flight, write no page")
    parser.add_argument("--no-maps", action="store_true", help="write no <vehicle>_map.npz")
    parser.add_argument(
        "--sheet", type=positive, default=SHEET, metavar="N", help=f"images with tracks on the sheet (default {SHEET})"
    )
    parser.add_argument("--video", action="store_true", help="write all images with tracks as a video, too")


def run(args: argparse.Namespace) -> int:
    """Run, evaluate, write; return 2 where a recording is truncated, after using what can be read."""
    return flown(args, *configured(args))[1]


def flown(args: argparse.Namespace, bags: tuple[Path, ...], configs: Mapping[str, VehicleConfig]) -> tuple[Path, int]:
    """Run vehicles, by name, of recordings; evaluate, write; return the results folder and the exit code."""
    from uav_vslam.config import load_link
    from uav_vslam.cooperation.link import link_between
    from uav_vslam.datasets.sensor_setup import with_noise_of_files
    from uav_vslam.errors import ConfigError
    from uav_vslam.evaluation.output import write_results
    from uav_vslam.evaluation.summary import build_summary
    from uav_vslam.fleet import never_together
    from uav_vslam.offline.flight import fly
    from uav_vslam.offline.result import flight_result
    from uav_vslam.report.page.page import NAME as PAGE_NAME
    from uav_vslam.report.table import print_summary

    links = partial(link_between, load_link(args.link)) if args.link else None
    if links is not None and len(configs) < 2:
        raise ConfigError(f"--link connects vehicles, and only {', '.join(configs)} flies; leave it out")
    flights = open_flights(bags, configs)
    configs = {name: with_noise_of_files(config) for name, config in configs.items()}
    for flight in flights.values():
        _report_offset(flight)
        warn_each(f"{flight.vehicle}: {text}" for text in flight.warnings)
    truths = {name: _truth(flight) for name, flight in flights.items()}
    started = time.monotonic()
    with progress_bar("flying", sum(flight.frame_count for flight in flights.values())) as advance:
        sources: list[FlightSource] = list(flights.values())
        tracks, fleet = fly(
            sources,
            configs,
            workers=args.workers,
            on_frame=advance,
            links=links,
            keep_features=args.video or not args.no_plots,
            smoothing=not args.no_smoothing,
            keep_maps=not args.no_maps,
        )
    name = args.name or args.inputs[0].stem
    result = flight_result(name, tracks, fleet, truths, configs, wall_s=time.monotonic() - started, bags=bags)
    try:
        print_summary(build_summary(result, git=None))  # first: a full disk must not cost it
    finally:  # nor a reader that has closed the pipe the results
        folder = write_results(result, args.results, plot=partial(_draw, flights=flights, tracks=tracks, args=args))
        _save_maps(tracks, folder)
    print(f"results: {folder}")
    if not args.no_plots:
        print(f"page: {folder / PAGE_NAME}")
    warn_of_truth(result, truths)
    warn_each(never_together(tracks, configs))
    for vehicle, track in tracks.items():
        warn_each(f"{vehicle}: {text}" for text in track.warnings)
    broken = sorted(track.broken for track in tracks.values() if track.broken)
    warn_each(broken)
    return folder, 2 if broken else 0


def configured(args: argparse.Namespace) -> tuple[tuple[Path, ...], dict[str, VehicleConfig]]:
    """Return the bags and each vehicle's configuration, after warnings about them."""
    from uav_vslam.config import doubtful_settings, separate_maps

    more = {"fusion.mode": args.mode} if args.mode else {}
    if args.map is not None:
        more |= {"start.method": "map", "start.map": str(args.map.resolve())}
    bags, configs = bags_and_configs(args, _vehicles, more)
    warn_each(text for config in configs.values() for text in doubtful_settings(config).values())
    if apart := separate_maps(configs):
        warn(apart)
    return bags, configs


def _truth(flight: BagFlight) -> Trajectory | None:
    """Return the recorded ground truth, if there is any, after warnings about it."""
    from uav_vslam.datasets.truth import trajectory_of, truth_warnings

    truth = flight.truth()
    if truth is None:
        return None
    warn_each(f"{flight.vehicle}: {text}" for text in truth_warnings(truth))
    return trajectory_of(truth) if len(truth) else None


def _save_maps(tracks: dict[str, VehicleTrack], folder: Path) -> None:
    """Write each vehicle's map beside its results, for `run --map`."""
    from uav_vslam.slam.saved_map import save_map

    for vehicle, track in tracks.items():
        if track.saved_map is not None and len(track.saved_map):
            size = save_map(track.saved_map, folder / f"{vehicle}_map.npz")
            print(f"{vehicle}_map.npz: {len(track.saved_map)} landmarks in {size / 1e3:.0f} kB")


def _draw(
    result: FlightResult,
    folder: Path,
    *,
    flights: dict[str, BagFlight],
    tracks: dict[str, VehicleTrack],
    args: argparse.Namespace,
) -> list[Path]:
    """Write plots, contact sheets and videos, as far as they are wanted."""
    from uav_vslam.cli.track_pictures import write_film, write_sheet
    from uav_vslam.report.page.page import write_page
    from uav_vslam.report.plots import write_plots

    written: list[Path | None] = []
    if not args.no_plots:
        written += write_plots(result, folder)
        written += [write_sheet(flights[name], track, folder, count=args.sheet) for name, track in tracks.items()]
    if args.video:
        with progress_bar("drawing", sum(len(track.outputs) for track in tracks.values())) as advance:
            written += [write_film(flights[name], track, folder, advance) for name, track in tracks.items()]
    if not args.no_plots:
        written.append(write_page([folder]))
    return [path for path in written if path is not None]


def _report_offset(flight: BagFlight) -> None:
    """Print how far apart the stamps of image pairs are, if they are not the same but still make pairs."""
    import numpy as np

    from uav_vslam.datasets.stereo_sync import NOTABLE_OFFSET_NS

    apart, tolerance_ns = flight.stamps_apart_ns(FIRST_FRAMES), flight.pair_tolerance_ns(FIRST_FRAMES)
    if len(apart) and NOTABLE_OFFSET_NS < np.median(apart) <= tolerance_ns:
        say(
            f"{flight.vehicle}: left and right images are stamped {np.median(apart) / 1e6:.1f} ms apart and count as "
            f"simultaneous (tolerance {tolerance_ns / 1e6:.1f} ms, input.pair_tolerance_s)"
        )


def _vehicles(requested: Sequence[str] | None, bags: tuple[Path, ...], config: InputConfig) -> list[str]:
    """Return the vehicles to run: those requested, or all in the bags."""
    from uav_vslam.datasets.bag import vehicles
    from uav_vslam.datasets.rosbag import names_of
    from uav_vslam.errors import BagError, ConfigError

    names = [name.strip("/") for name in requested or vehicles(bags, config)]
    if not names:
        raise BagError(
            f"bag {names_of(bags)} holds no <vehicle>/{config.topics.left}; record or remap the images, or "
            f"name its topics by input.topics, which this proposes: uav-vslam check {shlex.join(map(str, bags))}"
        )
    if nested := next((name for name in names if "/" in name), ""):
        raise ConfigError(
            f"the namespace {nested} has several levels, but results are named by vehicle: name its topics from "
            f"the root instead, as in --set input.topics.left={config.topic(nested, 'left')}"
        )
    if len(set(names)) < len(names):
        raise ConfigError(f"--vehicles {' '.join(names)} names one twice; each vehicle has one namespace")
    return names
