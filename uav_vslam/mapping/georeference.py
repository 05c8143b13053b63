# SPDX-License-Identifier: Apache-2.0
"""Rasters as files that a GIS puts in their place.

With a datum, a file is a GeoTIFF in a transverse Mercator projection of its own, centred on the datum, whose scale is
that of the datum's altitude: there, map and projection agree to 2 mm in the plane within 5 km, so that no pixel has to
be resampled. The place of ground above or below is off in proportion to its height over the earth's radius: at 5 km, by
8 cm for each 100 m. A map that is turned against north gets a turned grid. Without a datum, coordinates are those of
the map frame. Files have north first; arrays here have south first, as `Raster` has it.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.files.geodetic import Datum
from uav_vslam.mapping.float_pyramid import TILE_PX, FloatPyramid
from uav_vslam.mapping.raster import Raster

WGS84_A_M, WGS84_F = 6378137.0, 1.0 / 298.257223563
USER_DEFINED, PROJECTED, AREA, TRANSVERSE_MERCATOR, METRE, WGS84 = 32767, 1, 1, 1, 9001, 4326
# Tags of GeoTIFF and GDAL, and their TIFF types.
PIXEL_SCALE, TIE_POINT, TRANSFORMATION, KEYS, DOUBLES, TEXTS, METADATA, NO_DATA = (
    33550,
    33922,
    34264,
    34735,
    34736,
    34737,
    42112,
    42113,
)
SHORT, DOUBLE, ASCII = 3, 12, 2
OVERVIEW = 1  # type of a reduced page


def write_picture(
    path: Path, image: NDArray[np.uint8], raster: Raster, datum: Datum | None, *, seen: NDArray[np.bool_]
) -> Path:
    """Write a picture and where it lies: a GeoTIFF with a datum, else PNG with a world file (.pgw).

    Args:
        path: without a suffix.
        image: (rows, columns) grey or (rows, columns, 3) BGR.
        raster: its window of the map frame.
        datum: of the map frame, if known.
        seen: (rows, columns); the rest becomes transparent.

    Returns:
        The picture's path.

    Raises:
        UavVslamError: the picture can't be written.
    """
    channels = [image] if image.ndim == 2 else [image[..., k] for k in range(3)]
    opaque = seen.view(np.uint8) * np.uint8(255)
    if datum is not None:
        path = path.with_suffix(".tif")
        kind = "minisblack" if image.ndim == 2 else "rgb"
        stack = _north_first([*channels[::-1], opaque])
        _write_tiff(path, stack, _tags(raster, datum), photometric=kind)
        return path
    path = path.with_suffix(".png")
    bgr = channels * 3 if image.ndim == 2 else channels
    if not cv2.imwrite(str(path), _north_first([*bgr, opaque])):
        raise UavVslamError(f"picture {path} can't be written; is the folder there, and the disk not full?")
    path.with_suffix(".pgw").write_text(world_file(raster), encoding="ascii")
    return path


def write_bands(path: Path, bands: Mapping[str, NDArray[np.generic]], raster: Raster, datum: Datum | None) -> None:
    """Write a float32 GeoTIFF of several bands; NaN is no data.

    Args:
        path: of the file, `.tif`.
        bands: (rows, columns) each, by name.
        raster: their window of the map frame.
        datum: of the map frame, if known.

    Raises:
        UavVslamError: the file can't be written.
    """

    def part(window: Raster) -> list[NDArray[np.generic]]:
        cut = window.within(raster)
        return [band[cut] for band in bands.values()]

    write_parts(path, list(bands), part, raster, datum)


def write_parts(
    path: Path,
    names: Sequence[str],
    part: Callable[[Raster], Sequence[NDArray[np.generic]]],
    raster: Raster,
    datum: Datum | None,
) -> None:
    """Write a float32 GeoTIFF of several bands, of which only a part at a time is in memory; NaN is no data.

    Args:
        path: of the file, `.tif`.
        names: of the bands.
        part: returns the bands of a window, (rows, columns) each.
        raster: the whole window of the map frame.
        datum: of the map frame, if known.

    Raises:
        UavVslamError: the file can't be written.
    """
    items = [
        f'<Item name="DESCRIPTION" sample="{k}" role="description">{escape(name)}</Item>'
        for k, name in enumerate(names)
    ]
    metadata = f"<GDALMetadata>{''.join(items)}</GDALMetadata>"
    tags = [*_tags(raster, datum), _text(METADATA, metadata), _text(NO_DATA, "nan")]
    pyramid = FloatPyramid(raster.shape, len(names))
    north = raster.row + raster.rows
    for row, column in pyramid.places:
        place = Raster(
            raster.cell_m, raster.column + column * TILE_PX, north - (row + 1) * TILE_PX, TILE_PX, TILE_PX
        ).intersection(raster)
        pyramid.add(row, column, [band[::-1] for band in part(place)])
    with naming(path), tifffile.TiffWriter(path) as file:
        for level, (shape, tiles) in enumerate(pyramid.levels()):
            file.write(
                tiles,
                shape=(len(names), *shape),
                dtype=np.float32,
                photometric="minisblack",
                planarconfig="separate",
                extrasamples=["unspecified"] * (len(names) - 1),
                **_page(tags, level),
            )


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let an error of the disk name the file that is written.

    Raises:
        UavVslamError: the file can't be written.
    """
    try:
        yield
    except OSError as error:
        raise UavVslamError(f"{path} can't be written: {error.strerror or error}") from error


def world_file(raster: Raster) -> str:
    """Return the six lines that place a picture with north first: pixel size, turns, centre of its first pixel."""
    values = (raster.cell_m, 0.0, 0.0, -raster.cell_m, raster.x[0], raster.y[-1])
    return "".join(f"{value:.10g}\n" for value in values)


def scale_at(datum: Datum) -> float:
    """Return the projection's scale, metres of the map per metre on the ellipsoid."""
    e2 = WGS84_F * (2.0 - WGS84_F)
    w2 = 1.0 - e2 * np.sin(np.deg2rad(datum.latitude_deg)) ** 2
    radius_m = WGS84_A_M * np.sqrt(1.0 - e2) / w2  # Gaussian radius of curvature
    return float(1.0 + datum.altitude_m / radius_m)


def _north_first(channels: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Return (rows, columns, channels) of arrays with south first, without a further copy."""
    stack = np.empty((*channels[0].shape, len(channels)), np.uint8)
    for k, channel in enumerate(channels):
        stack[::-1, :, k] = channel
    return stack


def _write_tiff(path: Path, stack: NDArray[np.uint8], tags: list[Any], *, photometric: str) -> None:
    """Write (rows, columns, channels), the last one opacity, with north first as a deflated TIFF.

    Overviews of every second pixel follow, down to one tile, so that a GIS shows a large one at once.
    """
    colours = 3 if photometric == "rgb" else 1
    extra = ["unassalpha"] * (stack.shape[-1] - colours)
    with naming(path), tifffile.TiffWriter(path) as file:
        for level in itertools.count():
            file.write(stack, photometric=photometric, planarconfig="contig", extrasamples=extra, **_page(tags, level))
            if max(stack.shape[:2]) <= TILE_PX:
                break
            stack = stack[::2, ::2]


def _page(tags: list[Any], level: int) -> dict[str, Any]:
    """Return what all pages have in common; the first one has the tags, the others are overviews."""
    return {
        "tile": (TILE_PX, TILE_PX),
        "compression": "zlib",
        "extratags": [] if level else tags,
        "subfiletype": OVERVIEW if level else 0,
        "metadata": None,
        "software": False,
    }


def _tags(raster: Raster, datum: Datum | None) -> list[Any]:
    """Return the tags that place a raster."""
    keys, doubles, texts = _keys(datum)
    placed = [(KEYS, SHORT, len(keys), keys, True), _text(TEXTS, texts)]
    if doubles:
        placed.append((DOUBLES, DOUBLE, len(doubles), doubles, True))
    west, _, _, north = raster.bounds_m
    size = raster.cell_m
    if datum is None or datum.yaw_deg == 0.0:
        corner = (0.0, 0.0, 0.0, west, north, 0.0)
        return [*placed, (PIXEL_SCALE, DOUBLE, 3, (size, size, 0.0), True), (TIE_POINT, DOUBLE, 6, corner, True)]
    c, s = np.cos(np.deg2rad(datum.yaw_deg)), np.sin(np.deg2rad(datum.yaw_deg))
    matrix = np.eye(4)
    matrix[:2, :2] = [[c * size, s * size], [s * size, -c * size]]  # columns along the map's x, rows against its y
    matrix[:2, 3] = c * west - s * north, s * west + c * north
    matrix[2, 2] = 0.0
    return [*placed, (TRANSFORMATION, DOUBLE, 16, tuple(matrix.ravel()), True)]


def _keys(datum: Datum | None) -> tuple[tuple[int, ...], tuple[float, ...], str]:
    """Return the directory of GeoKeys, its doubles and its texts."""
    if datum is None:
        text = "map frame, without datum|"  # pictures alone tell neither metres nor north
        entries = [(1024, 0, 1, USER_DEFINED), (1025, 0, 1, AREA), (1026, TEXTS, len(text), 0)]
        return _directory(entries), (), text
    text = "transverse Mercator centred on the map's datum|"
    doubles = (datum.longitude_deg, datum.latitude_deg, 0.0, 0.0, scale_at(datum))
    entries = [
        (1024, 0, 1, PROJECTED),
        (1025, 0, 1, AREA),
        (1026, TEXTS, len(text), 0),
        (2048, 0, 1, WGS84),
        (3072, 0, 1, USER_DEFINED),
        (3073, TEXTS, len(text), 0),
        (3074, 0, 1, USER_DEFINED),
        (3075, 0, 1, TRANSVERSE_MERCATOR),
        (3076, 0, 1, METRE),
        *((key, DOUBLES, 1, k) for k, key in enumerate((3080, 3081, 3082, 3083, 3092))),
    ]
    return _directory(entries), doubles, text


def _directory(entries: list[tuple[int, int, int, int]]) -> tuple[int, ...]:
    return (1, 1, 0, len(entries), *(value for entry in entries for value in entry))


def _text(tag: int, text: str) -> Any:
    return tag, ASCII, len(text) + 1, text, True
