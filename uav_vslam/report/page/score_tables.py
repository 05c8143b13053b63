# SPDX-License-Identifier: Apache-2.0
"""Scores, quality and drops of flights as tables of the page."""

from collections.abc import Sequence

from uav_vslam.evaluation.quality import CONSERVATIVE, CONSISTENT, OVER_CONFIDENT
from uav_vslam.evaluation.summary import TRACK_NAMES
from uav_vslam.report.layout import RELATIVE_TITLES, figure_text
from uav_vslam.report.page.flight import Figures, FlightFiles
from uav_vslam.report.page.html import Cell, Markup, section, table, tag
from uav_vslam.report.quality_lines import quality_lines
from uav_vslam.report.table import CLAIMS, figures_of, is_scored, link_line, score_titles

VERDICTS = {OVER_CONFIDENT: "bad", CONSERVATIVE: "fair", CONSISTENT: "good"}


def score_section(flights: Sequence[FlightFiles]) -> Markup:
    """Return the tables that the command prints, of all flights."""
    scored = [flight for flight in flights if is_scored(flight.summary)]
    tables = []
    for alignment in dict.fromkeys(flight.summary["alignment"] for flight in scored):
        found = [flight for flight in scored if flight.summary["alignment"] == alignment]
        tables.append(_table(found, score_titles(alignment), "Errors against the truth", several=len(flights) > 1))
        tables.append(_table(found, RELATIVE_TITLES, "Relative errors over 14 m and 100 m", several=len(flights) > 1))
    blind = [flight for flight in flights if flight not in scored]
    if blind:
        tables.append(_table(blind, CLAIMS, "Claims of the estimates (no truth)", several=len(flights) > 1))
    text = "ATE and end error are root mean squares [m]; NEES of 1 is consistent. A click on a title sorts."
    return section("scores", "Scores", *tables, text=text)


def quality_section(flights: Sequence[FlightFiles]) -> Markup:
    """Return what the command says of each vehicle's link and quality."""
    cards = [
        tag(
            "div",
            tag("h3", f"{flight.label}: {name}" if len(flights) > 1 else name),
            tag("p", link_line(name, figures, flight.summary["mode"]).removeprefix(f"{name}: ")),
            *(_line(text, figures) for text in quality_lines(figures)),
            class_="card",
        )
        for flight in flights
        for name, figures in flight.summary["vehicles"].items()
    ]
    return section("quality", "Quality", tag("div", *cards, class_="cells"), text="Judged without ground truth.")


def drop_section(flights: Sequence[FlightFiles]) -> Markup | None:
    """Return what was dropped and reported, by reason; None if nothing was."""
    rows = [
        [*([flight.label] if len(flights) > 1 else []), name, what, reason, str(count)]
        for flight in flights
        for name, figures in flight.summary["vehicles"].items()
        for what, counts in _losses(figures).items()
        for reason, count in counts.items()
    ]
    if not rows:
        return None
    titles = [*(["Run"] if len(flights) > 1 else []), "Vehicle", "What", "Reason", "Count"]
    return section("drops", "Drops and alarms", table(titles, rows, caption="By reason"))


def _losses(figures: Figures) -> dict[str, dict[str, int]]:
    quality = figures["quality"] or {}
    return {
        "packet": figures["link"]["dropped"],
        "frame": quality.get("dropped") or {},
        "alarm": quality.get("alarms") or {},
    }


def _line(text: str, figures: Figures) -> Markup:
    verdict = (figures["quality"] or {}).get("nis_verdict")
    kind = VERDICTS.get(str(verdict), "") if text.startswith("innovations") else ""
    return tag("p", text, class_=kind or None)


def _table(flights: Sequence[FlightFiles], columns: dict[str, str], caption: str, *, several: bool) -> Markup:
    heads = [*(["Run"] if several else []), "Vehicle", "Estimate", *(title.replace("\n", " ") for title in columns)]
    rows: list[list[Cell]] = []
    for flight in flights:
        for name, tracks in figures_of(flight.summary).items():
            for track, figures in tracks.items():
                cells: list[Cell] = [(figure_text(figures.get(key)), "number") for key in columns.values()]
                rows.append([*([flight.label] if several else []), name, TRACK_NAMES[track], *cells])
    return table(heads, rows, caption=caption)
