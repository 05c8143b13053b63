# SPDX-License-Identifier: Apache-2.0
"""A comparison of methods over seeds: as data, and as Markdown tables."""

from collections.abc import Mapping
from typing import Any

from uav_vslam.evaluation.plain import plain
from uav_vslam.evaluation.revision import git_revision

Row = dict[str, Any]

TABLE = "table"  # a row's key that holds its table's heading
LABELS = ("method", "condition")  # columns that are repeated where a table is divided
WIDTH = 120  # of a page: wider tables are divided


def study_tree(
    name: str,
    rows: list[Row],
    seeds: list[int],
    *,
    notes: Mapping[str, str] | None = None,
    series: list[Row] | None = None,
) -> dict[str, Any]:
    """Return the content of `study.json`; non-finite numbers become null.

    Args:
        name: of the study.
        rows: one dict per method and condition: {"method", "condition", "end_rms_m", "ate_rms_m", ...}; those with
            different values of "table" go into different tables.
        seeds: of the runs behind each row.
        notes: explanation of the columns, by subject.
        series: curves, one dict each, with lists of equal length; for plots only.
    """
    tree = {"study": name, "seeds": [int(seed) for seed in seeds], "git": git_revision(), "rows": plain(rows)}
    if notes:
        tree["notes"] = dict(notes)
    if series:
        tree["series"] = plain(series)
    return tree


def tables_of(tree: dict[str, Any]) -> dict[str, list[Row]]:
    """Return the rows by their heading, in order; rows without one get the empty heading."""
    tables: dict[str, list[Row]] = {}
    for row in tree["rows"]:
        tables.setdefault(row.get(TABLE, ""), []).append({key: row[key] for key in row if key != TABLE})
    return tables


def study_markdown(tree: dict[str, Any]) -> str:
    """Return the study as a Markdown page: tables with a column per key that any of their rows has.

    Columns are padded, and tables wider than the page are divided, so that they are read easily as plain text too.
    """
    lines = [f"# {tree['study']}", "", f"Code {tree['git'] or 'of unknown revision'}, {seeds_text(tree['seeds'])}.", ""]
    for heading, rows in tables_of(tree).items():
        lines += [f"## {heading}", ""] if heading else []
        lines += _table(rows)
    for subject, note in tree.get("notes", {}).items():
        lines += [f"**{subject}**: {note}", ""]
    return "\n".join(lines).rstrip("\n") + "\n"


def seeds_text(seeds: list[int]) -> str:
    """Return how many seeds there are, and which."""
    return f"{len(seeds)} seed{'s' if len(seeds) != 1 else ''}: {', '.join(map(str, seeds))}" if seeds else "no seeds"


def _table(rows: list[Row]) -> list[str]:
    """Return the lines of a table, or of several with the same labels, each followed by an empty line."""
    names = dict.fromkeys(key for row in rows for key in row)
    columns = {name: [name, *(_cell(row.get(name)) for row in rows)] for name in names}
    padded = {name: _padded(cells) for name, cells in columns.items()}
    lines = []
    for block in _blocks({name: len(cells[0]) for name, cells in padded.items()}):
        head, *body = zip(*(padded[name] for name in block), strict=True)
        rule = ["-" * len(cell) for cell in head]
        lines += [_line(list(head)), _line(rule), *(_line(list(cells)) for cells in body), ""]
    return lines


def _blocks(widths: dict[str, int]) -> list[list[str]]:
    """Return which columns of these widths go into one table: the labels and as many others as fit, one at least."""
    labels = [name for name in widths if name in LABELS]
    room = WIDTH - 1 - sum(widths[name] + 3 for name in labels)
    blocks, left = [list(labels)], room
    for name in widths:
        if name in LABELS:
            continue
        if widths[name] + 3 > left and len(blocks[-1]) > len(labels):
            blocks.append(list(labels))
            left = room
        blocks[-1].append(name)
        left -= widths[name] + 3
    return blocks


def _padded(cells: list[str]) -> list[str]:
    width = max(3, *map(len, cells))
    return [cell.ljust(width) for cell in cells]


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
    return str(value).replace("|", "\\|")
