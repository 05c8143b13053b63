# SPDX-License-Identifier: Apache-2.0
"""Image files with stamps: those that exist, in pairs, recorded as they are.

Jpeg and png files are copied byte for byte; other kinds are decoded, and recorded as raw images.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uav_vslam.datasets.flight_writer import SourceFrame, SourceImage
from uav_vslam.datasets.importing.motion import Motion
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.importing.tables import REPEATED, UNREADABLE, Table, in_range, numbered_lines
from uav_vslam.datasets.messages import decodable, decoded
from uav_vslam.search import nearest

COPIED = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}
MISSING, UNPAIRED = "missing pictures", "pictures without a partner"


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
    """Return the existing pictures of a csv file of stamps [ns] and names.

    Args:
        path: the file.
        folder: of the pictures.
        problems: collects lines and pictures that are left out.

    Raises:
        BagError: the list can't be read.
    """
    listed: list[tuple[int, Path, int]] = []
    for line, text in numbered_lines(path):
        stamp, _, name = text.partition(",")
        try:
            if not name.strip():
                raise ValueError("it has no name")
            listed.append((in_range(int(stamp)), folder / name.strip(), line))
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
            sizes[folder] = {f.name: f.stat().st_size for f in folder.iterdir()} if folder.is_dir() else {}
        if not sizes[folder].get(path.name):
            wrong = "is empty" if path.name in sizes[folder] else "does not exist"
            problems.add(MISSING, source, f"picture {path} {wrong}", line=line)
        elif stamp in kept:
            problems.add(REPEATED, source, f"the stamp {stamp} ns is used twice; {path.name} is left out", line=line)
        else:
            kept[stamp] = Picture(stamp, path)
    return [kept[stamp] for stamp in sorted(kept)]


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


def covered_pairs(pairs: list[PicturePair], truth: Motion) -> tuple[list[PicturePair], tuple[str, ...]]:
    """Return the pairs from the first to the last stamp of the ground truth, and a note if there are others."""
    covered = [pair for pair in pairs if truth.covers(pair.stamp_ns)]
    outside = len(pairs) - len(covered)
    return covered, (f"{outside} image pairs before or after the ground truth are left out",) if outside else ()


def shifted(pairs: list[PicturePair], offset_ns: int) -> list[PicturePair]:
    """Return the pairs with an offset [ns] added to their stamps."""

    def later(picture: Picture) -> Picture:
        return Picture(picture.stamp_ns + offset_ns, picture.path)

    return [PicturePair(later(pair.left), later(pair.right)) for pair in pairs]


def frames(pairs: list[PicturePair], problems: Problems, *, encoding: str = "") -> Iterator[SourceFrame]:
    """Read pairs of files; a pair with a file that can't be read is left out.

    Args:
        pairs: the files.
        problems: collects pictures that are left out.
        encoding: of Bayer mosaics ("bayer_rggb8"); empty if the pixels are grey or colour.
    """
    for pair in pairs:
        left, right = (_image(picture, problems, encoding) for picture in (pair.left, pair.right))
        if left is not None and right is not None:
            yield SourceFrame(left, right)


def _image(picture: Picture, problems: Problems, encoding: str) -> SourceImage | None:
    path = picture.path
    try:
        data = path.read_bytes()
    except OSError as error:
        problems.add(MISSING, path, f"can't be read ({error.strerror})")
        return None
    fmt = COPIED.get(path.suffix.lower(), "")
    content = _copied(data) if fmt else decoded(np.frombuffer(data, np.uint8))
    if content is None:
        problems.add(MISSING, path, "can't be decoded")
        return None
    return SourceImage(picture.stamp_ns, content, fmt, encoding)


def _copied(data: bytes) -> bytes | None:
    """Return a file's bytes if they can be decoded: nobody could read the recording otherwise."""
    return data if decodable(np.frombuffer(data, np.uint8)) else None
