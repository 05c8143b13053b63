# SPDX-License-Identifier: Apache-2.0
"""Files are read back as a GIS does."""

import re
from pathlib import Path

import cv2
import numpy as np
import pyproj
import pytest
import tifffile
from geotiff import place

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.files.geodetic import Datum, to_geodetic
from uav_vslam.mapping.georeference import write_bands, write_parts, write_picture
from uav_vslam.mapping.raster import Raster

RASTER = Raster(0.5, -4000, 2000, 300, 200)  # two kilometres west, one north of the datum
RNG = np.random.default_rng(1)
IMAGE = RNG.integers(0, 255, (*RASTER.shape, 3)).astype(np.uint8)
DATUM = Datum(-28.2325, 153.0012, 820.0)
TURNED = Datum(47.4, 8.5, 400.0, yaw_deg=25.0)
ALL = np.ones(RASTER.shape, bool)
SPOT = (150, 40)  # row from the south, column


@pytest.mark.parametrize("datum", [DATUM, TURNED], ids=["north up", "turned"])
@pytest.mark.parametrize("height_m", [0.0, 12.0])
def test_a_pixel_of_a_geotiff_is_where_the_datum_puts_it(tmp_path: Path, datum: Datum, height_m: float) -> None:
    path = write_picture(tmp_path / "orthomosaic", IMAGE, RASTER, datum, seen=ALL)
    row, column = SPOT
    found = place(path, RASTER.rows - 1 - row, column)
    lon, lat, _ = to_geodetic(np.array([[RASTER.x[column], RASTER.y[row], height_m]]), datum)[0]
    east_m = np.deg2rad(found[0] - lon) * 6.38e6 * np.cos(np.deg2rad(lat))
    north_m = np.deg2rad(found[1] - lat) * 6.38e6
    assert np.hypot(east_m, north_m) < 0.001 + height_m * 2300.0 / 6.3e6  # what is higher is projected outwards
    np.testing.assert_array_equal(tifffile.imread(path)[RASTER.rows - 1 - row, column, :3], IMAGE[row, column, ::-1])


@pytest.mark.parametrize(("height_m", "off_m"), [(0.0, 0.0), (100.0, 0.078), (-100.0, 0.078)])
def test_five_kilometres_away_only_the_height_above_the_datum_counts(
    tmp_path: Path, height_m: float, off_m: float
) -> None:
    far = Raster(0.5, -7100, 7000, 64, 64)
    black, seen = np.zeros((*far.shape, 3), np.uint8), np.ones(far.shape, bool)
    path = write_picture(tmp_path / "far", black, far, TURNED, seen=seen)
    lon, lat, _ = to_geodetic(np.array([[far.x[20], far.y[20], height_m]]), TURNED)[0]
    found = place(path, far.rows - 1 - 20, 20)
    _, _, distance_m = pyproj.Geod(ellps="WGS84").inv(lon, lat, *found)
    assert distance_m == pytest.approx(off_m, abs=0.003)


def test_without_a_datum_a_world_file_places_the_picture(tmp_path: Path) -> None:
    seen = IMAGE[..., 0] > 30
    path = write_picture(tmp_path / "orthomosaic", IMAGE, RASTER, None, seen=seen)
    a, d, b, e, c, f = map(float, path.with_suffix(".pgw").read_text().split())
    row, column = SPOT
    from_top = RASTER.rows - 1 - row
    assert (a * column + b * from_top + c, d * column + e * from_top + f) == pytest.approx(
        (RASTER.x[column], RASTER.y[row])
    )
    read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::-1]
    np.testing.assert_array_equal(read[..., :3], IMAGE)
    np.testing.assert_array_equal(read[..., 3] > 0, seen)


@pytest.mark.parametrize("datum", [DATUM, None], ids=["datum", "map frame"])
def test_bands_keep_their_names_values_and_gaps(tmp_path: Path, datum: Datum | None) -> None:
    height = RNG.normal(size=RASTER.shape).astype(np.float32)
    height[:20, :20] = np.nan
    count = RNG.integers(0, 9, RASTER.shape).astype(np.uint16)
    write_bands(tmp_path / "height.tif", {"height": height, "count": count}, RASTER, datum)
    with tifffile.TiffFile(tmp_path / "height.tif") as file:
        read = file.asarray()
        tags = {tag.code: tag.value for tag in file.pages[0].tags.values()}
    np.testing.assert_array_equal(read[0], height[::-1])
    np.testing.assert_array_equal(read[1], count[::-1])
    assert tags[42112].index(">height<") < tags[42112].index(">count<")
    assert tags[42113] == "nan"
    assert tags[33922][3:5] == pytest.approx((-2000.0, 1100.0))
    assert datum is not None or not re.search("metres|east|north", tags[34737])  # a mosaic without GPS has neither


def test_overviews_of_every_second_pixel_follow_the_whole_picture_down_to_one_tile(tmp_path: Path) -> None:
    raster = Raster(0.5, 0, 0, 1200, 300)
    image = RNG.integers(0, 255, (*raster.shape, 3)).astype(np.uint8)
    write_bands(tmp_path / "height.tif", {"height": image[..., 0], "count": image[..., 1]}, raster, DATUM)
    picture = write_picture(tmp_path / "picture", image, raster, DATUM, seen=np.ones(raster.shape, bool))
    for path in (picture, tmp_path / "height.tif"):
        with tifffile.TiffFile(path) as file:
            assert [page.is_reduced for page in file.pages] == [False, True, True, True]
            assert [(page.imagelength, page.imagewidth) for page in file.pages][1:] == [
                (150, 600),
                (75, 300),
                (38, 150),
            ]
            (series,) = file.series
            whole, second = (level.asarray() for level in series.levels[:2])
        np.testing.assert_array_equal(second, whole[:, ::2, ::2] if len(whole) == 2 else whole[::2, ::2])


def test_parts_make_the_same_file_as_the_whole(tmp_path: Path) -> None:
    raster = Raster(0.5, -300, 77, 1100, 700)
    whole = np.full((2, *raster.shape), np.nan, np.float32)
    whole[:, 100:460, 500:900] = RNG.normal(size=(2, 360, 400))
    asked = []

    def part(window: Raster) -> list[np.ndarray]:
        asked.append(window)
        return list(whole[:, *window.within(raster)])

    write_parts(tmp_path / "parts.tif", ["a", "b"], part, raster, DATUM)
    write_bands(tmp_path / "whole.tif", {"a": whole[0], "b": whole[1]}, raster, DATUM)
    assert (tmp_path / "parts.tif").read_bytes() == (tmp_path / "whole.tif").read_bytes()
    assert sum(window.rows * window.columns for window in asked) == raster.rows * raster.columns
    with tifffile.TiffFile(tmp_path / "parts.tif") as file:
        levels = [level.asarray() for level in file.series[0].levels]
    for step, level in enumerate(levels):
        np.testing.assert_array_equal(level, whole[:, ::-1][:, :: 2**step, :: 2**step])


def test_grey_pictures_have_one_band_and_opacity(tmp_path: Path) -> None:
    read = tifffile.imread(write_picture(tmp_path / "grey", IMAGE[..., 0], RASTER, DATUM, seen=IMAGE[..., 1] > 100))
    np.testing.assert_array_equal(read[::-1, :, 0], IMAGE[..., 0])
    np.testing.assert_array_equal(read[::-1, :, 1] > 0, IMAGE[..., 1] > 100)


def test_a_missing_folder_is_one_line(tmp_path: Path) -> None:
    for datum in (DATUM, None):
        with pytest.raises(UavVslamError, match="can't be written"):
            write_picture(tmp_path / "none" / "picture", IMAGE, RASTER, datum, seen=ALL)
