# SPDX-License-Identifier: Apache-2.0
"""Draws a cut flight as figures 7.4.2 to 7.4.5 of [thesis]: each vehicle's tracks from above, and errors over time."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uav_vslam.evaluation.study import Row
from uav_vslam.report.style import STYLES, TrackStyle, clean, save
from uav_vslam.studies.engine.pool import grouped

LINES = {
    "Truth": STYLES["truth"],
    "INS": STYLES["ins"],
    "S-SLAM": STYLES["s_slam"],
    "C-SLAM narrowband": TrackStyle("C-SLAM narrowband", "#7b3294", 1.5, "--", 6),
    "C-SLAM wideband": STYLES["c_slam"],
}
AXES = ("east", "north", "up")
MARGIN = 1.15  # of the axes beyond what SLAM needs; the INS leaves the view


def draw_split(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw what the study holds into its folder and return the paths."""
    return [save(split_plot(tree["series"]), folder / "split.png")] if tree.get("series") else []


def split_plot(series: list[Row]) -> Figure:
    """Return a column for each vehicle: plan view, then the errors of each axis."""
    vehicles = grouped(series, lambda curve: curve["condition"])
    figure = Figure(figsize=(1.0 + 5.5 * len(vehicles), 11.0), layout="constrained")
    grid = figure.subplots(4, len(vehicles), squeeze=False, height_ratios=[2.0, 1.0, 1.0, 1.0])
    for column, (vehicle, curves) in enumerate(vehicles.items()):
        _draw_plan(grid[0, column], curves)
        grid[0, column].set_title(vehicle)
        for row, axis in enumerate(AXES, start=1):
            _draw_errors(grid[row, column], curves, axis)
        grid[3, column].set_xlabel("Time [s]")
    for axes, axis in zip(grid[1:, 0], AXES, strict=True):
        axes.set_ylabel(f"{axis.capitalize()} error, rms [m]")
    handles = [Line2D([], [], label=label, **style.line) for label, style in LINES.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return figure


def _draw_plan(axes: Axes, curves: list[Row]) -> None:
    """Draw the first seed's tracks from above; the view is that of all but the INS."""
    clean(axes)
    for curve in curves:
        axes.plot(curve["east_m"], curve["north_m"], **LINES[curve["method"]].line)
    kept = [curve for curve in curves if curve["method"] != "INS"]
    for which, key in (("x", "east_m"), ("y", "north_m")):
        values = np.concatenate([curve[key] for curve in kept])
        middle, half = 0.5 * (values.min() + values.max()), 0.5 * np.ptp(values) * MARGIN + 1e-3
        axes.set(**{f"{which}lim": (middle - half, middle + half)})
    axes.set(xlabel="East [m]", ylabel="North [m]")
    axes.set_aspect("equal")


def _draw_errors(axes: Axes, curves: list[Row], axis: str) -> None:
    clean(axes)
    key = f"error_{axis}_rms_m"
    for curve in curves:
        if curve["method"] != "Truth":
            axes.plot(curve["time_s"], curve[key], **LINES[curve["method"]].line)
    top = max(max(curve[key]) for curve in curves if curve["method"] not in ("Truth", "INS"))
    axes.set_ylim(0.0, MARGIN * top or 1.0)
