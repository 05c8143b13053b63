# SPDX-License-Identifier: Apache-2.0
"""Draws the study of the front ends: precision, points and cost, side by side."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from uav_vslam.evaluation.study import Row
from uav_vslam.report.style import LINE_COLOURS, clean, column, save, shared_legend
from uav_vslam.studies.engine.pool import grouped

PANELS = {  # key of the row, its axis' name, and its limit
    "sigma_px": ("Right pixel's error, one sigma [px]", 0.15),
    "kept_share": ("Points over those with equal cameras", 0.9),
    "ms_per_frame": ("Processor time [ms/frame]", 60.0),
}
BAR = 0.8  # of the place of a condition


def draw_front_ends(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the study into its folder and return the paths."""
    return [save(front_end_plot(tree["rows"]), folder / "front_end.png")]


def front_end_plot(rows: list[Row]) -> Figure:
    """Return a panel a figure, with a group of bars for each condition and a dotted line at the limit."""
    methods = grouped(rows, lambda row: row["method"])
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    figure = Figure(figsize=(12.0, 1.6 + 0.7 * len(conditions)), layout="constrained")
    for axes, (key, (name, asked)) in zip(figure.subplots(1, len(PANELS), sharey=True), PANELS.items(), strict=True):
        clean(axes)
        height = BAR / len(methods)
        for number, (method, found) in enumerate(methods.items()):
            places = [conditions.index(row["condition"]) - 0.5 * BAR + (number + 0.5) * height for row in found]
            colour = LINE_COLOURS[number % len(LINE_COLOURS)]
            bars = axes.barh(places, column(found, key), height, color=colour, label=method)
            axes.bar_label(bars, fmt="%.3g", padding=3, fontsize=8)
        axes.axvline(asked, color="#888888", linewidth=0.9, linestyle=":")
        axes.margins(x=0.15)
        axes.set(xlabel=name, yticks=range(len(conditions)), yticklabels=conditions)
    axes.invert_yaxis()
    shared_legend(figure, [axes], above=True, ncols=len(methods))
    return figure
