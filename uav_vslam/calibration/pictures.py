# SPDX-License-Identifier: Apache-2.0
"""Image pairs of a calibration board: from files, a folder or a recording."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from uav_vslam.calibration.procedure import Picture
from uav_vslam.config.input import image_names
from uav_vslam.datasets.bag import IMAGE_TYPES, vehicles
from uav_vslam.datasets.cdr import RawMessage, decode
from uav_vslam.datasets.image_sets import SUFFIXES, read_image
from uav_vslam.datasets.messages import header_stamp_ns, image_of
from uav_vslam.datasets.rosbag import is_bag, iter_raw, topics_of
from uav_vslam.datasets.stereo_sync import StereoPairer
from uav_vslam.errors import BagError, CalibrationError, UavVslamError
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.vision.images import to_grey8

Source = TypeVar("Source")

SIDE_FOLDERS = (("left", "right"), ("cam0", "cam1"), ("cam0/data", "cam1/data"), ("image_0", "image_1"))
# What names a camera in the name of a file; the rest of the name is that of the pair.
SIDE_WORDS = re.compile(r"left|right|cam(?:era)?(?:[0-9]|_[0-9](?![0-9]))|(?<![a-z])[lr](?![a-z])", re.IGNORECASE)
NAMED = 5  # files that an error lists


@dataclass(frozen=True, slots=True)
class FilePictures:
    """Pairs of image files.

    Attributes:
        names: of the pairs.
        left, right: files, pair by pair.
    """

    names: tuple[str, ...]
    left: tuple[Path, ...]
    right: tuple[Path, ...]

    def __len__(self) -> int:
        return len(self.left)

    def __iter__(self) -> Iterator[tuple[str, Picture, Picture]]:
        """Yield name, left and right picture of each pair."""
        for name, left, right in zip(self.names, self.left, self.right, strict=True):
            yield name, _picture(read_image, left), _picture(read_image, right)


@dataclass(frozen=True, slots=True)
class BagPictures:
    """Pairs of a recording, evenly spread over it.

    Attributes:
        path: of the bag.
        topics: of the left and of the right images.
        count: left images recorded.
        most: pairs to use.
    """

    path: Path
    topics: tuple[str, str]
    count: int
    most: int

    def __len__(self) -> int:
        return -(-self.count // self._every)

    def __iter__(self) -> Iterator[tuple[str, Picture, Picture]]:
        """Yield stamp [s], left and right picture of each pair; of a message without a stamp, when it was recorded."""
        pairer: StereoPairer[RawMessage] = StereoPairer()
        number = 0
        for raw in iter_raw([self.path], self.topics):
            side = "left" if raw.topic == self.topics[0] else "right"
            try:
                pair = pairer.add(side, header_stamp_ns(raw.data), raw)
            except BagError as error:
                yield f"{raw.stamp_ns * 1e-9:.3f}", error, error
                continue
            if pair is None:
                continue
            if number % self._every == 0:
                left, right = (_picture(_image_of_raw, image) for image in (pair.left, pair.right))
                yield f"{pair.stamp_ns * 1e-9:.3f}", left, right
            number += 1

    @property
    def _every(self) -> int:
        return max(1, -(-self.count // self.most))


Pictures = FilePictures | BagPictures


def _picture(read: Callable[[Source], NDArray[np.generic]], source: Source) -> Picture:
    try:
        return to_grey8(read(source))
    except UavVslamError as error:
        return error


def _image_of_raw(raw: RawMessage) -> NDArray[np.generic]:
    return image_of(decode(raw))


def pictures_of(inputs: Sequence[str], *, topics: Sequence[str] | None = None, most: int) -> Pictures:
    """Return the pictures that a command line names.

    Args:
        inputs: two patterns of files; the files of both, as a shell expands the patterns; a folder; or a bag.
        topics: of a bag's left and right images; None for those of its only vehicle.
        most: largest number of pairs to take from a bag.

    Raises:
        CalibrationError: there are no pictures, or some have no partner.
        BagError: the bag can't be read.
    """
    if len(inputs) == 1:
        path = Path(inputs[0])
        if path.is_dir() and not is_bag(path):
            return paired(*_sides_of(path))
        if not path.exists() or not is_bag(path):
            raise CalibrationError(
                f"{path} is neither a folder of pictures nor a bag; give one, or two patterns: 'LEFT*.png' 'RIGHT*.png'"
            )
        return _of_bag(path, topics, most)
    if len(inputs) == 2:
        left, right = (_files_like(pattern) for pattern in inputs)
        return paired(left, right)
    return paired(*_sides_among([Path(name) for name in inputs]))


def paired(left: Sequence[Path], right: Sequence[Path]) -> FilePictures:
    """Return files paired by what their names have in common beside the camera: left01.png and right01.png.

    If no names have anything in common, files pair up in sorted order.

    Raises:
        CalibrationError: files have no partner, or several that could be it, or are of both cameras.
    """
    if both := sorted(set(left) & set(right)):
        raise CalibrationError(f"{both[0]} is named as left and as right; name the pictures of both cameras")
    by_key = _by_key(left, right)
    if not by_key[0].keys() & by_key[1].keys():
        by_key = [{f"{k:03}": path for k, path in enumerate(sorted(files), 1)} for files in (left, right)]
    alone = sorted(by_key[0].keys() ^ by_key[1].keys())
    if alone:
        names = [str((by_key[0] | by_key[1])[key]) for key in alone]
        more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
        raise CalibrationError(
            f"{len(left)} left and {len(right)} right pictures; without a partner: {', '.join(names[:NAMED])}{more}; "
            "remove them, or name the patterns of both cameras"
        )
    keys = sorted(by_key[0])
    return FilePictures(tuple(keys), tuple(by_key[0][key] for key in keys), tuple(by_key[1][key] for key in keys))


def _by_key(left: Sequence[Path], right: Sequence[Path]) -> list[dict[str, Path]]:
    """Return the files of each side by the name of their pair: the name without the camera, else a name both share."""
    by_key = [{_key(path): path for path in files} for files in (left, right)]
    if len(by_key[0]) == len(left) and len(by_key[1]) == len(right):
        return by_key
    by_name = [{path.stem: path for path in files} for files in (left, right)]
    if len(by_name[0]) == len(left) and len(by_name[1]) == len(right) and by_name[0].keys() & by_name[1].keys():
        return by_name  # cam_1.png and cam_2.png of two folders number the pictures
    same = next(
        (path, kept[_key(path)])
        for files, kept in zip((left, right), by_key, strict=True)
        for path in files
        if kept[_key(path)] != path
    )
    raise CalibrationError(f"{same[0]} and {same[1]} could both be of pair {_key(same[0])!r}; rename one or remove it")


def _key(path: Path) -> str:
    return SIDE_WORDS.sub("", path.stem).strip("_-. ")


def _side_words(name: str) -> str:
    return " ".join(SIDE_WORDS.findall(name)).lower()


def _sides_among(files: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the files of two cameras, known by the words in their names or by their folders.

    Left is which the words say, or the lower number; if they say nothing, the camera of the first file.
    """
    for camera_of in (lambda path: _side_words(path.stem), lambda path: str(path.parent)):
        cameras: dict[str, list[Path]] = {}
        for path in files:
            cameras.setdefault(camera_of(path), []).append(path)
        if len(cameras) == 2:
            (first, left), (second, right) = cameras.items()
            return (right, left) if _swapped(first, second) else (left, right)
    raise CalibrationError(
        f"neither names nor folders identify the two cameras of {len(files)} pictures; give two patterns in quotes: "
        "'LEFT*.png' 'RIGHT*.png'"
    )


def _swapped(first: str, second: str) -> bool:
    """Return whether the first of two cameras is the right one, by the words in which their names differ."""
    words = zip(_side_words(first).split(), _side_words(second).split(), strict=False)
    places = [(_place(one), _place(other)) for one, other in words if one != other]
    return bool(places) and all(one[0] == other[0] and one > other for one, other in places)


def _place(word: str) -> tuple[str, int]:
    """Return what kind of word names the side, and which side: cam0 is left of cam1."""
    if word[-1].isdigit():
        return "number", int(word[-1])
    return "side", int(word.startswith("r"))


def _files_like(pattern: str) -> list[Path]:
    files = [Path(name) for name in glob(pattern) if Path(name).suffix.lower() in SUFFIXES]
    if not files:
        raise CalibrationError(f"no picture is like {pattern}; give a pattern such as 'boards/left*.png' in quotes")
    return files


def _sides_of(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the pictures of the two folders of the cameras, or those of one folder by the words in their names."""
    for names in SIDE_FOLDERS:
        if all((folder / name).is_dir() for name in names):
            left, right = (_pictures_in(folder / name) for name in names)
            if left and right:
                return left, right
    files = _pictures_in(folder)
    left, right = ([path for path in files if side in path.stem.lower()] for side in SIDES)
    if not left or not right:
        raise CalibrationError(
            f"{folder} holds {len(left)} pictures named left and {len(right)} named right, of {len(files)}, and no "
            "folders left and right or cam0 and cam1 with pictures; give two patterns: 'LEFT*.png' 'RIGHT*.png'"
        )
    return left, right


def _pictures_in(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES]


def _of_bag(path: Path, topics: Sequence[str] | None, most: int) -> BagPictures:
    recorded = topics_of([path])
    names = vehicles([path])
    wanted = topics or [f"/{names[0] if names else 'uav1'}/{side}/image_raw" for side in SIDES]
    found = [next((name for name in image_names(topic) if name in recorded), None) for topic in wanted]
    missing = [topic for topic, name in zip(wanted, found, strict=True) if name is None]
    left, right = found
    if left is None or right is None or (topics is None and len(names) > 1):
        images = sorted(topic for topic, info in recorded.items() if info.msgtype in IMAGE_TYPES)
        raise CalibrationError(
            f"bag {path} has {'no ' + ' and '.join(missing) if missing else 'several vehicles'}; name the images by "
            f"--topics; it has {', '.join(images) or 'none'}"
        )
    if left == right:
        raise CalibrationError(f"{left} is named as left and as right; name the images of both cameras by --topics")
    for topic in (left, right):
        if recorded[topic].msgtype not in IMAGE_TYPES:
            raise CalibrationError(f"{topic} is of {recorded[topic].msgtype}, no images; name others by --topics")
    return BagPictures(path, (left, right), recorded[left].count, most)
