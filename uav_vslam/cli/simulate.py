# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam simulate`: fly a fleet over rendered farmland and record it as a bag."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.argument_types import non_negative
from uav_vslam.cli.arguments import add_storage, check_storage
from uav_vslam.cli.progress import progress_bar

if TYPE_CHECKING:
    from uav_vslam.datasets.flight_writer import ImageCoding
    from uav_vslam.simulation.scenario import Scenario

HELP = "fly a fleet over rendered farmland and record it as a bag"
EXAMPLES = """examples:
  uav-vslam simulate flight                               two vehicles, 22 s, 1280x960: 790 MB
  uav-vslam simulate flight --compressed jpeg             the same in 170 MB
  uav-vslam simulate flight --scale 0.5 --frames 60 --seed 7
  uav-vslam simulate flight --objects --colour            barns, hedges, trees and posts, in colour: for mapping
  uav-vslam simulate flight --imu consumer --texture fields.jpg --texture-pixel 0.05
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("out", type=Path, metavar="OUT", help="bag folder to make")
    parser.add_argument(
        "--scenario",
        default="kagaru",
        help="kagaru (leg, 160 frames; default), sample (leg, 64 small ones), long (lawnmower, 1000), "
        "revisit (circuit, 780, one vehicle) or parting (apart after 60 s, 1000)",
    )
    parser.add_argument("--seed", type=non_negative, help="of everything random; the same seed gives the same bytes")
    parser.add_argument("--vehicles", type=int, help="number of vehicles")
    parser.add_argument("--frames", type=int, help="image pairs of each vehicle, at 7.14 Hz")
    parser.add_argument("--pattern", help="leg, lawnmower, racetrack, circuit or parting")
    parser.add_argument("--imu", help="adis16480, consumer, thesis_half, thesis_w1, thesis_w2, thesis_w3 or thesis_w4")
    parser.add_argument("--scale", type=float, help="image size as a multiple of 1280x960")
    parser.add_argument(
        "--objects", action="store_true", default=None, help="barns, hedges, trees and posts, with shadows"
    )
    parser.add_argument("--colour", action="store_true", default=None, help="record BGR images instead of grey")
    parser.add_argument("--texture", help="grass (procedural), an image or a folder of images")
    parser.add_argument("--texture-pixel", type=float, metavar="M", help="size of an image's pixel on the ground [m]")
    parser.add_argument("--blur", type=float, metavar="PX", help="motion blur at full resolution [px]")
    parser.add_argument("--noise", type=float, metavar="SIGMA", help="image noise [grey levels]")
    parser.add_argument(
        "--vibration", type=float, metavar="DEG", help="rms of the right camera's attitude wobble [deg]"
    )
    parser.add_argument(
        "--compressed", nargs="?", const="png", choices=["png", "jpeg"], help="record compressed images"
    )
    parser.add_argument("--quality", type=int, help="of jpeg, 1 to 100 (default 90)")
    add_storage(parser)


def run(args: argparse.Namespace) -> int:
    """Simulate and record; return the exit status."""
    import cv2

    from uav_vslam.simulation.recording import record

    check_storage(args)
    cv2.setNumThreads(1)
    scenario = scenario_from(args)
    coding = coding_from(args)
    with progress_bar("rendering", scenario.frames * scenario.vehicles) as advance:
        record(scenario, args.out, coding=coding, storage=args.storage, zstd=args.zstd, on_frame=advance)
    size_mb = sum(file.stat().st_size for file in args.out.iterdir()) / 1e6
    print(
        f"{args.out}: {scenario.vehicles} vehicles, {scenario.frames} image pairs each over "
        f"{scenario.duration_s:.1f} s, {size_mb:.1f} MB"
    )
    return 0


def coding_from(args: argparse.Namespace) -> ImageCoding:
    """Return how images are recorded.

    Raises:
        ConfigError: a quality is given, but not for jpeg images.
    """
    from uav_vslam.datasets.flight_writer import ImageCoding
    from uav_vslam.errors import ConfigError

    if args.quality is None:
        return ImageCoding(args.compressed or "raw")
    if args.compressed != "jpeg":
        raise ConfigError("--quality is that of jpeg images: give --compressed jpeg with it")
    return ImageCoding(args.compressed, args.quality)


def scenario_from(args: argparse.Namespace) -> Scenario:
    """Return the named scenario with what the arguments change.

    Raises:
        ConfigError: the scenario's name or a value is not known, or the pixel of an image is given without an image.
    """
    import dataclasses

    from uav_vslam.errors import ConfigError
    from uav_vslam.simulation.scenario import SCENARIOS

    if args.scenario not in SCENARIOS:
        raise ConfigError(f"scenario {args.scenario!r} is not known; use one of {', '.join(SCENARIOS)}")
    if args.texture_pixel is not None and args.texture in {None, "grass"}:
        raise ConfigError("--texture-pixel is that of an image: give --texture IMAGE with it")
    given = {
        "seed": args.seed,
        "vehicles": args.vehicles,
        "frames": args.frames,
        "pattern": args.pattern,
        "imu": args.imu,
        "scale": args.scale,
        "objects": args.objects,
        "colour": args.colour,
        "texture": args.texture,
        "texture_m_per_px": args.texture_pixel,
        "blur_px": args.blur,
        "noise_sigma": args.noise,
        "vibration_deg": args.vibration,
    }
    changed = {key: value for key, value in given.items() if value is not None}
    return dataclasses.replace(SCENARIOS[args.scenario], **changed)
