# SPDX-License-Identifier: Apache-2.0
"""Draws the revisit study: error over the distance flown, and each flight's end error with and without retention."""

from itertools import cycle
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uav_vslam.report.style import LINE_COLOURS, clean, save, shared_legend
from uav_vslam.studies.engine.pool import grouped

Curve = dict[str, Any]

ALLOWED_RATIO = 0.5  # of the end error to that with nothing retained
LINE = "#888888"


def draw_revisit(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the curves of a study into its folder and return the path."""
    curves = tree.get("series", [])
    return [save(revisit_plot(curves), folder / "revisit.png")] if curves else []


def revisit_plot(curves: list[Curve]) -> Figure:
    """Return a row per level: error over distance, and end errors against those of the last method."""
    levels = grouped(curves, lambda curve: curve["condition"])
    figure = Figure(figsize=(11.0, 4.2 * len(levels)), layout="constrained")
    rows = figure.subplots(len(levels), 2, squeeze=False)
    for (level, of_level), (errors, ends) in zip(levels.items(), rows, strict=True):
        _draw_errors(errors, of_level)
        _draw_ends(ends, of_level)
        errors.set_title(f"{level}, rms of {len(of_level[0]['seeds'])} flights", fontsize=10)
        ends.set_title(f"each flight; solid: equal, dashed: {ALLOWED_RATIO:g} of it", fontsize=10)
    shared_legend(figure, figure.axes[:1], ncols=4)
    return figure


def _draw_errors(axes: Axes, curves: list[Curve]) -> None:
    for curve, colour in zip(curves, cycle(LINE_COLOURS), strict=False):
        axes.plot(curve["distance_m"], curve["error_m"], color=colour, linewidth=1.4, label=curve["method"])
    axes.set(xlabel="Distance flown [m]", ylabel="Position error [m]", ylim=(0.0, None))
    clean(axes)


def _draw_ends(axes: Axes, curves: list[Curve]) -> None:
    """Draw a dot per flight, and the limit line below which it should be."""
    *others, reference = curves
    without = dict(zip(reference["seeds"], reference["ends_m"], strict=True))
    for curve, colour in zip(others, cycle(LINE_COLOURS), strict=False):
        ends = {seed: end for seed, end in zip(curve["seeds"], curve["ends_m"], strict=True) if seed in without}
        axes.plot([without[seed] for seed in ends], list(ends.values()), "o", color=colour)
    most = max([*without.values(), *(end for curve in others for end in curve["ends_m"])])
    for slope, dashes in ((1.0, "-"), (ALLOWED_RATIO, "--")):
        axes.plot([0.0, most], [0.0, slope * most], color=LINE, linewidth=0.8, linestyle=dashes)
    axes.set(xlabel=f"End error, {reference['method']} [m]", ylabel="End error [m]", xlim=(0.0, None), ylim=(0.0, None))
    clean(axes)
