# SPDX-License-Identifier: Apache-2.0
"""What the tables of flights and of comparisons share: width, columns, titles of the scores, numbers as text."""

from collections.abc import Iterable
from typing import Any

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Column, Table
from rich.text import Text

from uav_vslam.evaluation.scores import DIRECTIONS, RELATIVE_LENGTHS_M, relative_key
from uav_vslam.report.terminal import Terminal

WIDTH = 120  # where the output is no terminal
LABEL_WIDTH = 20  # labels are folded to that much before figures go into another table
BOUNDLESS = 10_000
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


def wide(console: Console | None = None) -> Console:
    """Return a console that is wide enough for the tables, unless it is a terminal."""
    console = console or Terminal()
    return console if console.is_terminal else Terminal(file=console.file, width=WIDTH)


def new_table(labels: Iterable[str], titles: Iterable[str]) -> Table:
    """Return a table without rows: columns of labels, which are folded where they are too long, and of figures."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1), collapse_padding=True)
    for label in labels:
        table.add_column(Text(label), overflow="fold")  # in a str, [m] would be markup
    for title in titles:
        table.add_column(Text(title, justify="right"), justify="right", no_wrap=True)
    return table


def print_table(table: Table, console: Console) -> None:
    """Print a table of `new_table`, in parts with the same labels, one below another, where it is too wide."""
    labels = [column for column in table.columns if not column.no_wrap]
    figures = [column for column in table.columns if column.no_wrap]
    while figures:
        count = len(figures)
        while count > 1 and _width(_part(table, [*labels, *figures[:count]], LABEL_WIDTH), console) > console.width:
            count -= 1
        console.print(_part(table, [*labels, *figures[:count]]))
        figures = figures[count:]


def _part(table: Table, columns: list[Column], label_width: int | None = None) -> Table:
    """Return the table with these of its columns only; labels have a width of at most `label_width`."""
    part = new_table((), ())
    for one in columns:
        width = None if one.no_wrap else label_width
        part.add_column(one.header, justify=one.justify, overflow=one.overflow, no_wrap=one.no_wrap, max_width=width)
    for row, *cells in zip(table.rows, *(one.cells for one in columns), strict=True):
        part.add_row(*cells, end_section=row.end_section)
    return part


def _width(table: Table, console: Console) -> int:
    """Return how wide a table is where nothing limits it."""
    return Measurement.get(console, console.options.update(max_width=BOUNDLESS), table).maximum


def figure_text(value: Any) -> str:
    """Return a number with three decimals, or one from 10 on; a dash for None."""
    if value is None:
        return ABSENT
    return f"{value:.3f}" if abs(value) < 10 else f"{value:.1f}"
