# SPDX-License-Identifier: Apache-2.0
"""A comparison of runs as tables for the terminal, at most 100 columns wide."""

from collections.abc import Iterator

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from uav_vslam.evaluation.comparison import Figures
from uav_vslam.report.table import figure_text

WIDTH = 100
ALIGNMENT_TITLES = {"none": "unaligned", "start-yaw": "start yaw", "yaw": "yaw+pos", "se3": "SE3"}
NOTES = """\
unaligned: as given; start yaw: start moved to the true start and turned about the vertical there;
yaw+pos: best turn about the vertical and best shift; SE3: best rotation and shift. End: unaligned.
NEES: of the position, unaligned; 1 is consistent. Drift: mean error of the relative motion over
segments of the path, per distance."""


def print_comparison(tree: Figures, console: Console | None = None) -> None:
    """Print the tables of a `comparison.compare` result, and what their columns mean."""
    console = console or Console()
    if not console.is_terminal:
        console = Console(file=console.file, width=WIDTH)
    console.print(error_table(tree))
    console.print(drift_table(tree))
    console.print(NOTES, markup=False, highlight=False, soft_wrap=True)


def error_table(tree: Figures) -> Table:
    """Return a row per run with path, ATE for each alignment, end error and NEES."""
    titles = ("Path\n[m]", *(f"ATE [m]\n{title}" for title in ALIGNMENT_TITLES.values()), "End\n[m]", "NEES")
    table = _table("Run", *titles)
    for run, label in _labelled(tree, table):
        ate_m = [run["ate_m"][name] for name in ALIGNMENT_TITLES]
        cells = [*ate_m, run["end_m"]["none"], run["nees_position"]]
        table.add_row(label, f"{run['distance_m']:.0f}", *map(figure_text, cells))
    return table


def drift_table(tree: Figures) -> Table:
    """Return two rows per run, for translation and rotation, with a column per length of the segments."""
    table = _table("Run", "Drift", "mean", *(f"{length_m:g} m" for length_m in tree["segments_m"]))
    for run, label in _labelled(tree, table):
        drifts = [run["rpe"], *run["rpe_by_segment"]]
        moved = [figure_text(drift["translation_percent"]) for drift in drifts]
        turned = [figure_text(drift["rotation_deg_per_100m"]) for drift in drifts]
        table.add_row(label, "%", *moved)
        table.add_row("", "°/100 m", *turned)
    return table


def _labelled(tree: Figures, table: Table) -> Iterator[tuple[Figures, Text]]:
    """Yield each run with its label; the name of a results folder gets a row of its own above its runs."""
    above = ""
    for run in tree["runs"]:
        if run["track"] and run["source"] != above:
            table.add_row(Text(run["source"]))
        above = run["source"]
        yield run, Text(f"  {run['track']}" if run["track"] else run["source"])


def _table(first: str, *titles: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1))
    table.add_column(first, overflow="fold")
    for title in titles:
        table.add_column(Text(title, justify="right"), justify="right", no_wrap=True)  # in a str, [m] would be markup
    return table
