# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam import-euroc`: turn a sequence in EuRoC's ASL layout into a bag."""

import argparse
from pathlib import Path

from uav_vslam.cli.progress import progress_bar

HELP = "turn a sequence in EuRoC's ASL layout into a bag"
EXAMPLES = """examples:
  uav-vslam import-euroc V1_01_easy/mav0 v101
  uav-vslam import-euroc V1_01_easy/mav0 v101 --vehicle uav2 --initial-sigma 0.05 0.1 0.5 0.002 0.05

Images are recorded byte for byte, lens distortion included. The start state is the truth at the first image pair.
Gravity in EuRoC's world is 9.81 m/s^2: set imu.gravity accordingly.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("mav0", type=Path, metavar="MAV0_DIR", help="folder with cam0, cam1, imu0 and the ground truth")
    parser.add_argument("out", type=Path, metavar="OUT", help="bag folder to make")
    parser.add_argument("--vehicle", default="uav1", help="ROS namespace (default uav1)")
    parser.add_argument(
        "--initial-sigma",
        nargs=5,
        type=float,
        metavar=("M", "M/S", "DEG", "RAD/S", "M/S2"),
        help="stated sigma of the start's position, velocity, attitude, gyro and accelerometer bias "
        "(default 0.01 0.02 0.2 0.001 0.02)",
    )
    parser.add_argument("--storage", default="mcap", choices=["mcap", "sqlite3"], help="bag format (default mcap)")


def run(args: argparse.Namespace) -> int:
    """Import and record; return the exit status."""
    from uav_vslam.datasets.euroc import InitialSigma, frame_count, read_euroc
    from uav_vslam.datasets.flight_writer import write_flights

    sigma = InitialSigma(*args.initial_sigma) if args.initial_sigma else None
    flight = read_euroc(args.mav0, vehicle=args.vehicle, sigma=sigma)
    frames = frame_count(args.mav0)
    with progress_bar("importing", frames) as advance:
        write_flights(args.out, [flight], storage=args.storage, on_frame=advance)
    size_mb = sum(file.stat().st_size for file in args.out.iterdir()) / 1e6
    print(f"{args.out}: {frames} image pairs of {args.vehicle}, {size_mb:.1f} MB")
    return 0
