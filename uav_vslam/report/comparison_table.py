# SPDX-License-Identifier: Apache-2.0
"""A comparison of runs as tables for the terminal, at most 120 columns wide."""

from collections.abc import Iterator

from rich.console import Console
from rich.table import Table
from rich.text import Text

from uav_vslam.evaluation.comparison import Figures
from uav_vslam.report.layout import (
    ALIGNMENT_TITLES,
    NEES_TITLES,
    RELATIVE_TITLES,
    ate_title,
    figure_text,
    new_table,
    print_table,
    wide,
)

NOTES = """\
unaligned: as given; start yaw: turned about the vertical through its start; start pose: the start moved to the true
one, too; yaw+pos: best turn about the vertical and best shift; SE3: best rotation and shift. Height, End and NEES are
unaligned; 1 is a consistent NEES. 14 m, 100 m: root mean square error of the motion over segments of the path. Drift:
mean error of the motion over segments, per distance."""


def print_comparison(tree: Figures, console: Console | None = None) -> None:
    """Print the tables of a `comparison.compare` result, and what their columns mean."""
    console = wide(console)
    print_table(error_table(tree), console)
    print_table(relative_table(tree), console)
    print_table(drift_table(tree), console)
    console.print(NOTES, markup=False, highlight=False, soft_wrap=True)


def error_table(tree: Figures) -> Table:
    """Return a row per run with path, ATE for each alignment, height and end error, and NEES."""
    titles = ("Path\n[m]", *map(ate_title, ALIGNMENT_TITLES), "Height\n[m]", "End\n[m]", *NEES_TITLES)
    table = new_table(["Run"], titles)
    for run, label in _labelled(tree, table):
        errors = [*(run["ate_m"][name] for name in ALIGNMENT_TITLES), run["height_rms_m"], run["end_m"]["none"]]
        cells = [*errors, *(run[key] for key in NEES_TITLES.values())]
        table.add_row(label, f"{run['distance_m']:.0f}", *map(figure_text, cells))
    return table


def relative_table(tree: Figures) -> Table:
    """Return a row per run with the errors of the motion by direction."""
    table = new_table(["Run"], RELATIVE_TITLES)
    for run, label in _labelled(tree, table):
        table.add_row(label, *(figure_text(run[key]) for key in RELATIVE_TITLES.values()))
    return table


def drift_table(tree: Figures) -> Table:
    """Return two rows per run, for translation and rotation, with a column per length of the segments."""
    table = new_table(["Run", "Drift"], ("mean", *(f"{length_m:g} m" for length_m in tree["segments_m"])))
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
