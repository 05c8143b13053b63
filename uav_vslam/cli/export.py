# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam export`: trajectories of results folders and files in other formats, and as lines on a map."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.cli.arguments import add_datum, datum_of
from uav_vslam.cli.messages import DISK_FULL

if TYPE_CHECKING:
    from uav_vslam.evaluation.trajectory import Trajectory

HELP = "write trajectories as TUM, KITTI, CSV, GeoJSON or KML"
EXAMPLES = """examples:
  uav-vslam export results/latest --format kml --datum -28.2325 153.0012 20     one flight.kml for Google Earth
  uav-vslam export results/latest --format kitti --out kitti --tracks truth c_slam
  uav-vslam export orbslam.txt --format csv                                     beside the file

csv has EuRoC's columns and the covariance if it is known; kitti has KITTI's axes (x right, y down, z forward), and its
stamps are in NAME_times.txt. geojson and kml need the place of the map's origin; the map's x axis points east, or --yaw
degrees counter-clockwise from there. Altitudes count from where the datum's does: above sea level for kml, above
the WGS 84 ellipsoid for geojson.
"""
FORMATS = {"tum": ".tum", "kitti": "_kitti.txt", "csv": ".csv"}
MAPS = ("geojson", "kml")
TRACKS = ("truth", "ins", "s_slam", "c_slam", "smoothed")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("source", type=Path, metavar="RESULTS|FILE", help="results folder or trajectory file")
    parser.add_argument("--format", required=True, choices=[*FORMATS, *MAPS], help="what to write")
    add_datum(parser, "maps")
    parser.add_argument("--times", type=Path, metavar="FILE", help="stamps [s] of a KITTI file, one a line")
    parser.add_argument("--tracks", nargs="+", choices=TRACKS, help="of a results folder (default all)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder to write to (default: that of the source)")


def run(args: argparse.Namespace) -> int:
    """Write the files and print their names."""
    from uav_vslam.errors import ConfigError

    _refuse_useless(args)
    tracks = _tracks(args)
    folder = args.out or (args.source if args.source.is_dir() else args.source.parent)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        written = _write_map(tracks, folder, args) if args.format in MAPS else _write_each(tracks, folder, args)
    except OSError as error:
        if error.errno in DISK_FULL:
            raise
        raise ConfigError(
            f"{error.filename or folder}: can't be written ({error.strerror}); choose another folder by --out"
        ) from None
    for path in written:
        print(path)
    return 0


def _refuse_useless(args: argparse.Namespace) -> None:
    """Refuse options that the format or the kind of source leaves without effect."""
    from uav_vslam.errors import ConfigError

    if (args.datum is None) == (args.format in MAPS):
        need = "needs" if args.format in MAPS else "has no place for"
        raise ConfigError(f"--format {args.format} {need} --datum LAT LON ALT")
    if args.yaw is not None and args.format not in MAPS:
        raise ConfigError(f"--format {args.format} has no place for --yaw DEG")
    if args.times is not None and args.source.is_dir():
        raise ConfigError(f"--times belongs to a KITTI file; {args.source} is a results folder")
    if args.tracks is not None and not args.source.is_dir():
        raise ConfigError(f"--tracks belongs to a results folder; {args.source} is none")


def _tracks(args: argparse.Namespace) -> dict[str, Trajectory]:
    """Return the trajectories by the name of their file."""
    from uav_vslam.errors import ConfigError, TrajectoryFileError
    from uav_vslam.evaluation.files.reading import is_kitti, read_trajectory
    from uav_vslam.evaluation.files.results_folder import read_results

    if not args.source.is_dir():
        on_map = args.format in MAPS  # a line on a map has no stamps
        track = read_trajectory(args.source, times=args.times, numbered=on_map)
        if args.times is not None and not is_kitti(args.source):
            raise ConfigError(f"--times belongs to a KITTI file; {args.source} has stamps of its own")
        return {args.source.stem: track}
    wanted = args.tracks or TRACKS
    found = {
        f"{vehicle}_{name}": track
        for vehicle, tracks in read_results(args.source).items()
        for name, track in tracks.items()
        if name in wanted
    }
    if not found:
        raise TrajectoryFileError(f"{args.source} holds none of the tracks {', '.join(wanted)}")
    return found


def _write_each(tracks: dict[str, Trajectory], folder: Path, args: argparse.Namespace) -> list[Path]:
    from uav_vslam.evaluation.files.writing import write_csv, write_kitti, write_tum

    write = {"tum": write_tum, "kitti": write_kitti, "csv": write_csv}[args.format]
    return [write(track, _new(folder / f"{name}{FORMATS[args.format]}")) for name, track in tracks.items()]


def _write_map(tracks: dict[str, Trajectory], folder: Path, args: argparse.Namespace) -> list[Path]:
    from uav_vslam.evaluation.files.maps import write_geojson, write_kml

    write = {"geojson": write_geojson, "kml": write_kml}[args.format]
    stem = "flight" if args.source.is_dir() else args.source.stem
    return [write(tracks, _new(folder / f"{stem}.{args.format}"), datum_of(args))]


def _new(path: Path) -> Path:
    from uav_vslam.errors import ConfigError

    if path.exists():
        raise ConfigError(f"{path} is there already; remove it, or choose another folder by --out")
    return path
