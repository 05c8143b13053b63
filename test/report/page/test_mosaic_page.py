# SPDX-License-Identifier: Apache-2.0
"""The page of a mosaic: its picture, quality, warnings, and what became of each picture."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from uav_vslam.errors import UavVslamError
from uav_vslam.report.mosaic_table import rows
from uav_vslam.report.page.page import write_page

FIGURES = {
    "pictures": 3,
    "used": 2,
    "left_out": ["<lost>.jpg"],
    "pairs": 1,
    "points": 472,
    "reprojection_px": {"rms": 0.17, "median": 0.1},
    "gsd_m": 0.174,
    "height_m": 99.9,
    "scale": "none",
    "cameras": {"X1 800x600": {"focal_px": 573.2, "focal_sigma_px": 8.3}},
    "overlap": {"area_m2": 21308.0, "mean_views": 1.4, "share_twice": 0.4},
    "m_per_px": 0.18,
    "width": 60,
    "height": 40,
    "seam": {"places": 9, "median_px": 0.14, "p90_px": 0.29, "median_step": 0.007, "p90_step": 0.009},
    "warnings": ["left out, copies of other files: <c>.jpg"],
}


def write_mosaic(folder: Path, **changes: object) -> Path:
    """Write a mosaic's results, but for its map."""
    folder.mkdir()
    (folder / "mosaic.json").write_text(json.dumps(FIGURES | changes))
    axes = "x_m,y_m,z_m" if "scale" in changes else "x_units,y_units,z_units"
    (folder / "poses.csv").write_text(
        f"picture,{axes},qw,qx,qy,qz,points,reprojection_px\na.jpg,1.5,2.0,99.0,0,1,0,0,472,0.21\n"
    )
    return folder


@pytest.fixture
def mosaic(tmp_path: Path) -> Path:
    folder = write_mosaic(tmp_path / "2026-01-31_150000_field_mosaic")
    (folder / "map").mkdir()
    image = Image.fromarray(np.full((40, 60, 3), 90, np.uint8))
    image.save(folder / "map" / "orthomosaic.jpg")
    image.save(folder / "map" / "overlap.png")
    image.save(folder / "map" / "height.png")
    return folder


@pytest.mark.slow
def test_the_page_shows_picture_quality_and_what_was_left_out(mosaic: Path) -> None:
    page = write_page([mosaic])
    content = page.read_text(encoding="utf-8")
    assert page == mosaic / "report.html"
    assert content.count("data:image/jpeg;base64,") == 3
    assert "<h1>field_mosaic</h1>" in content
    assert "2 of 3 pictures, 60x40 px" in content
    for told in ("0.14 px (0.29 px)", "573.2 ± 8.3 px", "0.1740 units", "scale is arbitrary", "<td>a.jpg</td>"):
        assert told in content, told
    assert "x [units]" in content
    assert "copies of other files: &lt;c&gt;.jpg" in content
    assert "<td>&lt;lost&gt;.jpg</td><td>left out</td>" in content


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"scale": "gps", "gps": {"median_m": 1.0}}, "North up."),
        ({"scale": "height", "gps": {"median_m": 1.0}}, "North up."),
        ({"scale": "height"}, "the direction of north is not known"),
    ],
)
def test_north_is_up_wherever_there_is_gps(changes: dict[str, object], said: str, tmp_path: Path) -> None:
    assert said in write_page([write_mosaic(tmp_path / "field", **changes)]).read_text(encoding="utf-8")


def test_a_missing_picture_is_told(tmp_path: Path) -> None:
    content = write_page([write_mosaic(tmp_path / "bare")]).read_text(encoding="utf-8")
    assert "map/orthomosaic.jpg is missing" in content


def test_figures_that_are_missing_or_damaged_are_an_error_that_says_where(mosaic: Path) -> None:
    (mosaic / "mosaic.json").write_text(json.dumps({name: FIGURES[name] for name in FIGURES if name != "seam"}))
    with pytest.raises(UavVslamError, match=r"mosaic\.json lacks 'seam'"):
        write_page([mosaic])
    (mosaic / "mosaic.json").write_text(json.dumps(FIGURES))
    (mosaic / "poses.csv").write_text("nothing,here\n1,2\n")
    with pytest.raises(UavVslamError, match=r"poses\.csv can't be read"):
        write_page([mosaic])


def test_a_mosaic_has_a_page_of_its_own(mosaic: Path, tmp_path: Path) -> None:
    with pytest.raises(UavVslamError, match="is a mosaic, which has a page of its own"):
        write_page([tmp_path, mosaic])


def test_the_distance_to_gps_stands_below_all_cameras() -> None:
    camera = {"focal_px": 573.2, "focal_sigma_px": 8.3}
    names = [name for name, _ in rows(FIGURES | {"cameras": {"A": camera, "B": camera}, "gps": {"median_m": 1.4}})]
    at = names.index("Focal length of A")
    assert names[at + 1 : at + 4] == ["Focal length of B", "Height above ground, median", "Distance to GPS, median"]
