# SPDX-License-Identifier: Apache-2.0
"""What a folder holds is read from files, EXIF and the table beside them; what can't be used is named."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from uav_vslam.errors import PictureError
from uav_vslam.mapping.pictures.exif import clock_s, focal_px
from uav_vslam.mapping.pictures.features import detect_all
from uav_vslam.mapping.pictures.picture import Geodetic
from uav_vslam.mapping.pictures.reading import read_folder

TABLE = "file,lat_deg,lon_deg,alt_m,datetime\n"


def picture(
    path: Path, size: tuple[int, int] = (64, 48), *, seed: int = 0, tags: dict[int, object] | None = None
) -> None:
    noise = np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), np.uint8)
    image = Image.fromarray(noise)
    exif = image.getexif()
    for tag, value in (tags or {}).items():
        if isinstance(value, dict):
            exif.get_ifd(tag).update(value)
        else:
            exif[tag] = value
    image.save(path, exif=exif)


def test_exif_gives_focal_length_time_and_position(tmp_path: Path) -> None:
    north, west = (
        (IFDRational(30), IFDRational(10), IFDRational(36)),
        (IFDRational(98), IFDRational(5), IFDRational(24)),
    )
    gps = {1: "N", 2: north, 3: "W", 4: west, 5: b"\x00", 6: IFDRational(3470, 10)}
    details = {0xA405: 24, 0x9003: "2014:10:19 13:21:23"}
    picture(tmp_path / "a.jpg", tags={0x0110: "X1", 0x8769: details, 0x8825: gps})
    picture(tmp_path / "b.jpg", seed=1)
    first = next(each for each in read_folder(tmp_path).pictures if each.name == "a.jpg")
    assert first.focal_px == pytest.approx(24.0 / 43.2666 * 80.0)
    assert first.time_s == clock_s("2014:10:19 13:21:23")
    assert first.position is not None
    assert (first.position.latitude_deg, first.position.longitude_deg) == pytest.approx((30.17667, -98.09), abs=1e-5)
    assert first.position.height_m == pytest.approx(347.0)


def test_a_hemisphere_may_be_a_small_letter_or_fill_a_longer_field(tmp_path: Path) -> None:
    degrees = (IFDRational(30), IFDRational(0), IFDRational(0))
    for k, (south, west) in enumerate((("S", "W"), ("s", "w"), ("S\0\0", "W\0\0"), ("S ", "W "))):
        gps = {1: south, 2: degrees, 3: west, 4: degrees, 6: IFDRational(100)}
        picture(tmp_path / f"{k}.jpg", seed=k, tags={0x8825: gps})
    for each in read_folder(tmp_path).pictures:
        assert each.position == Geodetic(-30.0, -30.0, 100.0)


def test_gps_without_an_altitude_is_named_unless_the_table_has_one(tmp_path: Path) -> None:
    degrees = (IFDRational(30), IFDRational(10), IFDRational(36))
    for k, name in enumerate("abc"):
        gps = {1: "N", 2: degrees, 3: "W", 4: degrees} | ({6: IFDRational(3470, 10)} if name == "c" else {})
        picture(tmp_path / f"{name}.jpg", seed=k, tags={0x8825: gps})
    (tmp_path / "gps.csv").write_text(TABLE + "b.jpg,30.1,-98.1,350,\n")
    (warning,) = read_folder(tmp_path).warnings
    assert "without an altitude: a.jpg;" in warning


def test_the_focal_plane_gives_the_focal_length_of_a_shrunk_picture() -> None:
    tags = {0x920A: 8.8, 0xA20E: 4000 / 13.2 * 10.0, 0xA210: 3, 0xA002: 4000}
    assert focal_px(tags, (1000, 750)) == pytest.approx(8.8 * 1000 / 13.2)
    turned = tags | {0xA002: 3000, 0xA003: 4000}  # by a program that corrected the sizes
    assert focal_px(turned, (750, 1000)) == pytest.approx(8.8 * 1000 / 13.2)


def test_the_table_takes_precedence_and_gives_the_order(tmp_path: Path) -> None:
    for k, name in enumerate("ab"):
        picture(tmp_path / f"{name}.png", seed=k)
    rows = "a.png,30.1,-98.1,350,2014:10:19 13:21:25\nb.png,30.2,-98.2,351,2014:10:19 13:21:23\n"
    (tmp_path / "gps.csv").write_text(TABLE + rows)
    found = read_folder(tmp_path).pictures
    assert [each.name for each in found] == ["b.png", "a.png"]
    assert found[1].position is not None
    assert found[1].position.latitude_deg == 30.1


def test_latitude_and_longitude_zero_in_the_table_are_no_position(tmp_path: Path) -> None:
    """Five such rows of 20 were reported as positions that are wrong by 6 332 km."""
    for k, name in enumerate("ab"):
        picture(tmp_path / f"{name}.png", seed=k)
    (tmp_path / "gps.csv").write_text(TABLE + "a.png,30.1,-98.1,350,\nb.png,0.0,0.0,0.0,\n")
    assert [each.position is None for each in read_folder(tmp_path).pictures] == [False, True]


def test_copies_and_damaged_files_are_left_out_by_name(tmp_path: Path) -> None:
    for k, name in enumerate("ab"):
        picture(tmp_path / f"{name}.png", seed=k)
    shutil.copy(tmp_path / "a.png", tmp_path / "c.png")
    (tmp_path / "d.jpg").write_text("no picture")
    found = read_folder(tmp_path)
    assert [each.name for each in found.pictures] == ["a.png", "b.png"]
    assert any("c.png" in text for text in found.warnings)
    assert any("d.jpg" in text for text in found.warnings)


@pytest.mark.parametrize("name", ["c.JPG", "c.png", "c.tif"])
def test_a_picture_that_ends_early_is_left_out_by_name(tmp_path: Path, name: str) -> None:
    for k, whole in enumerate(("a.jpg", "b.TIFF")):
        picture(tmp_path / whole, seed=k)
    picture(tmp_path / name, (640, 480), seed=2)
    content = (tmp_path / name).read_bytes()
    assert len(read_folder(tmp_path).pictures) == 3
    (tmp_path / name).write_bytes(content[: len(content) // 2])
    found = read_folder(tmp_path)
    assert [each.name for each in found.pictures] == ["a.jpg", "b.TIFF"]
    assert any(name in text for text in found.warnings)


def test_pictures_of_a_kind_that_is_not_supported_are_left_out_by_name(tmp_path: Path) -> None:
    for k, name in enumerate("ab"):
        picture(tmp_path / f"{name}.png", seed=k)
    Image.fromarray(np.ones((48, 64), np.float32)).save(tmp_path / "c.tif")
    ticks: list[int] = []
    found = detect_all(read_folder(tmp_path).pictures, on_picture=lambda: ticks.append(1))
    assert [each.name for each in found.pictures] == ["a.png", "b.png"]
    assert len(found.features) == 2
    assert found.undecoded == ["c.tif"]
    assert len(ticks) == 3


def test_folders_below_are_named_but_not_taken(tmp_path: Path) -> None:
    (tmp_path / "100MEDIA").mkdir()
    (tmp_path / "other").mkdir()
    picture(tmp_path / "100MEDIA" / "x.jpg", seed=9)
    with pytest.raises(PictureError, match="folders 100MEDIA;"):
        read_folder(tmp_path)
    for k, name in enumerate("ab"):
        picture(tmp_path / f"{name}.png", seed=k)
    found = read_folder(tmp_path)
    assert len(found.pictures) == 2
    assert any("100MEDIA" in text for text in found.warnings)


def test_a_portrait_picture_is_turned_to_lie_like_the_others(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / f"{k}.png", seed=k)
    picture(tmp_path / "3.png", (48, 64), seed=3)
    found = read_folder(tmp_path).pictures
    assert [each.turned for each in found] == [False, False, False, True]
    assert {each.camera for each in found} == {"camera 64x48"}
    assert found[3].read().shape == (48, 64, 3)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("file,lat_deg,lon_deg\na.png,1,2\n", "alt_m"),
        (TABLE.replace(",", ";") + "a.png;30.1;20;350;\n", "first line is 'file;lat_deg"),
        (TABLE + "S\xfcd.png,30.1,20,350,\n", "not UTF-8"),
        (TABLE + '"a.png,30.1,20,350,\n' + "b.png,30.1,20,350,\n" * 10_000, "quotation mark"),
        (TABLE + "a.png,30.1,x,350,\n", "line 2"),
        (TABLE + "a.png,130.1,20,350,\n", "WGS 84"),
    ],
)
def test_a_malformed_table_is_an_error_that_says_where(tmp_path: Path, text: str, told: str) -> None:
    for k, name in enumerate("ab"):
        picture(tmp_path / f"{name}.png", seed=k)
    (tmp_path / "gps.csv").write_text(text, encoding="latin-1")
    with pytest.raises(PictureError, match=told):
        read_folder(tmp_path)


def test_a_folder_without_pictures_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(PictureError, match="0 different pictures"):
        read_folder(tmp_path)
    with pytest.raises(PictureError, match="not a folder"):
        read_folder(tmp_path / "missing")


FILM_MM = {
    "one lens": ([24.0, 24.0, 24.0], 1),
    "rounding": ([24.0, 24.01, 23.98], 1),
    "focus": ([100.0, 100.8, 101.7], 1),
    "two lenses": ([24.0, 240.0, 24.0], 2),
    "a zoom": ([24.0, 35.0, 70.0], 3),
}


@pytest.mark.parametrize("case", FILM_MM)
def test_a_camera_shares_a_lens_at_each_of_its_focal_lengths(case: str, tmp_path: Path) -> None:
    films, lenses = FILM_MM[case]
    for k, film_mm in enumerate(films):
        tags = {0x0110: "Z30", 0x8769: {0xA405: IFDRational(round(100 * film_mm), 100)}}
        picture(tmp_path / f"{k}.jpg", seed=k, tags=tags)
    found = read_folder(tmp_path).pictures
    assert len({each.camera for each in found}) == lenses
    assert all(each.camera.startswith("Z30 64x48") for each in found)
    assert len({each.camera for each in read_folder(tmp_path, focal_px=70.0).pictures}) == 1


def test_pictures_without_a_focal_length_share_the_only_one(tmp_path: Path) -> None:
    for k, film_mm in enumerate((24, None)):
        details = {} if film_mm is None else {0xA405: film_mm}
        picture(tmp_path / f"{k}.jpg", seed=k, tags={0x0110: "Z30", 0x8769: details})
    assert {each.camera for each in read_folder(tmp_path).pictures} == {"Z30 64x48"}


@pytest.mark.parametrize("mode", ["RGB", "L", "I;16"])
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_tiff_of_any_orientation_is_read_with_the_size_that_it_was_listed_with(
    orientation: int, mode: str, tmp_path: Path
) -> None:
    colours = {"RGB": ((40, 48, 3), np.uint8), "L": ((40, 48), np.uint8), "I;16": ((40, 48), np.uint16)}
    shape, kind = colours[mode]
    stored = np.zeros(shape, kind)
    stored[:20, :16] = np.array([250, 100, 10], kind) if mode == "RGB" else 250
    for k in range(2):
        stored[-1, -1] = k
        image = Image.fromarray(stored)
        exif = image.getexif()
        exif[0x0112] = orientation
        image.save(tmp_path / f"{k}.tif", exif=exif)
    upright = {1: stored, 3: np.rot90(stored, 2), 6: np.rot90(stored, -1), 8: np.rot90(stored)}[orientation]
    for each in read_folder(tmp_path).pictures:
        read = each.read()
        assert read.shape == (each.height, each.width, 3)
        expected = upright[..., ::-1] if mode == "RGB" else np.repeat(upright[..., None], 3, axis=2)
        np.testing.assert_array_equal(read > 50, expected > 50)
