# SPDX-License-Identifier: Apache-2.0
"""Image files with stamps: those that exist, in pairs, recorded as they are.

Jpeg and png files are copied byte for byte; other kinds are decoded, and recorded as raw images.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.flight_writer import SourceFrame, SourceImage
from uav_vslam.datasets.importing.motion import Motion
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.importing.tables import REPEATED, UNREADABLE, Table, numbered_lines, whole_ns
from uav_vslam.datasets.messages import decoded, halved
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.search import nearest
from uav_vslam.types import NS_PER_S

COPIED = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}
MISSING, UNPAIRED = "missing or broken pictures", "pictures without a partner"
OTHER_SIZE = "pictures of another size than calibrated"

Image = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Picture:
    """One image file and its exposure time [ns]."""

    stamp_ns: int
    path: Path


@dataclass(frozen=True, slots=True)
class PicturePair:
    """A left and a right picture."""

    left: Picture
    right: Picture

    @property
    def stamp_ns(self) -> int:
        """Stamp of the left picture [ns]."""
        return self.left.stamp_ns


def read_list(path: Path, folder: Path, problems: Problems) -> list[Picture]:
    """Return the existing pictures of a csv file of stamps [ns] and names; more columns are ignored.

    Args:
        path: the file.
        folder: of the pictures.
        problems: collects lines and pictures that are left out.

    Raises:
        BagError: the list can't be read.
    """
    listed: list[tuple[int, Path, int]] = []
    for line, text in numbered_lines(path):
        stamp, *others = text.split(",")
        name = others[0].strip().strip('"') if others else ""
        try:
            if not name:
                raise ValueError("it has no name")
            listed.append((whole_ns(stamp), folder / name, line))
        except ValueError as error:
            problems.add(UNREADABLE, path, f"{text!r} is not 'stamp,filename' ({error})", line=line)
    return existing(listed, path, problems)


def existing(listed: Iterable[tuple[int, Path, int]], source: Path, problems: Problems) -> list[Picture]:
    """Return the pictures of (stamp [ns], file, line in `source`) whose files exist and hold anything, by stamp."""
    kept: dict[int, Picture] = {}
    sizes: dict[Path, dict[str, int]] = {}
    for stamp, path, line in listed:
        folder = path.parent
        if folder not in sizes:  # one look into the folder is faster than one at each file
            sizes[folder] = _sizes_in(folder)
        if not sizes[folder].get(path.name):
            wrong = "is empty" if path.name in sizes[folder] else "does not exist"
            problems.add(MISSING, source, f"picture {path} {wrong}", line=line)
        elif stamp in kept:
            problems.add(REPEATED, source, f"the stamp {stamp} ns is used twice; {path.name} is left out", line=line)
        else:
            kept[stamp] = Picture(stamp, path)
    return [kept[stamp] for stamp in sorted(kept)]


def _sizes_in(folder: Path) -> dict[str, int]:
    """Return the sizes of a folder's files [bytes]; links that lead nowhere, as of a clone without data, are none."""
    return {file.name: file.stat().st_size for file in folder.iterdir() if file.exists()} if folder.is_dir() else {}


def paired(
    left: list[Picture], right: list[Picture], problems: Problems, *, tolerance_ns: int = 0
) -> list[PicturePair]:
    """Return the pairs of mutually nearest pictures whose stamps differ by at most the tolerance [ns]."""
    if not left or not right:
        return []
    left_ns, right_ns = (np.array([picture.stamp_ns for picture in side], np.int64) for side in (left, right))
    nearest_right, nearest_left = nearest(left_ns, right_ns), nearest(right_ns, left_ns)
    apart = np.abs(right_ns[nearest_right] - left_ns)
    mutual = nearest_left[nearest_right] == np.arange(len(left))
    chosen = np.flatnonzero(mutual & (apart <= tolerance_ns)).tolist()
    partners = nearest_right[chosen].tolist()
    for side, used in ((left, set(chosen)), (right, set(partners))):
        for k in (k for k in range(len(side)) if k not in used):
            problems.add(UNPAIRED, side[k].path, f"no picture of the other camera within {tolerance_ns / 1e6:g} ms")
    return [PicturePair(left[i], right[j]) for i, j in zip(chosen, partners, strict=True)]


def pairs_with_readings(pairs: list[PicturePair], imu: Table) -> tuple[list[PicturePair], tuple[str, ...]]:
    """Return the pairs from the first to the last reading, and a note if there are others."""
    first, last = imu.stamps_ns[[0, -1]].tolist()
    kept = [pair for pair in pairs if first <= pair.stamp_ns <= last]
    outside = len(pairs) - len(kept)
    return kept, (f"{outside} image pairs before or after the IMU's readings are left out",) if outside else ()


def covered_pairs(
    pairs: list[PicturePair], truth: Motion | None, *, lacking: str
) -> tuple[list[PicturePair], tuple[str, ...]]:
    """Return the pairs from the first to the last stamp of the ground truth, and a note if there are others.

    Without any, return all, and a note that begins with what is lacking.
    """
    if truth is None:
        return pairs, (f"{lacking}: start.method is in_flight, and nothing can be evaluated",)
    covered = [pair for pair in pairs if truth.covers(pair.stamp_ns)]
    outside = len(pairs) - len(covered)
    return covered, (f"{outside} image pairs before or after the ground truth are left out",) if outside else ()


def uncovered_text(pairs: list[PicturePair], imu: Table, truth: Motion | None) -> str:
    """Return in words why of all pairs none is covered by readings and, if there is any, ground truth."""
    if not pairs:
        return "no pictures of the two cameras pair up"
    stamps = {"pairs": np.array([pair.stamp_ns for pair in pairs]), "IMU readings": imu.stamps_ns}
    if truth:
        stamps["ground truth"] = truth.stamps_ns
    times = ", ".join(f"{what} from {ns[0] / NS_PER_S:.3f} to {ns[-1] / NS_PER_S:.3f} s" for what, ns in stamps.items())
    return f"none of {len(pairs)} image pairs is covered by {' and '.join([*stamps][1:])}: {times}"


def shifted(pairs: list[PicturePair], offset_ns: int) -> list[PicturePair]:
    """Return the pairs with an offset [ns] added to their stamps."""

    def later(picture: Picture) -> Picture:
        return Picture(picture.stamp_ns + offset_ns, picture.path)

    return [PicturePair(later(pair.left), later(pair.right)) for pair in pairs]


def first_readable(pairs: Iterable[PicturePair]) -> tuple[PicturePair, Image, Image] | None:
    """Return the first pair whose pictures can be decoded, with their pixels; None if there is none."""
    for pair in pairs:
        left, right = (_pixels(picture.path) for picture in (pair.left, pair.right))
        if left is not None and right is not None:
            return pair, left, right
    return None


def _pixels(path: Path) -> Image | None:
    try:
        return decoded(np.frombuffer(path.read_bytes(), np.uint8))
    except OSError:
        return None


def frames(
    pairs: list[PicturePair], rig: StereoRig, problems: Problems, *, encoding: str = ""
) -> Iterator[SourceFrame]:
    """Read pairs of files; a pair with a file that can't be read, or is not of the calibrated size, is left out.

    Args:
        pairs: the files.
        rig: calibration.
        problems: collects pictures that are left out.
        encoding: of Bayer mosaics ("bayer_rggb8"); empty if the pixels are grey or colour.
    """
    for pair in pairs:
        left = _image(pair.left, rig.left.size, problems, encoding)
        right = _image(pair.right, rig.right.size, problems, encoding)
        if left is not None and right is not None:
            yield SourceFrame(left, right)


def _image(picture: Picture, size: tuple[int, int], problems: Problems, encoding: str) -> SourceImage | None:
    path = picture.path
    try:
        data = path.read_bytes()
    except OSError as error:
        problems.add(MISSING, path, f"can't be read ({error.strerror})")
        return None
    fmt = COPIED.get(path.suffix.lower(), "")
    pixels = (halved if fmt else decoded)(np.frombuffer(data, np.uint8))
    if pixels is None:
        problems.add(MISSING, path, "can't be decoded")
        return None
    scale = 2 if fmt else 1
    height, width = pixels.shape[:2]
    if max(abs(width * scale - size[0]), abs(height * scale - size[1])) >= scale:  # half of an odd size is rounded
        about = "about " if scale > 1 else ""
        wrong = f"is {about}{width * scale}x{height * scale} px, but the calibration of {size[0]}x{size[1]} px"
        problems.add(OTHER_SIZE, path, wrong)
        return None
    return SourceImage(picture.stamp_ns, data if fmt else pixels, fmt, encoding)
