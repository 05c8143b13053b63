# SPDX-License-Identifier: Apache-2.0
"""Plan view of a flight: tracks above the landmarks."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from uav_vslam.evaluation.result import FlightResult
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.report.landmark_view import (
    draw_landmarks,
    ellipse_text,
    inner_limits,
    known_landmarks,
    landmark_handles,
)
from uav_vslam.report.style import STYLES, clean, name_axes, tracks_of, view_limits

Array = NDArray[np.float64]

MAX_POINTS = 3000  # of a drawn line: more of a 200 Hz INS would not be visible
MARGIN = 0.03  # of the size, around the landmarks
LABEL_PT = 9.0  # from a vehicle's start to its name
LOWEST_IN, HIGHEST_IN = 2.2, 11.0  # of the axes


def plan_view(result: FlightResult) -> Figure:
    """Return the view from above with equal scales; landmarks have 1-sigma ellipses where they are known."""
    low, high = view_limits(list(result.vehicles.values()))
    maps = known_landmarks(result)
    if maps:
        inner_low, inner_high = inner_limits([landmarks.positions for landmarks in maps.values()])
        margin = MARGIN * float((high - low).max())
        low, high = np.minimum(low, inner_low - margin)[:2], np.maximum(high, inner_high + margin)[:2]
    aspect = float((high[1] - low[1]) / (high[0] - low[0]))
    figure = Figure(figsize=(9.0, float(np.clip(8.0 * aspect, LOWEST_IN, HIGHEST_IN)) + 1.3), layout="constrained")
    axes = figure.add_subplot()
    stretch = draw_landmarks(axes, maps, float((high - low).max()))
    for vehicle in result.vehicles.values():
        for name, track in tracks_of(vehicle).items():
            points = _thin(track)
            axes.plot(points[:, 0], points[:, 1], **STYLES[name].line)
        _mark_ends(axes, vehicle.name, vehicle.truth or vehicle.s_slam)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    name_axes(axes, result.config)
    axes.set_title(f"{result.name}: plan view{ellipse_text(stretch) if maps else ''}")
    clean(axes)
    handles = [*_legend(result), *landmark_handles(maps)]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(7, len(handles)), frameon=False)
    return figure


def _thin(track: Trajectory) -> Array:
    step = max(1, len(track) // MAX_POINTS)
    rows = np.unique(np.append(np.arange(0, len(track), step), len(track) - 1))
    return track.positions[rows]


def _mark_ends(axes: Axes, name: str, track: Trajectory) -> None:
    """Mark start and end, and write the vehicle's name behind the start, where its track is not."""
    if len(track) == 0:
        return
    start, end = track.positions[0, :2], track.positions[-1, :2]
    axes.plot(*start, marker="o", color="black", markersize=6, markerfacecolor="white", zorder=6)
    axes.plot(*end, marker="s", color="black", markersize=5, zorder=6)
    ahead = track.positions[len(track) // 20, :2] - start
    behind = -LABEL_PT * ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    side = "right" if behind[0] < -0.3 * LABEL_PT else "left" if behind[0] > 0.3 * LABEL_PT else "center"
    where: dict[str, Any] = {"xy": start, "xytext": behind, "textcoords": "offset points"}
    label = axes.annotate(name, **where, ha=side, va="center", zorder=7)
    label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])  # no box, which would hide what is below


def _legend(result: FlightResult) -> list[Line2D]:
    present = {name for vehicle in result.vehicles.values() for name in tracks_of(vehicle)}
    shown = [name for name in ("truth", "c_slam", "s_slam", "smoothed", "ins") if name in present]
    lines = [Line2D([], [], label=STYLES[name].label, **STYLES[name].line) for name in shown]
    start = Line2D([], [], linestyle="", marker="o", color="black", markerfacecolor="white", label="Start")
    return [*lines, start, Line2D([], [], linestyle="", marker="s", color="black", label="End")]
