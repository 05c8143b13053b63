# SPDX-License-Identifier: Apache-2.0
"""The frames of a flight over time, judged without ground truth: innovations, points, claims, calibration."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uav_vslam.evaluation.quality import claimed_sigma, innovation_bands
from uav_vslam.evaluation.result import FlightResult, VehicleResult
from uav_vslam.report.style import BAND, LINE_COLOURS, clean, plain_log, shared_legend
from uav_vslam.types import NS_PER_S, FrameQuality

COASTED, EVENT, SIGMA = "#f3c9c4", "#d62728", "#d9d9d9"
LABELS = ("NIS / dof", "Points", "1σ position [m]", "1σ heading [deg]")
CALIBRATION = {  # fields of a frame: estimate, standard deviation, and by what they are multiplied
    "Time offset ±1σ [ms]": ("time_offset_s", "time_offset_sigma_s", 1e3),
    "Disparity error ±1σ [px]": ("disparity_error_px", "disparity_error_sigma_px", 1.0),
}
POINTS = {"features": LINE_COLOURS[6], "tracked": LINE_COLOURS[4], "associated": LINE_COLOURS[2]}


def quality_plot(result: FlightResult) -> Figure | None:
    """Return NIS, points, claims and the estimated calibration, a column per vehicle; None without records of frames.

    Frames that were coasted through are shaded, reported problems are dashed lines.
    """
    vehicles = [vehicle for vehicle in result.vehicles.values() if vehicle.frames]
    if not vehicles:
        return None
    estimated = {label: fields for label, fields in CALIBRATION.items() if any(_has(v, fields[1]) for v in vehicles)}
    labels = (*LABELS, *estimated)
    figure = Figure(figsize=(2.0 + 5.5 * len(vehicles), 2.0 * len(labels)), layout="constrained")
    grid = figure.subplots(len(labels), len(vehicles), sharex="col", sharey="row", squeeze=False)
    for column, vehicle in zip(grid.T, vehicles, strict=True):
        _draw(column, vehicle, list(estimated.values()))
        column[0].set_title(vehicle.name)
        column[-1].set_xlabel("Time [s]")
    plain_log(grid[0, 0], "y")
    for axes in grid[1 : len(LABELS), 0]:
        axes.set_ylim(bottom=0)  # once all is drawn: the limit of a row is then kept
    for axes, label in zip(grid[:, 0], labels, strict=True):
        axes.set_ylabel(label)
    figure.suptitle(f"{result.name}: S-SLAM without ground truth; shaded: coasted, dashed: reported problem")
    shared_legend(figure, grid[:, 0], ncols=6)
    return figure


def _has(vehicle: VehicleResult, sigma: str) -> bool:
    """Return whether any frame estimates what has that standard deviation."""
    return any(getattr(frame, sigma) > 0 for frame in vehicle.frames or ())


def _draw(column: NDArray[Any], vehicle: VehicleResult, estimated: list[tuple[str, str, float]]) -> None:
    frames, track = vehicle.frames or (), vehicle.s_slam
    start_ns = frames[0].stamp_ns
    seconds = np.array([(frame.stamp_ns - start_ns) / NS_PER_S for frame in frames])
    for axes in column:
        clean(axes)
        _mark(axes, frames, seconds)
    _draw_innovations(column[0], frames, seconds)
    for name, colour in POINTS.items():
        column[1].plot(seconds, [getattr(frame, name) for frame in frames], color=colour, linewidth=1.2, label=name)
    if track.covariance is not None:
        position_m, heading_rad = claimed_sigma(track)
        since_start = (track.stamps_ns - start_ns) / NS_PER_S
        column[2].plot(since_start, position_m, color="black", linewidth=1.3)
        column[3].plot(since_start, np.degrees(heading_rad), color="black", linewidth=1.3)
    for axes, (name, sigma_name, scale) in zip(column[len(LABELS) :], estimated, strict=True):
        mean, sigma = (scale * np.array([getattr(frame, field) for frame in frames]) for field in (name, sigma_name))
        mean = np.where(sigma > 0, mean, np.nan)  # not estimated
        axes.fill_between(seconds, mean - sigma, mean + sigma, color=SIGMA, linewidth=0, label="±1σ")
        axes.plot(seconds, mean, color="black", linewidth=1.3)


def _draw_innovations(axes: Any, frames: tuple[FrameQuality, ...], seconds: NDArray[np.float64]) -> None:
    rows = [k for k, frame in enumerate(frames) if frame.dof > 0]
    dof = np.array([float(frames[k].dof) for k in rows])
    low, high = innovation_bands(dof, np.array([frames[k].gate_probability for k in rows]))
    axes.fill_between(seconds[rows], low, high, color=BAND, linewidth=0, label="95 % band")
    nis = np.array([frames[k].nis for k in rows])
    axes.plot(seconds[rows], nis / dof, color="black", linewidth=0.9, marker=".", markersize=3, label="NIS / dof")


def _mark(axes: Any, frames: tuple[FrameQuality, ...], seconds: NDArray[np.float64]) -> None:
    """Shade each coasted frame back to the one before, and mark each event."""
    for k, frame in enumerate(frames):
        if frame.coasted and k:
            axes.axvspan(seconds[k - 1], seconds[k], color=COASTED, linewidth=0, zorder=0)
        if frame.events:
            axes.axvline(seconds[k], color=EVENT, linewidth=0.9, linestyle="--")
