# SPDX-License-Identifier: Apache-2.0
"""Puts the page together: one HTML file with its data, style and scripts, which asks for nothing else."""

import base64
import gzip
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.files.results_folder import distinct_names, short_name
from uav_vslam.evaluation.files.whole import whole
from uav_vslam.evaluation.study import seeds_text
from uav_vslam.report.page.configuration import configuration_section
from uav_vslam.report.page.figures import figure_sections
from uav_vslam.report.page.flight import FlightFiles, read_flight
from uav_vslam.report.page.html import Markup, joined, section, tag
from uav_vslam.report.page.map_folder import map_sections
from uav_vslam.report.page.mosaic_page import is_mosaic, mosaic_sections
from uav_vslam.report.page.pictures import figure, photograph
from uav_vslam.report.page.scene import scene_data
from uav_vslam.report.page.score_tables import drop_section, quality_section, score_section
from uav_vslam.report.page.study_page import is_study, study_sections
from uav_vslam.report.style import LINE_COLOURS, STYLES

NAME = "report.html"
SHEET_BYTES = 450_000  # of the pictures of tracks, all together
MAP_BYTES = 900_000  # of the pictures of maps
VIEWS = """\
<div data-scene class="scene">
  <div class="layers" role="group" aria-label="What the views show"></div>
  <div class="views">
    <figure><div class="plan" tabindex="0"></div><figcaption>Plan view, axes in metres. Drag to move, wheel
    or + and - to zoom, 0 to fit; point at a track or landmark to read it.</figcaption></figure>
    <figure><div class="space"></div><figcaption>3-D view. Drag to turn, wheel to zoom, right button or two fingers to
    move.</figcaption></figure>
  </div>
</div>"""
CLOCK = """\
<div class="clock" data-clock role="group" aria-label="Time of the flight">
  <button type="button" aria-label="Play">▶</button>
  <input type="range" min="0" max="1" step="0.01" value="0" aria-label="Time [s]">
  <output>0.0 s</output>
</div>"""


def write_page(folders: Sequence[Path], output: Path | None = None) -> Path:
    """Write the page of one or several flights, of a study, or of a mosaic.

    Args:
        folders: of results, at least one.
        output: the file; by default report.html in the first folder.

    Returns:
        The file.

    Raises:
        UavVslamError: a folder holds none of these, or a study or mosaic is among several folders.
    """
    kinds = ((is_study, "study", _study_page), (is_mosaic, "mosaic", _mosaic_page))
    alone = [(folder, name, page_of) for folder in folders for is_kind, name, page_of in kinds if is_kind(folder)]
    if alone and len(folders) > 1:
        folder, name, _ = alone[0]
        raise UavVslamError(f"{folder} is a {name}, which has a page of its own; give flights only, or it alone")
    content = alone[0][2](folders[0]) if alone else _flight_page(folders)
    path = output or folders[0] / NAME
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path) as partial:
        partial.write_text(content, encoding="utf-8")
    return path


def _flight_page(folders: Sequence[Path]) -> str:
    flights = [read_flight(folder, label) for folder, label in zip(folders, distinct_names(folders), strict=True)]
    figures, data = figure_sections(flights)
    sections = [
        section("views", "Trajectories and landmarks", Markup(VIEWS), short="Views"),
        score_section(flights),
        quality_section(flights),
        *figures,
        drop_section(flights),
        *map_sections(flights, MAP_BYTES),
        _sheets(flights),
        configuration_section(flights),
    ]
    facts = [_facts(flight, several=len(flights) > 1) for flight in flights]
    title = " and ".join(flight.label for flight in flights)
    tree = {"scene": scene_data(flights), "figures": data}
    return _page(title, facts, [found for found in sections if found], tree, below=Markup(CLOCK))


def _study_page(folder: Path) -> str:
    tree, sections = study_sections(folder)
    facts = f"code {tree['git'] or 'of unknown revision'}; {seeds_text(tree['seeds'])}"
    return _page(tree["study"].replace("_", " "), [facts], sections, {})


def _mosaic_page(folder: Path) -> str:
    tree, sections = mosaic_sections(folder)
    facts = f"{tree['used']} of {tree['pictures']} pictures, {tree['width']}x{tree['height']} px"
    return _page(short_name(folder), [facts], sections, {})


def _facts(flight: FlightFiles, *, several: bool) -> str:
    summary = flight.summary
    parts = [
        f"{summary['duration_s']:.1f} s of flight",
        f"{len(flight.vehicles)} vehicle{'s' if len(flight.vehicles) != 1 else ''}",
        f"mode {summary['mode']}",
        None if summary["seed"] is None else f"seed {summary['seed']}",
        None if summary["realtime_factor"] is None else f"{summary['realtime_factor']:.2f} x real time",
        f"code {summary['git']}" if summary["git"] else None,
        flight.folder.resolve().name,
    ]
    text = ", ".join(part for part in parts if part)
    return f"{flight.label}: {text}" if several else text


def _sheets(flights: Sequence[FlightFiles]) -> Markup | None:
    """Return the contact sheets of the feature tracks; None without any."""
    paths = {
        path: f"{flight.label}: {name}" if len(flights) > 1 else name
        for flight in flights
        for name in flight.vehicles
        if (path := flight.folder / f"{name}_tracks.png").exists()
    }
    if not paths:
        return None
    pictures = [
        figure(photograph(path, SHEET_BYTES // len(paths)), f"Feature tracks of {title}")
        for path, title in paths.items()
    ]
    text = (
        "Left images through the flight. Filled: associated with the map; circles: other features; lines: past frames."
    )
    return section("tracks", "Pictures of the tracks", *pictures, text=text, short="Pictures")


def _page(
    title: str, facts: Sequence[str], sections: Sequence[Markup], data: dict[str, Any], *, below: Markup | None = None
) -> str:
    head = tag("header", tag("h1", title), *(tag("p", text) for text in facts))
    template = Template(_asset("page.html"))
    return template.substitute(
        title=tag("title", f"{title} – uav_vslam"),
        style=_palette() + _asset("style.css"),
        head=head,
        body=joined(sections),
        below=below or "",
        data=_packed(data),
        licence=_asset("viewer.licenses.txt").replace("--", "- -"),
        script=_asset("viewer.js"),
    )


def _packed(data: dict[str, Any]) -> str:
    """Return data as compressed JSON in base64: the numbers of a long flight are a third of their text."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).encode()
    return base64.b64encode(gzip.compress(text, mtime=0)).decode("ascii")


def _palette() -> str:
    """Return the colours of the project's plots as properties that the style and the scripts use."""
    tracks = [f"--track-{name}:{style.colour}" for name, style in STYLES.items()]
    lines = [f"--line-{k}:{colour}" for k, colour in enumerate(LINE_COLOURS)]
    return f":root{{{';'.join([*tracks, *lines])}}}\n"


def _asset(name: str) -> str:
    return resources.files("uav_vslam.report.page").joinpath("assets", name).read_text(encoding="utf-8")
