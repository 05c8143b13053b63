# SPDX-License-Identifier: Apache-2.0
"""The page in a browser: ready, without complaint or request, drawn, and no wider than the screen."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
from browser import CHROMIUM, Browser, browser
from made_up_map import write_map
from made_up_results import write_bare, write_full

from uav_vslam.report.page.figures import figure_sections
from uav_vslam.report.page.flight import read_flight
from uav_vslam.report.page.page import write_page

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")]

LOCAL = ("file:", "blob:", "data:", "about:")
# What each view shows, as the number of colours in its canvas: an empty one has a single colour.
COLOURS = """
(async (selector) => {
  const canvas = document.querySelector(selector);
  canvas.scrollIntoView({behavior: 'instant'});
  const holder = canvas.parentElement;
  await new Promise((done) => setTimeout(done, 300));
  return holder.getBoundingClientRect().toJSON();
})(%r)
"""


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("browser")) as running:
        yield running


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_full(tmp_path_factory.mktemp("full"))
    write_map(folder / "map")
    return write_page([folder])


@pytest.fixture(scope="module")
def opened(chromium: Browser, page: Path) -> Browser:
    """The browser with the page as it is first seen; tests leave it as they found it, or scrolled."""
    chromium.open(page)
    return chromium


def check_opened(chromium: Browser) -> None:
    """Check what holds of every page once it is ready."""
    assert chromium.complaints == []
    assert chromium.evaluate("document.documentElement.dataset.errors") == "0"
    assert [address[:80] for address in chromium.requests if not address.startswith(LOCAL)] == []


def figures(page: Path) -> dict:
    """Return the data of the charts of a flight's page."""
    return figure_sections([read_flight(page.parent, "full")])[1]


def colours(chromium: Browser, selector: str, path: Path) -> int:
    """Return how many colours a part of the page has, seen on the screen."""
    box = chromium.evaluate(COLOURS % selector)
    image = cv2.imread(str(chromium.picture(path)))
    top, left = max(int(box["top"]), 0), int(box["left"])
    part = image[top : int(box["bottom"]), left : int(box["right"])]
    return len({tuple(pixel) for pixel in part.reshape(-1, 3)})


def test_the_model_of_the_map_is_drawn_once_it_is_near(opened: Browser, tmp_path: Path) -> None:
    assert opened.evaluate("document.querySelector('.model canvas')") is None
    opened.evaluate("document.querySelector('.model').scrollIntoView({behavior: 'instant'})")
    ready = "new Promise((done) => { const look = () => document.querySelector('.model').dataset.ready ? done(1) : "
    opened.evaluate(ready + "setTimeout(look, 50); look(); })")
    assert colours(opened, ".model canvas", tmp_path / "seen.png") > 500
    check_opened(opened)


def test_time_moves_the_vehicles(opened: Browser) -> None:
    picture = "document.querySelector('.plan canvas').toDataURL()"
    at_end = opened.evaluate(picture)
    moved = "const s = document.querySelector('.clock input'); s.value = '2'; s.dispatchEvent(new Event('input'))"
    opened.evaluate(moved)
    opened.evaluate("new Promise((done) => setTimeout(done, 200))")
    assert opened.evaluate("document.querySelector('.clock output').textContent") == "2.0 s"
    assert opened.evaluate(picture) != at_end


def test_a_hidden_track_is_not_drawn(opened: Browser) -> None:
    picture = "document.querySelector('.plan canvas').toDataURL()"
    before = opened.evaluate(picture)
    box = "[...document.querySelectorAll('.layers label')].find((l) => l.textContent === 'Landmarks').firstChild"
    opened.evaluate(f"{box}.click()")
    assert opened.evaluate(picture) != before
    opened.evaluate(f"{box}.click()")
    assert opened.evaluate(picture) == before


def test_pointing_at_the_plan_view_reads_it(opened: Browser) -> None:
    opened.evaluate("document.querySelector('.plan').scrollIntoView({behavior: 'instant'})")
    box = opened.evaluate("document.querySelector('.plan canvas').getBoundingClientRect().toJSON()")
    for x in range(int(box["left"]) + 60, int(box["right"]), 8):  # along the middle, where a landmark or track lies
        point = {"x": x, "y": (box["top"] + box["bottom"]) / 2}
        opened.call("Input.dispatchMouseEvent", type="mouseMoved", **point)
        text = opened.evaluate("document.querySelector('.plan .note').textContent")
        if text:
            break
    assert "east" in text
    assert " m" in text


def point_at(chromium: Browser, figure: str, shares: list[float], *, drag: bool = False) -> None:
    """Point at shares of the width of a figure's first chart, one after another."""
    chromium.evaluate(f"document.querySelector('{figure}').scrollIntoView({{behavior: 'instant'}})")
    box = chromium.evaluate(f"document.querySelector('{figure} .u-over').getBoundingClientRect().toJSON()")
    places = [{"x": box["left"] + share * box["width"], "y": (box["top"] + box["bottom"]) / 2} for share in shares]
    held = {"button": "left", "clickCount": 1}
    for k, place in enumerate(places):
        chromium.call("Input.dispatchMouseEvent", type="mouseMoved", **place, **(held if drag and k else {}))
        if drag and k == 0:
            chromium.call("Input.dispatchMouseEvent", type="mousePressed", **place, **held)
    if drag:
        chromium.call("Input.dispatchMouseEvent", type="mouseReleased", **places[-1], **held)
    chromium.evaluate("new Promise((done) => setTimeout(done, 200))")


def shown_time(chromium: Browser, figure: str) -> float:
    return float(chromium.evaluate(f"document.querySelector('{figure} .u-legend .u-value').textContent"))


def test_what_can_be_operated_or_stands_for_a_picture_has_a_role_and_a_name(opened: Browser) -> None:
    bare = """[...document.querySelectorAll('[role=img], [tabindex], img, button, input')].filter((one) => {
      const role = one.getAttribute('role') ?? (/^(IMG|BUTTON|INPUT|PRE)$/.test(one.tagName) ? 'its own' : '');
      const name = one.getAttribute('aria-label') || one.alt || one.textContent.trim() || one.labels?.length;
      return !role || !name;
    }).map((one) => one.outerHTML.slice(0, 120))"""
    assert opened.evaluate(bare) == []


def marks(chromium: Browser) -> dict[str, str]:
    """Return what stands beside each thing that can be hidden: the dashes of its line, or a dot."""
    return chromium.evaluate("""Object.fromEntries([...document.querySelectorAll('.layers label')].map((label) => [
      label.textContent,
      label.querySelector('circle') ? 'dot' : label.querySelector('path')?.getAttribute('stroke-dasharray') ?? ''
    ]))""")


def test_a_vehicle_has_the_mark_of_its_landmarks_and_a_track_that_of_its_line(opened: Browser) -> None:
    found = marks(opened)
    assert (found["uav1"], found["uav2"], found["INS"], found["S-SLAM"]) == ("dot", "dot", "6,4", "")


def test_a_click_on_a_title_sorts_the_table(opened: Browser) -> None:
    column = "[...document.querySelectorAll('#scores tbody')][0].querySelectorAll('tr td:nth-child(3)')"
    click = "document.querySelectorAll('#scores thead button')[2].click()"
    read = f"[...{column}].map((cell) => parseFloat(cell.textContent))"
    opened.evaluate(click)
    rising = opened.evaluate(read)
    assert rising == sorted(rising)
    opened.evaluate(click)
    assert opened.evaluate(read) == rising[::-1]


def test_a_picture_that_can_be_moved_is_seen_as_a_whole_at_first(opened: Browser) -> None:
    opened.resize(1280, 400)  # where it is higher than the screen
    box = "document.querySelector('.pan')"
    shown, whole = (opened.evaluate(f"{box}{part}.clientHeight") for part in ("", ".querySelector('img')"))
    opened.resize(1280, 900)
    assert 0 < whole <= shown <= 0.8 * 400


def test_all_charts_share_the_time_whole_and_zoomed_and_nothing_moves(chromium: Browser, page: Path) -> None:
    """The frames last 9.9 s, the fusion epochs 9 s."""
    chromium.open(page)
    height = chromium.evaluate("document.documentElement.scrollHeight")
    point_at(chromium, "#link", [0.4, 0.99])
    assert shown_time(chromium, "#errors") == pytest.approx(0.99 * 9.9, abs=0.1)
    assert chromium.evaluate("document.documentElement.scrollHeight") == height
    point_at(chromium, "#errors", [0.0, 0.3, 0.6, 0.94], drag=True)
    point_at(chromium, "#link", [0.4, 0.99])
    assert shown_time(chromium, "#errors") == pytest.approx(0.99 * 0.94 * 9.9, abs=0.1)


def test_gaps_lone_values_single_poses_and_huge_numbers_are_drawn(chromium: Browser, tmp_path: Path) -> None:
    """NIS of every other frame only, so that no line is drawn, and huge; a track of a single pose."""
    folder = write_full(tmp_path)
    head, *rows = (folder / "uav1_frames.csv").read_text().splitlines()
    nis = head.split(",").index("nis_per_dof")
    cells = [row.split(",") for row in rows]
    for k, row in enumerate(cells):
        row[nis] = ("1e12", "", "1e3", "")[k % 4]
    (folder / "uav1_frames.csv").write_text("\n".join([head, *(",".join(row) for row in cells)]) + "\n")
    for path in folder.glob("uav2_*_slam.*"):
        path.write_text("\n".join(path.read_text().splitlines()[: 2 if path.suffix == ".csv" else 1]) + "\n")
    chromium.open(write_page([folder]))
    check_opened(chromium)
    box = chromium.evaluate(COLOURS % "#innovations .u-over")
    image = cv2.imread(str(chromium.picture(tmp_path / "seen.png")))
    part = image[int(box["top"]) : int(box["bottom"]), int(box["left"]) : int(box["right"])]
    dark = (part.max(axis=2) < 60).sum()  # pixels of S-SLAM's points
    assert 100 < dark < 1000  # 50 points, and no line between them
    point_at(chromium, "#errors .cells > :last-child", [0.5])
    assert shown_time(chromium, "#errors") == pytest.approx(0.5 * 9.9, abs=0.1)


@pytest.mark.parametrize(("width", "scheme"), [(1280, "dark"), (390, "light")])
def test_the_page_of_a_flight_opens(chromium: Browser, page: Path, tmp_path: Path, width: int, scheme: str) -> None:
    chromium.open(page, width=width, scheme=scheme)
    check_opened(chromium)
    assert chromium.evaluate("document.documentElement.scrollWidth") == width
    assert chromium.evaluate("document.documentElement.dataset.scheme") == scheme
    for selector in (".plan canvas", ".space canvas", "#errors canvas"):
        assert colours(chromium, selector, tmp_path / "seen.png") > 20, selector
    charts = sum(len(cell["charts"]) for figure in figures(page).values() for cell in figure["cells"])
    assert chromium.evaluate("document.querySelectorAll('[data-figure] canvas').length") == charts
    assert chromium.complaints == []


def test_tracks_of_several_flights_differ_in_their_dashes(chromium: Browser, page: Path, tmp_path: Path) -> None:
    chromium.open(write_page([page.parent, write_bare(tmp_path)], tmp_path / "page.html"))
    kinds = ("INS", "S-SLAM", "Smoothed", "C-SLAM")  # their colour is that of the flight
    assert len({marks(chromium)[kind] for kind in kinds}) == len(kinds)


def test_pages_of_two_flights_and_of_a_bare_one_open(chromium: Browser, page: Path, tmp_path: Path) -> None:
    bare = write_bare(tmp_path)
    for folders in ([page.parent, bare], [bare]):
        chromium.open(write_page(folders, tmp_path / "page.html"))
        check_opened(chromium)
        box = "[...document.querySelectorAll('.layers label')].find((l) => l.textContent === 'S-SLAM').firstChild"
        assert chromium.evaluate(f"{box}.checked")  # of a vehicle without peers nothing else is there
