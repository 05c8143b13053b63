# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam import`: turn a data set that is no bag into one, with a configuration to run it."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.argument_types import namespace, non_negative, positive_number
from uav_vslam.cli.arguments import add_storage, check_storage, first_given
from uav_vslam.cli.messages import warn, warn_each
from uav_vslam.cli.progress import progress_bar

if TYPE_CHECKING:
    from uav_vslam.datasets.importing.motion import InitialSigma
    from uav_vslam.datasets.importing.problems import Problems
    from uav_vslam.datasets.importing.source import Source

HELP = "turn a data set that is no bag into one, with a configuration to run it"
EXAMPLES = """examples:
  uav-vslam import euroc V1_01_easy/mav0 v101 && uav-vslam run v101 --config v101.yaml
  uav-vslam import euroc V1_01_easy/mav0 v101 --vehicle uav2 --initial-sigma 0.05 0.1 0.5 0.002 0.05
  uav-vslam import FORMAT --help                     what one format needs

OUT becomes the bag and OUT.yaml its configuration; a file that is there already is kept. Images of jpeg and png files
are recorded byte for byte, lens distortion included. What can't be read is left out and lines out of order are sorted
in, reported with file and line, counted, and listed in OUT.warnings.txt. The bag grows in OUT.partial: an import that
was cut short leaves no OUT, and starts again.
"""
FORMATS = {
    "euroc": "a sequence in EuRoC's ASL layout",
    "kitti": "a sequence of KITTI's odometry benchmark",
    "tumvi": "a sequence in TUM-VI's layout, with Kalibr's files",
    "kagaru": "pictures, frame times and a log in any layout",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    common = _common_arguments()
    formats = parser.add_subparsers(title="formats", metavar="FORMAT", dest="format", required=True)
    for name, describe in (("euroc", _euroc), ("kitti", _kitti), ("tumvi", _tumvi), ("kagaru", _kagaru)):
        describe(formats.add_parser(name, parents=[common], help=FORMATS[name]))


def _euroc(parser: argparse.ArgumentParser) -> None:
    parser.description = "Import a sequence in EuRoC's ASL layout; SOURCE is its mav0 folder, or the one that holds it."
    parser.epilog = "example: uav-vslam import euroc V1_01_easy/mav0 v101"
    parser.set_defaults(read=_read_euroc)


def _kitti(parser: argparse.ArgumentParser) -> None:
    parser.description = "Import a sequence of KITTI's odometry benchmark; SOURCE is its folder sequences/NN."
    parser.epilog = (
        "The benchmark has no IMU; with that of the raw drive the graph can run it. Example: uav-vslam import kitti "
        "dataset/sequences/07 k07 --oxts 2011_09_30/2011_09_30_drive_0027_extract/oxts"
    )
    parser.add_argument("--colour", action="store_true", help="cameras 2 and 3 even if there are the grey ones")
    parser.add_argument("--oxts", type=Path, metavar="DIR", help="folder oxts of the raw drive: adds the IMU")
    parser.add_argument("--first-frame", type=non_negative, default=0, metavar="N", help="of the sequence in the drive")
    parser.add_argument(
        "--image-times", type=Path, metavar="FILE", help="timestamps.txt of camera 0 (default: DIR/../image_00/)"
    )
    parser.set_defaults(read=_read_kitti)


def _tumvi(parser: argparse.ArgumentParser) -> None:
    parser.description = "Import a sequence in TUM-VI's layout; SOURCE is the folder that holds mav0."
    parser.epilog = "example: uav-vslam import tumvi dataset-room1_512_16 room1"
    parser.add_argument(
        "--calibration", nargs="+", type=Path, metavar="FILE", help="of Kalibr (default: those in SOURCE, dso or mav0)"
    )
    parser.set_defaults(read=_read_tumvi)


def _kagaru(parser: argparse.ArgumentParser) -> None:
    parser.description = "Import a folder of pictures, frame times and a log; a layout file says what is where."
    parser.epilog = "example: uav-vslam import kagaru flight1 f1 --layout my_copy_of_config_import_kagaru.yaml"
    parser.add_argument(
        "--layout", required=True, type=Path, metavar="FILE", help="a copy of config/import/kagaru.yaml, filled in"
    )
    parser.set_defaults(read=_read_kagaru)


def _common_arguments() -> argparse.ArgumentParser:
    """Return what all formats take."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("source", type=Path, metavar="SOURCE", help="folder of the data set")
    common.add_argument("out", type=Path, metavar="OUT", help="bag folder to make")
    common.add_argument("--vehicle", type=namespace, default="uav1", help="ROS namespace (default uav1)")
    common.add_argument(
        "--initial-sigma",
        nargs=5,
        type=positive_number,
        metavar=("M", "M/S", "DEG", "RAD/S", "M/S2"),
        help="stated sigma of the start's position, velocity, attitude, gyro and accelerometer bias",
    )
    add_storage(common)
    return common


def run(args: argparse.Namespace) -> int:
    """Import and record; return the exit status.

    Raises:
        ConfigError: options exclude each other.
        BagError: there is no such data set.
    """
    from uav_vslam.datasets.importing.problems import Problems
    from uav_vslam.datasets.importing.source import configuration_file, write_source
    from uav_vslam.datasets.unfinished import require_new
    from uav_vslam.errors import BagError

    check_storage(args)
    kept = configuration_file(args.out).exists()  # before any work: it may be refused
    warn_each(require_new(args.out))
    if not args.source.is_dir():
        raise BagError(f"{args.source} is not a folder; name the one that holds the data set")
    problems = Problems(warn)
    source: Source = args.read(args, problems)
    with progress_bar("importing", source.frame_count) as advance:
        written, config = write_source(source, args.out, storage=args.storage, zstd=args.zstd, on_frame=advance)
    size_mb = sum(file.stat().st_size for file in args.out.iterdir()) / 1e6
    print(f"{args.out}: {written} image pairs of {source.flight.vehicle}, {size_mb:.1f} MB")
    _report(args.out, source, problems)
    if config and kept:
        print(f"note: {config} was there already and is kept")
    if config:
        print(f"run it: {shlex.join(['uav-vslam', 'run', str(args.out), '--config', str(config)])}")
    return 0


def _report(out: Path, source: Source, problems: Problems) -> None:
    """Print what the user should know, and list what was left out or sorted in in a file."""
    for note in source.notes:
        print(f"note: {note}")
    warn_each(source.warnings)
    if problems.lines:
        listed = out.with_name(f"{out.name}.warnings.txt")
        listed.write_text("\n".join(problems.lines) + "\n", encoding="utf-8")
        summaries = {"left out": problems.summary(), "sorted in": problems.repaired_summary()}
        for what, summary in summaries.items():
            if summary:
                print(f"{what}: {summary}; listed in {listed}")


def _sigma(args: argparse.Namespace) -> InitialSigma | None:
    from uav_vslam.datasets.importing.motion import InitialSigma

    return InitialSigma(*args.initial_sigma) if args.initial_sigma else None


def _read_euroc(args: argparse.Namespace, problems: Problems) -> Source:
    from uav_vslam.datasets.importing.euroc import read_euroc

    return read_euroc(args.source, vehicle=args.vehicle, sigma=_sigma(args), problems=problems)


def _read_tumvi(args: argparse.Namespace, problems: Problems) -> Source:
    from uav_vslam.datasets.importing.tumvi import read_tumvi

    files = tuple(args.calibration or ())
    return read_tumvi(args.source, vehicle=args.vehicle, sigma=_sigma(args), calibration=files, problems=problems)


def _read_kitti(args: argparse.Namespace, problems: Problems) -> Source:
    from uav_vslam.datasets.importing.kitti import read_kitti
    from uav_vslam.datasets.importing.kitti_oxts import read_oxts
    from uav_vslam.errors import ConfigError

    useless = {
        "--first-frame": args.first_frame,
        "--image-times": args.image_times,
        "--initial-sigma": args.initial_sigma,
    }
    if not args.oxts and (given := first_given(useless)):
        raise ConfigError(f"{given} goes with --oxts DIR, the raw drive: without it there are no readings and no start")
    oxts = None
    if args.oxts:
        oxts = read_oxts(args.oxts, first_frame=args.first_frame, image_times=args.image_times, problems=problems)
    return read_kitti(
        args.source, vehicle=args.vehicle, sigma=_sigma(args), colour=args.colour, oxts=oxts, problems=problems
    )


def _read_kagaru(args: argparse.Namespace, problems: Problems) -> Source:
    from uav_vslam.datasets.importing.kagaru import read_kagaru

    return read_kagaru(args.source, args.layout, vehicle=args.vehicle, sigma=_sigma(args), problems=problems)
