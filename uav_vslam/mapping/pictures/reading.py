# SPDX-License-Identifier: Apache-2.0
"""A folder's pictures in the order of time, and the table of positions that may lie beside them.

`gps.csv` has a header and one row a picture. Columns: `file`; `lat_deg`, `lon_deg` (WGS 84, degrees); `alt_m` [m]; and
optionally `datetime` as in EXIF, "2014:10:19 13:21:23". It takes precedence over EXIF; latitude and longitude 0 stand
for no position.
"""

import csv
import dataclasses
import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image as PillowImage

from uav_vslam.errors import PictureError
from uav_vslam.mapping.pictures.exif import clock_s, metadata_of
from uav_vslam.mapping.pictures.picture import Geodetic, Picture

SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff"}
TABLE = "gps.csv"
NEEDED = ("file", "lat_deg", "lon_deg", "alt_m")
FEWEST = 2
NAMED = 5  # files that a message lists
SAME_FOCAL = 1.02  # ratio of focal lengths by EXIF up to which one lens has them: they are rounded, and focus counts


@dataclass(frozen=True, slots=True)
class Folder:
    """What a folder holds: pictures in the order of time, and warnings about what was left out."""

    pictures: tuple[Picture, ...]
    warnings: tuple[str, ...]


def read_folder(folder: Path, *, focal_px: float | None = None) -> Folder:
    """Return a folder's pictures; those in folders below it are not taken.

    Args:
        folder: holds JPEG, PNG or TIFF files and, optionally, `gps.csv`.
        focal_px: focal length of all pictures [px]; None takes EXIF's.

    Raises:
        PictureError: there are fewer than two pictures, or the table is malformed.
    """
    if not folder.is_dir():
        raise PictureError(f"{folder} is not a folder; name the one that holds the pictures")
    files = _files(folder)
    below = [path for path in sorted(folder.iterdir()) if path.is_dir() and _files(path)]
    pictures, unreadable, flat = _opened(files)
    pictures, copies = _without_copies(pictures)
    if len(pictures) < FEWEST:
        raise PictureError(
            f"{folder} holds {len(pictures)} different pictures ({', '.join(sorted(SUFFIXES))}) that can be read; "
            f"a mosaic needs {FEWEST} or more"
            + "".join(f"; {text}" for text in [*_left_out(unreadable, copies, below), *_of_other_kinds(folder)])
        )
    table = folder / TABLE
    positions = read_positions(table) if table.is_file() else {}
    if focal_px is not None:
        pictures = [dataclasses.replace(picture, focal_px=focal_px) for picture in pictures]
    pictures = [_with_row(picture, positions) for picture in _by_focal_length(_lying_alike(pictures))]
    texts = [*_left_out(unreadable, copies, below), *_unnamed(positions, pictures), *_without_altitude(flat, pictures)]
    return Folder(tuple(_by_time(pictures)), tuple(texts))


def _files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the table."""

    position: Geodetic | None
    time_s: float | None


def read_positions(path: Path) -> dict[str, Row]:
    """Return the rows of a table of positions by the pictures' file names.

    Raises:
        PictureError: it is no table in UTF-8, a column is missing, or a value is no number or out of range.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            found = reader.fieldnames or ()
            if missing := [name for name in NEEDED if name not in found]:
                raise PictureError(
                    f"{path} has no column {', '.join(missing)}; it needs {','.join(NEEDED)}[,datetime], separated by "
                    f"commas, and its first line is {','.join(found)!r}"
                )
            return {row["file"]: _row(row, f"{path}, line {reader.line_num}") for row in reader}
    except UnicodeDecodeError as error:
        raise PictureError(f"{path} is not UTF-8 ({error.reason}); save it as CSV in UTF-8") from None
    except csv.Error as error:  # a cell of more than 128 kB
        raise PictureError(f"{path} is no table ({error}); is a quotation mark not closed?") from None


def _row(row: dict[str, str], where: str) -> Row:
    try:
        latitude, longitude, height = (float(row[name]) for name in NEEDED[1:])
    except (TypeError, ValueError):
        values = ", ".join(str(row[name]) for name in NEEDED[1:])
        raise PictureError(f"{where}: lat_deg, lon_deg, alt_m are {values}; each must be a number") from None
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and abs(height) < 1e5):
        raise PictureError(f"{where}: {latitude}, {longitude}, {height} is no WGS 84 position")
    position = Geodetic(latitude, longitude, height)
    return Row(None if position.unset else position, clock_s(row.get("datetime")))


def _opened(files: Sequence[Path]) -> tuple[list[Picture], list[Path], set[Path]]:
    """Return the pictures of files, the files that are none or damaged, and those whose GPS has no altitude."""
    found, unreadable, flat = [], [], set()
    for path in files:
        try:
            with PillowImage.open(path) as image:
                size, data, has_alpha = image.size, metadata_of(image), image.has_transparency_data
                _check_whole(image)
        except (OSError, SyntaxError, ValueError, EOFError, PillowImage.DecompressionBombError):
            unreadable.append(path)
            continue
        picture = Picture(path, *size, False, data.camera, data.focal_px, data.time_s, data.position)
        found.append(dataclasses.replace(picture, has_alpha=has_alpha))
        if data.without_altitude:
            flat.add(path)
    return found, unreadable, flat


def _check_whole(image: PillowImage.Image) -> None:
    """Raise if the file ends early: OpenCV decodes such a picture, and paints the rest grey."""
    image.draft("L", (image.width // 8, image.height // 8))  # JPEG only: read to the end, but decoded coarsely
    image.load()


def _without_copies(pictures: Sequence[Picture]) -> tuple[list[Picture], list[Path]]:
    """Return the pictures whose files differ, and the files that are copies of earlier ones."""
    seen: set[bytes] = set()
    kept, copies = [], []
    for picture in pictures:
        digest = hashlib.sha256(picture.path.read_bytes()).digest()
        if digest in seen:
            copies.append(picture.path)
        else:
            kept.append(picture)
        seen.add(digest)
    return kept, copies


def _lying_alike(pictures: Sequence[Picture]) -> list[Picture]:
    """Return the pictures with portrait and landscape images of one camera turned the same way, and named cameras."""
    sizes = Counter((picture.width, picture.height) for picture in pictures)
    return [_lying(picture, sizes) for picture in pictures]


def _lying(picture: Picture, sizes: Counter[tuple[int, int]]) -> Picture:
    upright, across = (picture.width, picture.height), (picture.height, picture.width)
    turned = (sizes[across], across) > (sizes[upright], upright)
    width, height = across if turned else upright
    camera = f"{picture.camera or 'camera'} {width}x{height}"
    return dataclasses.replace(picture, width=width, height=height, turned=turned, camera=camera)


def _by_focal_length(pictures: Sequence[Picture]) -> list[Picture]:
    """Return the pictures with the focal length in the camera's name where one has several: a zoom, two lenses."""
    nominal = {name: _nominal([p for p in pictures if p.camera == name]) for name in {p.camera for p in pictures}}
    return [_at_focal_length(picture, nominal[picture.camera]) for picture in pictures]


def _nominal(pictures: Sequence[Picture]) -> list[float]:
    """Return the smallest focal length [px] of each group of pictures with about the same one, ascending."""
    starts: list[float] = []
    for focal in sorted(picture.focal_px for picture in pictures if picture.focal_px is not None):
        if not starts or focal > SAME_FOCAL * starts[-1]:
            starts.append(focal)
    return starts


def _at_focal_length(picture: Picture, nominal: Sequence[float]) -> Picture:
    if len(nominal) < 2 or picture.focal_px is None:
        return picture
    own = max(focal for focal in nominal if focal <= picture.focal_px)
    return dataclasses.replace(picture, camera=f"{picture.camera} at {own:.0f} px")


def _with_row(picture: Picture, rows: dict[str, Row]) -> Picture:
    row = rows.get(picture.name)
    if row is None:
        return picture
    return dataclasses.replace(picture, position=row.position or picture.position, time_s=row.time_s or picture.time_s)


def _by_time(pictures: Sequence[Picture]) -> list[Picture]:
    """Return the pictures by time if all have one, else by name."""
    if any(picture.time_s is None for picture in pictures):
        return sorted(pictures, key=lambda picture: picture.name)
    return sorted(pictures, key=lambda picture: (picture.time_s, picture.name))


def _left_out(unreadable: Sequence[Path], copies: Sequence[Path], below: Sequence[Path]) -> Iterator[str]:
    if unreadable:
        yield f"left out, no pictures or damaged: {listed([path.name for path in unreadable])}"
    if copies:
        yield f"left out, copies of other files: {listed([path.name for path in copies])}"
    if below:
        yield f"not taken, pictures in the folders {listed([path.name for path in below])}; name one of these to use it"


def _of_other_kinds(folder: Path) -> Iterator[str]:
    """Name what is neither picture nor table, such as raw images and videos, where pictures are missing."""
    others = [path.name for path in sorted(folder.iterdir()) if path.is_file() and path.suffix.lower() not in SUFFIXES]
    others = [name for name in others if name != TABLE and not name.startswith(".")]
    if others:
        yield f"not read: {listed(others)}; convert raw images or the frames of a video to JPEG first"


def _unnamed(rows: dict[str, Row], pictures: Sequence[Picture]) -> Iterator[str]:
    if rows and not any(picture.name in rows for picture in pictures):
        yield f"{TABLE} names none of the pictures; its column `file` must hold names such as {pictures[0].name}"


def _without_altitude(flat: set[Path], pictures: Sequence[Picture]) -> Iterator[str]:
    if names := [picture.name for picture in pictures if picture.position is None and picture.path in flat]:
        yield f"not used, GPS positions without an altitude: {listed(names)}; {TABLE} can give them with one"


def listed(names: Sequence[str]) -> str:
    """Return the first names, and how many more there are."""
    more = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")
