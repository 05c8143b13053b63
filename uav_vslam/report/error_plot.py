# SPDX-License-Identifier: Apache-2.0
"""Position errors over time with the filters' sigma bands."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from uav_vslam.evaluation.pairing import pair_with_truth
from uav_vslam.evaluation.result import FlightResult, VehicleResult
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.report.style import SIGMAS, STYLES, axes_of, clean, tracks_of

Array = NDArray[np.float64]

BAND_COLOURS = {"s_slam": "#e2e2e2", "c_slam": "#c2ebf2", "smoothed": "#ffe8cc"}
LOWEST, HIGHEST = 0.5, 0.9  # of the bands' order: below the grid


def error_plot(result: FlightResult) -> Figure | None:
    """Return the errors of each SLAM track per axis, a column per vehicle; None without ground truth."""
    vehicles = {vehicle.name: found for vehicle in result.vehicles.values() if (found := _scored(vehicle))}
    if not vehicles:
        return None
    figure = Figure(figsize=(1.5 + 6.0 * len(vehicles), 7.5), layout="constrained")
    grid = figure.subplots(3, len(vehicles), sharex="col", sharey="row", squeeze=False)
    for column, (vehicle, pairs) in zip(grid.T, vehicles.items(), strict=True):
        start_ns = int(result.vehicles[vehicle].s_slam.stamps_ns[0])
        for name, (track, truth) in pairs.items():
            seconds = np.asarray((track.stamps_ns - start_ns) * 1e-9, float)
            _draw(column, seconds, track.positions - truth.positions, track.covariance, name)
        column[0].set_title(vehicle)
        column[-1].set_xlabel("Time [s]")
    for row, axis in enumerate(axes_of(result.config)):
        grid[row, 0].set_ylabel(f"{axis} error [m]")
    figure.suptitle(f"{result.name}: position errors and their {SIGMAS:.0f}-sigma bands")
    figure.legend(handles=_legend(vehicles), loc="outside lower center", ncols=6, frameon=False)
    return figure


def _scored(vehicle: VehicleResult) -> dict[str, tuple[Trajectory, Trajectory]]:
    """Return the SLAM tracks with ground truth, and the ground truth of each."""
    if vehicle.truth is None:
        return {}
    tracks = {name: track for name, track in tracks_of(vehicle).items() if name in BAND_COLOURS}
    pairs = {name: pair_with_truth(track, vehicle.truth) for name, track in tracks.items()}
    return {name: pair for name, pair in pairs.items() if len(pair[0])}


def _draw(column: NDArray[Any], seconds: Array, error: Array, covariance: Array | None, name: str) -> None:
    """Draw one track's error and band into the three axes of a vehicle."""
    style = STYLES[name]
    for axis, axes in enumerate(column):
        clean(axes)
        axes.axhline(0.0, color="#888888", linewidth=0.6)
        axes.plot(seconds, error[:, axis], **style.line)
        if covariance is None:
            continue
        band = SIGMAS * np.sqrt(np.maximum(covariance[:, axis, axis], 0.0))
        order = LOWEST + (HIGHEST - LOWEST) / (1.0 + band.mean())  # the narrowest on top
        axes.fill_between(seconds, -band, band, color=BAND_COLOURS[name], linewidth=0, zorder=order)
        for side in (-band, band):
            axes.plot(seconds, side, color=style.colour, linewidth=0.7, linestyle=":", zorder=style.order)


def _legend(vehicles: dict[str, dict[str, Any]]) -> list[Any]:
    present = {name for pairs in vehicles.values() for name in pairs}
    handles: list[Any] = []
    for name in BAND_COLOURS:
        if name in present:
            style = STYLES[name]
            handles.append(Line2D([], [], label=f"{style.label} error", **style.line))
            band = f"{style.label} ±{SIGMAS:.0f} sigma"
            handles.append(Patch(color=BAND_COLOURS[name], linewidth=0, label=band))
    return handles
