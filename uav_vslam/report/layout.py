# SPDX-License-Identifier: Apache-2.0
"""What the tables of flights and of comparisons share: width, columns, titles of the scores, numbers as text."""

from collections.abc import Iterable
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from uav_vslam.evaluation.scores import DIRECTIONS, RELATIVE_LENGTHS_M, relative_key

WIDTH = 120  # where the output is no terminal
ABSENT = "–"
ALIGNMENT_TITLES = {
    "none": "unaligned",
    "start-yaw": "start yaw",
    "start-pose": "start pose",
    "yaw": "yaw+pos",
    "se3": "SE3",
}
NEES_TITLES = {"NEES\nposition": "nees_position", "NEES\nattitude": "nees_rotation"}
DIRECTION_TITLES = {
    "along_m": "along\n[m]",
    "across_m": "across\n[m]",
    "height_m": "height\n[m]",
    "attitude_mrad": "attitude\n[mrad]",
}
RELATIVE_TITLES = {
    f"{length_m:g} m\n{DIRECTION_TITLES[what]}": relative_key(length_m, what)
    for length_m in RELATIVE_LENGTHS_M
    for what in DIRECTIONS
}


def ate_title(alignment: str) -> str:
    """Return the heading of an ATE's column, which names what was aligned."""
    return f"ATE [m]\n{ALIGNMENT_TITLES[alignment]}"


def wide(console: Console | None) -> Console:
    """Return a console that is wide enough for the tables, unless it is a terminal."""
    console = console or Console()
    return console if console.is_terminal else Console(file=console.file, width=WIDTH)


def new_table(labels: Iterable[str], titles: Iterable[str]) -> Table:
    """Return a table without rows: columns of labels, which are folded where they are too long, and of figures."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1), collapse_padding=True)
    for label in labels:
        table.add_column(Text(label), overflow="fold")  # in a str, [m] would be markup
    for title in titles:
        table.add_column(Text(title, justify="right"), justify="right", no_wrap=True)
    return table


def figure_text(value: Any) -> str:
    """Return a number with three decimals, or one from 10 on; a dash for None."""
    if value is None:
        return ABSENT
    return f"{value:.3f}" if abs(value) < 10 else f"{value:.1f}"
