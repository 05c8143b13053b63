# SPDX-License-Identifier: Apache-2.0
"""A comparison of methods over seeds: as data, and as a Markdown table."""

import math
from typing import Any

Row = dict[str, Any]


def study_tree(name: str, rows: list[Row], seeds: list[int], *, git: str | None) -> dict[str, Any]:
    """Return the content of `study.json`; figures that are not finite become null."""
    cleaned = [{key: _plain(value) for key, value in row.items()} for row in rows]
    return {"study": name, "seeds": [int(seed) for seed in seeds], "git": git, "rows": cleaned}


def study_markdown(tree: dict[str, Any]) -> str:
    """Return the study as a Markdown page: one table with a column per key that any row has."""
    columns = list(dict.fromkeys(key for row in tree["rows"] for key in row))
    lines = [f"# {tree['study']}", "", f"Code {tree['git'] or 'of unknown revision'}, {_seeds(tree['seeds'])}.", ""]
    if columns:
        lines += [_line(columns), _line(["---"] * len(columns))]
        lines += [_line([_cell(row.get(column)) for column in columns]) for row in tree["rows"]]
    return "\n".join(lines) + "\n"


def _seeds(seeds: list[int]) -> str:
    return f"{len(seeds)} seed{'s' if len(seeds) != 1 else ''}: {', '.join(map(str, seeds))}" if seeds else "no seeds"


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
    return str(value).replace("|", "\\|")


def _plain(value: Any) -> Any:
    """Return a numpy scalar as a Python number, and None for what JSON can't say."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value
