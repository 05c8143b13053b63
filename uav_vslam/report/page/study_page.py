# SPDX-License-Identifier: Apache-2.0
"""A study as sections of a page: its tables, notes and pictures."""

from html import escape
from pathlib import Path
from typing import Any

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.output import STUDY
from uav_vslam.evaluation.study import Row, tables_of
from uav_vslam.report.page.flight import read_json
from uav_vslam.report.page.html import Cell, Markup, section, table, tag
from uav_vslam.report.page.pictures import drawing, figure

PICTURE_BYTES = 5_000_000  # of all pictures


def is_study(folder: Path) -> bool:
    """Return whether a folder holds the results of a study."""
    return (folder / STUDY).exists()


def study_sections(folder: Path) -> tuple[dict[str, Any], list[Markup]]:
    """Return the tree of study.json and the sections of its page.

    Raises:
        UavVslamError: the tree is damaged, or a picture is none.
    """
    tree = read_json(folder / STUDY)
    if missing := [key for key in ("study", "seeds", "git", "rows") if key not in tree]:
        raise UavVslamError(f"{folder / STUDY} lacks {', '.join(missing)}; run the study again")
    sections = [
        section(f"table-{k}", heading[:1].upper() + heading[1:] or "Results", _table(rows, heading or tree["study"]))
        for k, (heading, rows) in enumerate(tables_of(tree).items(), 1)
        if rows
    ]
    pictures = sorted(folder.glob("*.png"))
    if pictures:
        share = PICTURE_BYTES // len(pictures)
        shown = [figure(drawing(path, share), path.stem.replace("_", " ")) for path in pictures]
        sections.append(section("pictures", "Pictures", *shown))
    if tree.get("notes"):
        notes = [tag("div", tag("dt", subject), tag("dd", note)) for subject, note in tree["notes"].items()]
        sections.append(section("notes", "Notes", tag("dl", *notes)))
    return tree, sections


def _table(rows: list[Row], caption: str) -> Markup:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    return table(
        [Markup("_<wbr>".join(map(escape, column.split("_")))) for column in columns],
        [[_cell(row.get(column)) for column in columns] for row in rows],
        caption=caption,
    )


def _cell(value: Any) -> Cell:
    if value is None:
        return "–", "number"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value), "text"
    return (f"{value:.3g}" if abs(value) < 100 and isinstance(value, float) else f"{value:.0f}"), "number"
