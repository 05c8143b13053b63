# SPDX-License-Identifier: Apache-2.0
"""Draws the mean NEES of many runs over time, of position and attitude, with the chi-square band of that mean."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from uav_vslam.report.nees_plot import ROWS, draw_band, nees_axis
from uav_vslam.report.style import numbered_line, save, shared_legend
from uav_vslam.studies.engine.pool import grouped

LOWEST_MEAN = 0.05  # means over many runs scatter less than a run


def draw_nees(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the NEES curves of a study into its folder and return the path."""
    curves = tree.get("series", [])
    return [save(nees_over_time(curves), folder / "nees.png")] if curves else []


def nees_over_time(curves: list[dict[str, Any]]) -> Figure:
    """Return position and attitude downwards, a column per condition, a line per method.

    Args:
        curves: dicts with method, condition, runs, and lists under time_s, nees_position and nees_rotation.
    """
    conditions = grouped(curves, lambda curve: curve["condition"])
    methods = list(dict.fromkeys(curve["method"] for curve in curves))
    figure = Figure(figsize=(2.0 + 5.5 * len(conditions), 6.2), layout="constrained")
    grid = figure.subplots(len(ROWS), len(conditions), sharex="col", sharey=True, squeeze=False)
    for column, (condition, found) in zip(grid.T, conditions.items(), strict=True):
        runs = min(curve["runs"] for curve in found)  # the widest band; more runs scatter less
        for axes, part in zip(column, ROWS.values(), strict=True):
            draw_band(axes, runs=runs)
            for curve in found:
                line = numbered_line(methods.index(curve["method"]), width=1.4)
                axes.plot(curve["time_s"], curve[f"nees_{part}"], label=curve["method"], **line)
        column[0].set_title(f"{condition}\n(95 % band of the mean of {runs} runs)", fontsize=10)
        column[-1].set_xlabel("Time [s]")
    for axes, label in zip(grid[:, 0], ROWS, strict=True):
        axes.set_ylabel(f"{label}, mean")
        nees_axis(axes, lowest=LOWEST_MEAN)
    shared_legend(figure, grid[0], ncols=4)
    return figure
