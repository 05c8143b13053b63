# SPDX-License-Identifier: Apache-2.0
"""Draws the study of the rig: end error and consistency of each condition, with and without the error as a state."""

import itertools
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uav_vslam.evaluation.study import Row
from uav_vslam.report.style import STYLES, clean, plain_log, save, shared_legend
from uav_vslam.studies.engine.pool import grouped

MARKS = (  # colour, marker and size by method in the order of the rows; the next ones are again the first
    ("#d55e00", "s", 10.0),
    ("#0072b2", "o", 7.0),
    ("#009e73", "^", 6.0),
    ("#000000", "x", 6.0),
)
LINK = "#bbbbbb"


def draw_rig(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the study into its folder and return the paths."""
    return [save(rig_plot(tree["rows"]), folder / "rig.png")]


def rig_plot(rows: list[Row]) -> Figure:
    """Return end error and NEES on logarithmic axes, conditions downwards."""
    ins = STYLES["ins"]
    ins_rows = [row for row in rows if row["method"] == ins.label]
    flown = [row for row in rows if row["method"] != ins.label]
    places = {condition: k for k, condition in enumerate(dict.fromkeys(row["condition"] for row in flown))}
    figure = Figure(figsize=(11.0, 1.8 + 0.38 * len(places)), layout="constrained")
    errors, nees = figure.subplots(1, 2, sharey=True)
    for axes, key in ((errors, "end_rms_m"), (nees, "nees_position")):
        _draw(axes, flown, places, key)
        plain_log(axes, "x")
    for row in (row for row in ins_rows if row["end_rms_m"] is not None):
        errors.axvline(row["end_rms_m"], color=ins.colour, linestyle=ins.dashes, label=ins.label)
    nees.axvline(1.0, color="black", linewidth=0.9, label="consistent")
    errors.set(xlabel="End error, root mean square [m]", yticks=list(places.values()))
    errors.set_yticklabels(list(places))
    errors.invert_yaxis()
    nees.set(xlabel="Position NEES / 3")
    shared_legend(figure, (errors, nees), above=True, ncols=len(rows))
    return figure


def _draw(axes: Axes, rows: list[Row], places: dict[str, int], key: str) -> None:
    """Draw a mark per row, and a line between those of one condition."""
    clean(axes)
    for condition, place in places.items():
        values = [row[key] for row in rows if row["condition"] == condition]
        axes.plot(values, [place] * len(values), color=LINK, linewidth=2.0, zorder=1)
    methods = grouped(rows, lambda row: row["method"])
    for (name, found), (colour, marker, size) in zip(methods.items(), itertools.cycle(MARKS), strict=False):
        where = [places[row["condition"]] for row in found]
        axes.plot([row[key] for row in found], where, marker, color=colour, label=name, markersize=size, zorder=3)
