# SPDX-License-Identifier: Apache-2.0
"""What a vehicle's tables hold over time: innovations, points, claims, traffic and processor time."""

import numpy as np

from uav_vslam.evaluation.files.tables import Columns
from uav_vslam.evaluation.quality import claimed_sigma
from uav_vslam.report.page.charts import Array, Band, Chart, Line
from uav_vslam.report.page.flight import FlightFiles, VehicleFiles
from uav_vslam.report.style import STYLES

POINTS = {"features": "line-6", "tracked": "line-4", "associated": "line-2", "landmarks": "line-1"}
STAGES = {"frontend": "Front end", "backend": "Back end", "fusion": "Fusion"}
KB = 1000.0


def innovation_charts(flight: FlightFiles, vehicle: VehicleFiles) -> list[Chart]:
    """Return NIS over its degrees of freedom with its band; none without a visual update."""
    table = vehicle.tables.get("frames")
    if table is None:
        return []
    x, value = _seconds(flight, table), table.numbers("nis_per_dof")
    rows = np.flatnonzero(value > 0)
    if len(rows) == 0:
        return []
    low, high = (table.numbers(name)[rows] for name in ("band_low", "band_high"))
    chart = Chart(
        "NIS / dof",
        (
            Line("expected", "grey", x[rows[[0, -1]]], np.ones(2), width=1.0, dashed=True),
            Line("S-SLAM", "track-s_slam", x, np.where(value > 0, value, np.nan)),
        ),
        (Band("95 % band", "band", x[rows], low, high),),
        log=True,
        shades=_coasted(x, table["coasted"]),
        marks=tuple((float(at), text) for at, text in zip(x, table["events"], strict=True) if text),
    )
    return [chart]


def point_charts(flight: FlightFiles, vehicle: VehicleFiles) -> list[Chart]:
    """Return the counts of points and landmarks."""
    table = vehicle.tables.get("frames")
    if table is None:
        return []
    x = _seconds(flight, table)
    lines = tuple(Line(name, colour, x, table.numbers(name)) for name, colour in POINTS.items())
    return [Chart("Count", lines, from_zero=True)]


def sigma_charts(flight: FlightFiles, vehicle: VehicleFiles) -> list[Chart]:
    """Return the claimed standard deviations of position and heading."""
    known = {name: track for name, track in vehicle.tracks.items() if track.covariance is not None}
    position, heading = [], []
    for name, track in known.items():
        x, style = flight.seconds_of(track.stamps_ns), STYLES[name]
        position_m, heading_rad = claimed_sigma(track)
        position.append(Line(style.label, f"track-{name}", x, position_m, width=style.width))
        heading.append(Line(style.label, f"track-{name}", x, np.degrees(heading_rad), width=style.width))
    if not known:
        return []
    return [
        Chart("1σ position [m]", tuple(position), from_zero=True),
        Chart("1σ heading [deg]", tuple(heading), from_zero=True),
    ]


def calibration_charts(flight: FlightFiles, vehicle: VehicleFiles) -> list[Chart]:
    """Return the errors of the calibration that were estimated, with their standard deviations."""
    charts, table = [], vehicle.tables.get("frames")
    for name, unit, label in (("time_offset", "ms", "Time offset [ms]"), ("disparity_error", "px", "Disparity [px]")):
        if table is None or f"{name}_{unit}" not in table:  # older results lack it
            continue
        x, mean = _seconds(flight, table), table.numbers(f"{name}_{unit}")
        rows = np.flatnonzero(np.isfinite(mean))
        if len(rows) == 0:
            continue
        sigma = table.numbers(f"{name}_sigma_{unit}")[rows]
        band = Band("±1σ", "band", x[rows], mean[rows] - sigma, mean[rows] + sigma)
        charts.append(Chart(label, (Line("estimate", "track-s_slam", x, mean),), (band,)))
    return charts


def link_charts(flight: FlightFiles, vehicle: VehicleFiles) -> list[Chart]:
    """Return the traffic of each epoch and its sum; none without packets."""
    table = vehicle.tables.get("link")
    if table is None:
        return []
    start = flight.seconds_of(vehicle.tracks["s_slam"].stamps_ns[:1]) if "s_slam" in vehicle.tracks else np.zeros(0)
    x = np.append(start, _seconds(flight, table))  # nothing was sent before the first epoch began
    before = np.zeros(len(start))
    sums = {name: np.append(before, table.numbers(f"bytes_{name}") / KB) for name in ("sent", "received")}
    if not any(total.any() for total in sums.values()):
        return []
    colours = {"sent": "line-0", "received": "line-1"}
    each = (Line(name, colours[name], x, np.diff(y, prepend=0.0), stepped="before") for name, y in sums.items())
    total = (Line(name, colours[name], x, y, stepped="after") for name, y in sums.items())
    return [
        Chart("In an epoch [kB]", tuple(each), from_zero=True),
        Chart("Since the start [kB]", tuple(total), from_zero=True),
    ]


def timing_charts(flight: FlightFiles, vehicle: VehicleFiles) -> list[Chart]:
    """Return the processor time of each stage that was measured."""
    table = vehicle.tables.get("timing")
    if table is None:
        return []
    x, lines = _seconds(flight, table), []
    for k, (stage, label) in enumerate(STAGES.items()):
        if f"{stage}_ms" not in table:
            continue
        value = table.numbers(f"{stage}_ms")
        rows = np.flatnonzero(np.isfinite(value))
        if len(rows):
            lines.append(Line(label, f"line-{k}", x[rows], value[rows]))
    return [Chart("Time [ms]", tuple(lines), from_zero=True)] if lines else []


def _seconds(flight: FlightFiles, table: Columns) -> Array:
    stamps = np.array([int(cell) for cell in table["stamp_ns"]], np.int64)
    return np.asarray(flight.seconds_of(stamps), float)


def _coasted(x: Array, flags: list[str]) -> tuple[tuple[float, float], ...]:
    """Return the time of each coasted frame, back to the one before."""
    return tuple((float(x[k - 1]), float(x[k])) for k, flag in enumerate(flags) if flag == "1" and k)
