# SPDX-License-Identifier: Apache-2.0
"""The page is one file that holds what the folders hold, and asks for nothing."""

import base64
import gzip
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_up_map import SUMMARY, write_map
from made_up_results import write_bare, write_full, write_long

from uav_vslam.errors import UavVslamError
from uav_vslam.report.page.configuration import differing, flat
from uav_vslam.report.page.map_folder import LARGEST_MODEL_BYTES
from uav_vslam.report.page.page import NAME, write_page

LARGEST_BYTES = 8_000_000


class Reader(HTMLParser):
    """Gathers the ids of sections, the words of cells, and every address."""

    def __init__(self) -> None:
        super().__init__()
        self.sections: list[str] = []
        self.addresses: list[str] = []
        self.unnamed: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if tag == "section":
            self.sections.append(str(found["id"]))
        if tag == "img" and not found.get("alt"):
            self.unnamed.append(tag)
        self.addresses += [str(value) for name, value in attrs if name in ("src", "href", "srcset", "action")]

    def handle_data(self, data: str) -> None:
        self.text += data


def read(page: Path) -> Reader:
    reader = Reader()
    reader.feed(page.read_text())
    return reader


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_full(tmp_path_factory.mktemp("full"))
    write_map(folder / "map")
    return folder


def test_the_page_has_a_section_for_all_that_the_folder_holds(full: Path) -> None:
    page = write_page([full])
    assert page == full / NAME
    assert page.stat().st_size < LARGEST_BYTES
    assert read(page).sections == [
        *("views", "scores", "quality", "errors", "nees", "innovations", "sigmas", "calibration", "points", "link"),
        *("timing", "drops", "map", "configuration"),
    ]


def test_sections_without_data_are_not_there(tmp_path: Path) -> None:
    assert read(write_page([write_bare(tmp_path)])).sections == ["views", "scores", "quality", "sigmas"]


def test_the_page_asks_for_nothing_and_names_its_pictures(full: Path) -> None:
    reader = read(write_page([full]))
    assert all(address.startswith(("data:", "#")) for address in reader.addresses)
    assert reader.unnamed == []
    assert "default-src 'none'" in (full / NAME).read_text()


def test_text_of_the_results_is_no_markup(full: Path) -> None:
    text = write_page([full]).read_text()
    assert "<b>a problem" not in text
    data = re.search(r'<script type="text/plain" id="data">(.*?)</script>', text)
    assert data is not None
    assert set(json.loads(gzip.decompress(base64.b64decode(data[1])))) == {"scene", "figures"}


def test_the_same_folder_gives_the_same_page(full: Path, tmp_path: Path) -> None:
    first, second = (write_page([full], tmp_path / name).read_bytes() for name in ("a.html", "b.html"))
    assert first == second


def test_scores_are_those_of_the_summary(full: Path) -> None:
    text = read(write_page([full])).text
    summary = json.loads((full / "summary.json").read_text())
    for vehicle in summary["vehicles"].values():
        for track in ("ins", "s_slam", "c_slam", "smoothed"):
            value = vehicle[track]["ate_m"]
            assert (f"{value:.3f}" if value < 10 else f"{value:.1f}") in text


def test_the_quality_of_the_map_is_that_of_map_json(full: Path, tmp_path: Path) -> None:
    text = read(write_page([full], tmp_path / NAME)).text
    for figure in ("CE90, horizontal, claimed", "0.210", "LE90, height, claimed", "0.330", "97.0", "1800", "52 %"):
        assert figure in text
    assert SUMMARY["accuracy"]["ce90_m"] == 0.21


def test_a_map_that_is_turned_is_not_called_north_up(full: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(full, tmp_path / "turned"))
    datum = {"latitude_deg": -28.2325, "longitude_deg": 153.0012, "height_m": 20.0}
    earlier = {key: value for key, value in SUMMARY.items() if key != "north_up"}
    turned = {"datum": datum | {"yaw_deg": 30.0}}
    for tree, up, said in (
        (SUMMARY | {"datum": datum}, True, "153.001200°"),
        (SUMMARY | turned | {"north_up": False}, False, "30° counter-clockwise"),
        (SUMMARY | {"frame": "uav1/map", "north_up": False}, False, "Frame: uav1/map."),  # of its own start
        (earlier | turned, False, "30° counter-clockwise"),
    ):
        (folder / "map" / "map.json").write_text(json.dumps(tree))
        text = write_page([folder]).read_text()
        assert f"Orthomosaic, {'north up' if up else 'x to the right, y up'}" in text
        assert said in text
        assert ("North to south" in text) == up


def test_a_map_may_lack_anything_but_its_summary(full: Path, tmp_path: Path) -> None:
    folder = tmp_path / "less"
    shutil.copytree(full, folder)
    for path in (folder / "map").iterdir():
        if path.name != "map.json":
            path.unlink()
    (folder / "map" / "map.json").write_text("{}")
    reader = read(write_page([folder]))
    assert "map" in reader.sections


def test_a_model_that_is_too_large_is_named_instead_of_shown(full: Path, tmp_path: Path) -> None:
    folder = tmp_path / "large"
    shutil.copytree(full, folder)
    (folder / "map" / "model.glb").write_bytes(bytes(LARGEST_MODEL_BYTES + 1))
    page = write_page([folder])
    assert "data-model" not in page.read_text().split("<script>")[0]
    assert "model.glb has 3.0 MB" in read(page).text


def test_several_flights_share_a_page_that_marks_their_differences(full: Path, tmp_path: Path) -> None:
    other = write_full(tmp_path)
    config = (other / "config.yaml").read_text()
    (other / "config.yaml").write_text(config.replace("window: 10", "window: 0"))
    page = write_page([full, other], tmp_path / "both.html")
    assert page.stat().st_size < LARGEST_BYTES
    table = page.read_text().split("Settings that differ")[2].split("</table>")[0]
    assert re.findall(r'class="key">([\w.]+)<', table) == ["backend.window", "backend.sigma_px"]


@pytest.mark.slow
def test_the_page_of_a_long_flight_with_a_large_map_stays_small(tmp_path: Path) -> None:
    folder = write_long(tmp_path)
    rng = np.random.default_rng(1)
    for name in ("map/orthomosaic.jpg", "map/height.png", "map/overlap.png", "uav1_tracks.png", "uav2_tracks.png"):
        noise = rng.integers(0, 255, (600, 900, 3), np.uint8)  # compresses worse than any picture
        (folder / "map").mkdir(exist_ok=True)
        assert cv2.imwrite(str(folder / name), noise)
    (folder / "map" / "map.json").write_text(json.dumps(SUMMARY))
    (folder / "map" / "model.glb").write_bytes(bytes(LARGEST_MODEL_BYTES))
    page = write_page([folder])
    assert "data-model" in page.read_text()
    assert LARGEST_BYTES / 2 < page.stat().st_size < LARGEST_BYTES


def test_settings_are_compared_by_their_full_names() -> None:
    a, b = flat({"x": {"y": 1, "z": 2}}), flat({"x": {"y": 1, "z": 3}, "w": 0})
    assert a == {"x.y": "1", "x.z": "2"}
    assert differing({"a": a, "b": b}) == ["x.z", "w"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("summary.json", "{", "is no JSON"),
        ("summary.json", "[1, 2]", "holds no figures"),
        ("summary.json", "{}", "lists no vehicles"),  # of another program
        ("summary.json", '{"vehicles": {"uav1": 3}}', "lists no vehicles"),
        ("summary.json", '{"vehicles": {"uav1": {}}}', "lacks 'pooled'"),
        ("config.yaml", "a: [", "is no"),
        ("config.yaml", "3", "is no"),
        ("uav1_frames.csv", "", "is empty"),  # the disk was full
        ("uav1_frames.csv", "stamp_ns,nis_per_dof\n1,1\n", "has no column band_low"),  # of another version
        ("uav1_landmarks.csv", "x_m\n1.5\n", "has no column id"),
    ],
)
def test_a_damaged_file_is_named(tmp_path: Path, name: str, text: str, message: str) -> None:
    folder = write_bare(tmp_path)
    (folder / name).write_text(text)
    with pytest.raises(UavVslamError, match=rf"{re.escape(name)} {message}"):
        write_page([folder])


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UavVslamError, match=r"holds no summary\.json; name the results of a flight"):
        write_page([tmp_path])
