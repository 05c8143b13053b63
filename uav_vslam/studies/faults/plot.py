# SPDX-License-Identifier: Apache-2.0
"""Draws the study of the faults: end error and consistency of each, by front end."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from uav_vslam.evaluation.study import Row
from uav_vslam.report.style import BAND, LINE_COLOURS, clean, column, plain_log, save, shared_legend
from uav_vslam.studies.engine.pool import grouped

ALLOWED_NEES = 3.0
MARKERS = "os^D"


def draw_faults(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the study into its folder and return the paths."""
    return [save(faults_plot(tree["rows"]), folder / "faults.png")]


def faults_plot(rows: list[Row]) -> Figure:
    """Return end error and the worst seed's NEES, faults downwards; the allowed range is shaded."""
    faults = list(dict.fromkeys(row["condition"] for row in rows))
    figure = Figure(figsize=(11.0, 1.6 + 0.4 * len(faults)), layout="constrained")
    errors, nees = figure.subplots(1, 2, sharey=True)
    for number, (method, found) in enumerate(grouped(rows, lambda row: row["method"]).items()):
        places = [faults.index(row["condition"]) for row in found]
        style = {
            "color": LINE_COLOURS[number % len(LINE_COLOURS)],
            "marker": MARKERS[number % len(MARKERS)],
            "linestyle": "",
            "alpha": 0.8,
        }
        errors.plot([row["end_rms_m"] for row in found], places, label=method, **style)
        nees.plot(column(found, "nees_position_worst"), places, **style)
    for axes in (errors, nees):
        plain_log(axes, "x")
        clean(axes)
    known = [row["nees_position_worst"] for row in rows if row["nees_position_worst"] is not None]
    low, high = min([*known, 0.3]) / 1.5, max([*known, ALLOWED_NEES]) * 1.5
    nees.axvspan(low, ALLOWED_NEES, color=BAND, zorder=0)
    nees.set(xlim=(low, high), xlabel="Position NEES / 3, worst seed")
    errors.set(xlabel="End error, root mean square [m]", yticks=range(len(faults)), yticklabels=faults)
    errors.invert_yaxis()
    shared_legend(figure, [errors], above=True, ncols=4)
    return figure
