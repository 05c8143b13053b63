# SPDX-License-Identifier: Apache-2.0
"""Draws the study of the long flight: error, time and landmarks over the distance flown."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from uav_vslam.report.style import LINE_COLOURS, clean, save

Array = NDArray[np.float64]

SMOOTHING_FRAMES = 21  # times are noisy; the curve is their running median


def draw_long(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the curves of a study into its folder and return the path."""
    curves = tree.get("series", [])
    return [save(long_plot(curves), folder / "long.png")] if curves else []


def long_plot(curves: list[dict[str, Any]]) -> Figure:
    """Return error, time of a frame and landmarks in the state over the distance, a line per variant."""
    figure = Figure(figsize=(10.0, 9.0), layout="constrained")
    errors, times, landmarks = figure.subplots(3, 1, sharex=True)
    for number, curve in enumerate(curves):
        style = {"color": LINE_COLOURS[number % len(LINE_COLOURS)], "linewidth": 1.4}
        distance = np.array(curve["distance_m"])
        errors.plot(distance, curve["error_m"], label=curve["method"], **style)
        times.plot(distance, running_median(np.array(curve["ms_per_frame"])), **style)
        landmarks.plot(distance, curve["landmarks"], **style)
    errors.set(ylabel="Position error, rms of the runs [m]")
    times.set(ylabel="Time of a frame [ms]")
    landmarks.set(ylabel="Landmarks in the state", xlabel="Distance flown [m]")
    for axes in (errors, times, landmarks):
        axes.set_ylim(bottom=0.0)
        clean(axes)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    return figure


def running_median(values: Array) -> Array:
    """Return the median over the neighbouring frames; near the ends the curve is mirrored."""
    return np.asarray(median_filter(values, SMOOTHING_FRAMES, mode="reflect"))
