# SPDX-License-Identifier: Apache-2.0
"""Errors of a vehicle's tracks over time, with what they claim."""

import numpy as np

from uav_vslam.evaluation.consistency import chi_square_band, nees
from uav_vslam.evaluation.files.results_folder import at_equal_stamps
from uav_vslam.evaluation.output import WITH_COVARIANCE
from uav_vslam.evaluation.pairing import pair_with_truth
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.report.page.charts import Array, Band, Chart, Line
from uav_vslam.report.page.flight import FlightFiles, VehicleFiles
from uav_vslam.report.style import SIGMAS, STYLES, axes_of

LOWEST_NEES = 1e-3  # perfect poses would be at minus infinity of a logarithmic axis


def error_charts(flight: FlightFiles, vehicle: VehicleFiles) -> list[Chart]:
    """Return the error along each axis with its band; none without ground truth."""
    pairs = _pairs(vehicle)
    axes = axes_of(flight.config) if pairs else ()
    return [Chart(f"{axis} error [m]", *_errors(flight, pairs, k)) for k, axis in enumerate(axes)]


def nees_charts(flight: FlightFiles, vehicle: VehicleFiles) -> list[Chart]:
    """Return the NEES of position and attitude; none without ground truth."""
    pairs = _pairs(vehicle).items()
    values = {name: found for name, (track, _) in pairs if (found := nees(track, vehicle.tracks["truth"]))}
    if not values:
        return []
    seconds = {name: flight.seconds_of(found.stamps_ns) for name, found in values.items()}
    ends = np.array([min(x[0] for x in seconds.values()), max(x[-1] for x in seconds.values())])
    low, high = chi_square_band(1)
    band = Band("95 % band", "band", ends, np.full(2, low), np.full(2, high))
    charts = []
    for title, part in (("Position NEES / 3", "position"), ("Attitude NEES / 3", "rotation")):
        curves = {name: np.maximum(getattr(found, part), LOWEST_NEES) for name, found in values.items()}
        lines = [_line(name, seconds[name], y) for name, y in curves.items()]
        expected = Line("expected", "grey", ends, np.ones(2), width=1.0, dashed=True)
        charts.append(Chart(title, (expected, *lines), (band,), log=True))
    return charts


def _pairs(vehicle: VehicleFiles) -> dict[str, tuple[Trajectory, Trajectory]]:
    """Return each SLAM track that has ground truth, and the truth at its stamps."""
    if "truth" not in vehicle.tracks:
        return {}
    tracks = {name: track for name, track in at_equal_stamps(vehicle.tracks).items() if name in WITH_COVARIANCE}
    pairs = {name: pair_with_truth(track, vehicle.tracks["truth"]) for name, track in tracks.items()}
    return {name: pair for name, pair in pairs.items() if len(pair[0])}


def _errors(
    flight: FlightFiles, pairs: dict[str, tuple[Trajectory, Trajectory]], axis: int
) -> tuple[tuple[Line, ...], tuple[Band, ...]]:
    lines, bands = [], []
    for name, (track, truth) in pairs.items():
        seconds = flight.seconds_of(track.stamps_ns)
        lines.append(_line(name, seconds, track.positions[:, axis] - truth.positions[:, axis]))
        if track.covariance is not None:
            bound = SIGMAS * np.sqrt(np.maximum(track.covariance[:, axis, axis], 0.0))
            bands.append(Band(f"{STYLES[name].label} ±{SIGMAS:.0f}σ", f"track-{name}", seconds, -bound, bound))
    return tuple(lines), tuple(bands)


def _line(name: str, seconds: Array, values: Array) -> Line:
    style = STYLES[name]
    return Line(style.label, f"track-{name}", seconds, values, width=style.width)
