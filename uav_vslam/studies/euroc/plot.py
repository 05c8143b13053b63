# SPDX-License-Identifier: Apache-2.0
"""Draws the study of starts: each run's position error over time, a panel for each filter, a dot for each frame."""

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uav_vslam.evaluation.study import Row
from uav_vslam.report.style import clean, plain_log, save
from uav_vslam.studies.engine.pool import grouped

COLOURS = {"recorded": "black", "drawn": "#0072b2", "frame": "#d55e00"}  # by the first word of the start's name
LABELS = {"recorded": "recorded start", "drawn": "drawn from its covariance", "frame": "truth at a later frame"}

DIVERGED_M = 1.0  # larger errors get a logarithmic axis: on a linear one they would hide all others


def draw_starts(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw what the study holds into its folder and return the paths."""
    return [save(start_plot(tree["series"]), folder / "errors.png")] if tree.get("series") else []


def start_plot(series: list[Row]) -> Figure:
    """Return the errors of all runs, panels downwards."""
    methods = grouped(series, lambda curve: curve["method"])
    figure = Figure(figsize=(9.0, 1.0 + 2.0 * len(methods)), layout="constrained")
    panels = figure.subplots(len(methods), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for (method, curves), axes in zip(methods.items(), panels, strict=True):
        _draw(axes, curves)
        axes.set_ylabel(f"{method}: error [m]")
    if max((error for curve in series for error in curve["error_m"]), default=0.0) > DIVERGED_M:
        plain_log(panels[-1], "y")
    else:
        panels[-1].set_ylim(bottom=0.0)
    panels[-1].set_xlabel("Time since the recorded start [s]")
    kinds = [kind for kind in COLOURS if any(_kind(curve) == kind for curve in series)]
    handles = [Line2D([], [], color=COLOURS[kind], label=LABELS[kind]) for kind in kinds]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return figure


def _draw(axes: Axes, curves: list[Row]) -> None:
    clean(axes)
    for curve in curves:
        colour = COLOURS[_kind(curve)]
        axes.plot(curve["time_s"], curve["error_m"], ".-", color=colour, linewidth=1.0, markersize=3.0, alpha=0.8)


def _kind(curve: Row) -> str:
    return str(curve["condition"]).partition(" ")[0]
