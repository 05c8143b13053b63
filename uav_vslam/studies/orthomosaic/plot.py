# SPDX-License-Identifier: Apache-2.0
"""Draws the errors of the pictures over the distance from where they begin."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from uav_vslam.evaluation.study import Row
from uav_vslam.report.style import LINE_COLOURS, clean, plain_log, save


def draw_orthomosaic(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the curves of a study into its folder and return the path."""
    curves = tree.get("series", [])
    return [save(error_plot(curves), folder / "orthomosaic.png")] if curves else []


def error_plot(curves: list[Row]) -> Figure:
    """Return the error of every patch over its distance from the first one, a colour per method, all seeds."""
    figure = Figure(figsize=(10.0, 5.5), layout="constrained")
    axes = figure.subplots()
    methods = list(dict.fromkeys(curve["method"] for curve in curves))
    for curve in curves:
        number = methods.index(curve["method"])
        first = curve is next(other for other in curves if other["method"] == curve["method"])
        axes.plot(
            curve["distance_m"],
            [max(error, 1e-3) for error in curve["error_m"]],
            ".",
            markersize=3.0,
            alpha=0.6,
            color=LINE_COLOURS[number % len(LINE_COLOURS)],
            label=curve["method"] if first else None,
        )
    axes.set(xlabel="Distance from the first image's middle [m]", ylabel="Error of place [m]")
    plain_log(axes, "y")
    clean(axes)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, markerscale=4.0)
    return figure
