# SPDX-License-Identifier: Apache-2.0
"""Plots of a flight, written to its results folder without a display or pyplot's global state."""

from pathlib import Path

from uav_vslam.evaluation.result import FlightResult
from uav_vslam.report.error_plot import error_plot
from uav_vslam.report.landmark_view import landmark_view
from uav_vslam.report.nees_plot import nees_plot
from uav_vslam.report.quality_plot import quality_plot
from uav_vslam.report.style import save
from uav_vslam.report.views import plan_view

DRAWINGS = {
    "plan_view.png": plan_view,
    "errors.png": error_plot,
    "nees.png": nees_plot,
    "quality.png": quality_plot,
    "landmarks.png": landmark_view,
}


def write_plots(result: FlightResult, folder: Path) -> list[Path]:
    """Write every plot for which the flight has data, and return the paths."""
    written = []
    for name, draw in DRAWINGS.items():
        figure = draw(result)
        if figure is not None:
            written.append(save(figure, folder / name))
    return written
