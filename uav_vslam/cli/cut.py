# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam cut`: legs of one recording as the recordings of several vehicles that fly at the same time."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.argument_types import non_negative
from uav_vslam.cli.messages import say, warn, warn_each
from uav_vslam.cli.progress import progress_bar
from uav_vslam.datasets.cut_options import CutOptions, add_cut_arguments, cut_options
from uav_vslam.errors import UavVslamError

if TYPE_CHECKING:
    from uav_vslam.config import VehicleConfig
    from uav_vslam.datasets.bag_flight import BagFlight
    from uav_vslam.datasets.cutting import Cut

HELP = "cut one recording into overlapping legs, as several vehicles that fly at the same time"
EXAMPLES = """examples:
  uav-vslam cut flight pair --config kagaru            two legs that overlap, as long as can be
  uav-vslam cut flight pair --duration 22              the two legs of 22 s that overlap most
  uav-vslam cut flight trio --vehicles 3 --overlap 0.4
  uav-vslam cut flight pair --legs 0-60,75-135         by hand, in seconds since the first image
  uav-vslam cut flight pair --trajectory results/latest/uav1_s_slam.tum    without ground truth
  uav-vslam run pair/fleet.yaml                        and launch: all vehicles, with the settings of --config

Overlap is measured: stereo points of some frames are projected into the others along the ground truth; it counts where
the vehicles, flown at once, pass within --within of each other. Taken are the longest legs whose mean overlap reaches
--overlap, or of those of --duration the ones that overlap most. OUT holds images and readings bit for bit, re-stamped
so that the legs start together, the truth in one frame, the calibration and a fleet file. Each vehicle starts from the
truth with an error drawn from the covariance of the recorded start (without one, of simulated starts); biases are those
of the recorded start. --trajectory takes the place of the truth: an estimate from an earlier run, whose errors are then
those of the starts; OUT holds no truth. The bag grows in OUT.partial: a cut that was killed leaves no OUT, and can be
started again.
"""
SEED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="the recording")
    parser.add_argument("out", type=Path, metavar="OUT", help="bag folder to make")
    parser.add_argument("--config", metavar="NAME", help="one YAML file, or name of one in config/, of the recording")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override one setting; may be repeated"
    )
    parser.add_argument("--trajectory", type=Path, metavar="FILE", help="TUM or EuRoC file, in place of the truth")
    add_cut_arguments(parser)
    parser.add_argument("--seed", type=non_negative, metavar="K", help=f"of the starts' errors (default {SEED})")


def run(args: argparse.Namespace) -> int:
    """Cut; return 2 if the recording is damaged, after cutting what can be read."""
    from uav_vslam.cli.overrides import overrides
    from uav_vslam.config import find_config, load_vehicle
    from uav_vslam.datasets.cut_writer import FLEET_FILE, write_cut
    from uav_vslam.datasets.cutting import WHAT_A_CUT_HIDES, source_of, with_drawn_starts
    from uav_vslam.datasets.sensor_setup import with_noise_of_files
    from uav_vslam.datasets.unfinished import require_new

    options = cut_options(args)
    if args.trajectory and args.seed is not None:
        raise UavVslamError("--trajectory: starts have the errors of the estimate, none are drawn: leave out --seed")
    warn_each(require_new(args.out))  # before any work
    file = find_config(args.config) if args.config else None
    config = with_noise_of_files(load_vehicle(file, overrides=overrides(args.set)))
    flight = source_of(args.bag, args.vehicle, config.input)
    cut = _planned(args, flight, config, options)
    with progress_bar("writing", sum(vehicle.frames for vehicle in cut.vehicles)) as advance:
        started = cut if args.trajectory else with_drawn_starts(cut, SEED if args.seed is None else args.seed)
        unread = write_cut(args.out, flight, started.vehicles, config, advance, with_truth=not args.trajectory)
    print("\n".join(cut_lines(cut)))
    print(f"A cut hides: {WHAT_A_CUT_HIDES}.")
    print(f"{args.out}: {shlex.join(['uav-vslam', 'run', str(args.out / FLEET_FILE)])}")
    if unread.messages:
        count, first = len(unread.messages), next(iter(unread.messages.values()))
        warn(f"{count} messages can't be read and are left out, images with their pair; the first: {first}")
    if unread.damage:
        say(f"cut from what is before a break: {unread.damage}")
    return 2 if unread.damage else 0


def _planned(args: argparse.Namespace, flight: BagFlight, config: VehicleConfig, options: CutOptions) -> Cut:
    from uav_vslam.datasets.cutting import plan_cut, poses_of, velocities_of
    from uav_vslam.evaluation.files.reading import read_trajectory

    if args.trajectory:
        poses = read_trajectory(args.trajectory)
        velocities = velocities_of(poses)
    else:
        poses, velocities = poses_of(flight)
    with progress_bar("measuring overlap", flight.frame_count) as advance:
        return plan_cut(flight, poses, velocities, config, options, advance)


def cut_lines(cut: Cut) -> list[str]:
    """Return a line for each vehicle, and one for each two of them."""
    from uav_vslam.types import NS_PER_S

    lines = []
    for vehicle in cut.vehicles:
        first_s, last_s = ((ns - cut.zero_ns) / NS_PER_S for ns in (vehicle.first_ns, vehicle.last_ns))
        lines.append(f"{vehicle.name}: {first_s:.1f} to {last_s:.1f} s of the flight, {vehicle.frames} image pairs")
    for (one, other), met in cut.meetings.items():
        lines.append(
            f"{one}, {other}: overlap {met.overlap:.0%}; {met.shared:.0%} of the views share a tenth or more, there "
            f"headings differ by {met.heading_deg:.0f}°, viewing directions by {met.view_angle_deg:.0f}°, the passes "
            f"are {met.gap_s:.0f} s apart (medians)"
        )
    return lines
