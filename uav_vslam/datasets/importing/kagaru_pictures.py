# SPDX-License-Identifier: Apache-2.0
"""Pictures that a layout names, with stamps from a file of frame times or from their names."""

import re
from collections.abc import Sequence
from glob import glob
from pathlib import Path

from uav_vslam.datasets.importing.kagaru_settings import CamerasSettings, SideSettings
from uav_vslam.datasets.importing.pictures import Picture, PicturePair, existing, first_readable, paired
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.importing.tables import UNREADABLE
from uav_vslam.errors import BagError, CalibrationError, ConfigError
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NS_PER_S

NUMBER = re.compile(r"\d+(?:\.\d+)?")


def read_pairs(folder: Path, cameras: CamerasSettings, problems: Problems) -> list[PicturePair]:
    """Return the pairs of both cameras' pictures.

    Raises:
        ConfigError: the layout is incomplete.
        BagError: there are no pictures, their stamps are unknown, or none pair up.
    """
    left, right = (_pictures(folder, cameras, side, problems) for side in (cameras.left, cameras.right))
    pairs = paired(left, right, problems, tolerance_ns=round(cameras.pair_tolerance_s * NS_PER_S))
    if not pairs:
        raise BagError(
            f"{folder}: none of {len(left)} left and {len(right)} right pictures pair up; check the stamps, and "
            "cameras.pair_tolerance_s"
        )
    return pairs


def _pictures(folder: Path, cameras: CamerasSettings, side: SideSettings, problems: Problems) -> list[Picture]:
    """Return the pictures of one camera with their stamps."""
    if not side.images:
        raise ConfigError("cameras.left.images and cameras.right.images must name the pictures, e.g. front/*.pgm")
    files = sorted((folder / name for name in glob(side.images, root_dir=folder, recursive=True)), key=_natural)
    if not files:
        raise BagError(f"{folder} holds no picture {side.images}")
    if not side.times:
        return _stamped_by_name(files, cameras, folder, problems)
    times = cameras.text_file(folder / side.times)
    columns = times.indices([*cameras.time_columns, *([cameras.name_column] if cameras.name_column else [])])
    rows = list(times.rows())
    if not cameras.name_column and len(rows) != len(files):
        raise BagError(
            f"{times.path} has {len(rows)} lines for {len(files)} pictures {side.images}, so which belongs to which is "
            "unknown; set cameras.name_column, or complete the data set"
        )
    listed: list[tuple[int, Path, int]] = []
    for k, (line, fields) in enumerate(rows):
        try:
            texts = [fields[column] for column in columns]
            path = files[0].parent / texts.pop() if cameras.name_column else files[k]
            listed.append((cameras.clock.stamp_ns(texts), path, line))
        except (IndexError, ValueError) as error:
            wrong = f"only {len(fields)} columns" if isinstance(error, IndexError) else str(error)
            problems.add(UNREADABLE, times.path, wrong, line=line)
    return existing(listed, times.path, problems)


def _stamped_by_name(files: list[Path], cameras: CamerasSettings, folder: Path, problems: Problems) -> list[Picture]:
    """Return pictures whose stamps are the last number in their names."""
    if len(cameras.time_units) != 1:
        raise ConfigError("stamps in file names have one unit; set cameras.times, or one of cameras.time_units")
    listed: list[tuple[int, Path, int]] = []
    for path in files:
        found = NUMBER.findall(path.stem)
        try:
            if not found:
                raise ValueError("no number in its name")
            listed.append((cameras.clock.stamp_ns(found[-1:]), path, 0))
        except ValueError as error:
            problems.add(UNREADABLE, path, str(error))
    return existing(listed, folder, problems)


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts img2 before img10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", str(path)) if part]


def encoding_of(pairs: Sequence[PicturePair], bayer: str, rig: StereoRig) -> str:
    """Return the ROS encoding of mosaics, empty if the pictures are none.

    Raises:
        BagError: no pair can be decoded.
        CalibrationError: the first one that can is of another size than calibrated.
        ConfigError: a picture in colour can't be a mosaic.
    """
    found = first_readable(pairs)
    if found is None:
        raise BagError(f"{pairs[0].left.path}: no pair from it on can be decoded; are they pictures?")
    path, pixels = found[0].left.path, found[1]
    height, width = pixels.shape[:2]
    if (width, height) != (rig.left.width, rig.left.height):
        raise CalibrationError(
            f"{path} is {width}x{height} px but the calibration says {rig.left.width}x{rig.left.height}; calibrate at "
            "the recorded size"
        )
    if bayer == "none":
        return ""
    if pixels.ndim != 2:
        raise ConfigError(f"cameras.bayer is {bayer}, but {path} is in colour already; use none")
    return f"bayer_{bayer}{8 * pixels.dtype.itemsize}"
