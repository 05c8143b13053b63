# SPDX-License-Identifier: Apache-2.0
"""Consistency over time: NEES of position and attitude with the chi-square band."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uav_vslam.evaluation.consistency import SKIPPED_KEYFRAMES, Nees, chi_square_band, nees
from uav_vslam.evaluation.output import WITH_COVARIANCE
from uav_vslam.evaluation.result import FlightResult, VehicleResult
from uav_vslam.report.style import BAND, STYLES, clean, plain_log, shared_legend, tracks_of
from uav_vslam.types import NS_PER_S

ROWS = {"Position NEES / 3": "position", "Attitude NEES / 3": "rotation"}
LOWEST, HIGHEST = 0.01, 10.0  # the axis covers at least this; perfect frames below it are clipped


def nees_plot(result: FlightResult) -> Figure | None:
    """Return the NEES of position and attitude over time, a column per vehicle; None without ground truth."""
    vehicles = {vehicle.name: found for vehicle in result.vehicles.values() if (found := _scored(vehicle))}
    if not vehicles:
        return None
    figure = Figure(figsize=(2.0 + 5.5 * len(vehicles), 6.0), layout="constrained")
    grid = figure.subplots(len(ROWS), len(vehicles), sharex="col", sharey=True, squeeze=False)
    for column, (name, tracks) in zip(grid.T, vehicles.items(), strict=True):
        _draw(column, tracks)
        column[0].set_title(name)
        column[-1].set_xlabel("Time [s]")
    for axes, label in zip(grid[:, 0], ROWS, strict=True):
        axes.set_ylabel(label)
    for axes in grid[:, 0]:
        nees_axis(axes)
    figure.suptitle(f"{result.name}: consistency; 1 is expected, above the band over-confident")
    shared_legend(figure, grid[0], ncols=5)
    return figure


def draw_band(axes: Axes, *, runs: int = 1) -> None:
    """Draw where 95 % of a consistent filter's NEES lie, as a mean over so many independent runs, and its mean 1."""
    low, high = chi_square_band(runs)
    axes.axhspan(low, high, color=BAND, linewidth=0, zorder=0, label="95 % of a consistent filter")
    axes.axhline(1.0, color="#888888", linewidth=0.8, zorder=1)
    clean(axes)


def nees_axis(axes: Axes, *, lowest: float = LOWEST) -> None:
    """Make the y axis logarithmic and wide enough for the band."""
    axes.set_ylim(lowest, max(axes.get_ylim()[1], HIGHEST))
    plain_log(axes, "y")


def _scored(vehicle: VehicleResult) -> dict[str, Nees]:
    """Return the NEES of each SLAM track that has ground truth and a covariance."""
    if vehicle.truth is None:
        return {}
    tracks = {name: track for name, track in tracks_of(vehicle).items() if name in WITH_COVARIANCE}
    return {name: found for name, track in tracks.items() if (found := nees(track, vehicle.truth))}


def _draw(column: NDArray[Any], tracks: dict[str, Nees]) -> None:
    start_ns = min(int(values.stamps_ns[0]) for values in tracks.values())
    for axes, part in zip(column, ROWS.values(), strict=True):
        draw_band(axes)
        for name, values in sorted(tracks.items(), reverse=True):
            style, seconds = STYLES[name], (values.stamps_ns - start_ns) / NS_PER_S
            axes.plot(seconds, getattr(values, part), label=style.label, **style.line)
        counted = (values.stamps_ns[: SKIPPED_KEYFRAMES + 1][-1] - start_ns) / NS_PER_S
        axes.axvline(counted, color="black", linewidth=0.8, linestyle=":", label="the mean counts from here")
