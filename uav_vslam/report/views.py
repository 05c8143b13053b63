# SPDX-License-Identifier: Apache-2.0
"""Plan view and 3-D view of a flight."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from uav_vslam.evaluation.result import FlightResult
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.report.style import STYLES, clean, tracks_of, view_limits

Array = NDArray[np.float64]

MAX_POINTS = 3000  # of a drawn line: more of a 200 Hz INS would not be visible
LABEL_BOX = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}


def plan_view(result: FlightResult) -> Figure:
    """Return the view from above, north up."""
    low, high = view_limits(list(result.vehicles.values()))
    aspect = float((high[1] - low[1]) / (high[0] - low[0]))
    figure = Figure(figsize=(9.0, float(np.clip(9.0 * aspect, 4.0, 11.0)) + 1.0), layout="constrained")
    axes = figure.add_subplot()
    for vehicle in result.vehicles.values():
        for name, track in tracks_of(vehicle).items():
            points = _thin(track)
            axes.plot(points[:, 0], points[:, 1], **_line(name))
        _mark_ends_flat(axes, vehicle.name, vehicle.truth or vehicle.s_slam)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="East [m]", ylabel="North [m]", aspect="equal")
    axes.set_title(f"{result.name}: plan view")
    clean(axes)
    figure.legend(handles=_legend(result), loc="outside lower center", ncols=7, frameon=False)
    return figure


def view_3d(result: FlightResult) -> Figure:
    """Return the 3-D view."""
    low, high = view_limits(list(result.vehicles.values()))
    figure = Figure(figsize=(10.0, 7.0))
    axes: Any = figure.add_axes((0.0, 0.04, 1.0, 0.96), projection="3d")
    for vehicle in result.vehicles.values():
        for name, track in tracks_of(vehicle).items():
            axes.plot(*_inside(_thin(track), low, high).T, clip_on=False, **_line(name))
        _mark_ends_3d(axes, vehicle.name, vehicle.truth or vehicle.s_slam)
    # A flight is far wider than high: exaggerate the height until it can be seen.
    size = high - low
    box = np.maximum(size, 0.25 * size.max())
    axes.set_box_aspect(box, zoom=1.25)  # larger than the axes' rectangle: lines must not be clipped to it
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_xlabel("East [m]", labelpad=10)
    axes.set_ylabel("North [m]", labelpad=10)
    axes.set_zlabel("Up [m]", labelpad=6)
    axes.view_init(elev=28, azim=-60)
    stretch = box[2] / size[2]
    title = result.name + (f" (height drawn {stretch:.1f}x)" if stretch > 1.05 else "")
    figure.text(0.5, 0.94, title, ha="center", fontsize="large")
    figure.legend(handles=_legend(result), loc="lower center", ncols=7, frameon=False)
    return figure


def _thin(track: Trajectory) -> Array:
    step = max(1, len(track) // MAX_POINTS)
    rows = np.unique(np.append(np.arange(0, len(track), step), len(track) - 1))
    return track.positions[rows]


def _inside(points: Array, low: Array, high: Array) -> Array:
    """Return the points with NaN for those out of view, which 3-D axes don't clip."""
    seen = np.asarray(((points >= low) & (points <= high)).all(axis=1))
    return np.where(seen[:, None], points, np.nan)


def _line(name: str) -> dict[str, Any]:
    style = STYLES[name]
    return {
        "color": style.colour,
        "linewidth": style.width,
        "linestyle": style.dashes,
        "zorder": style.order,
    }


def _mark_ends_flat(axes: Any, name: str, track: Trajectory) -> None:
    if len(track) == 0:
        return
    start, end = track.positions[0, :2], track.positions[-1, :2]
    axes.plot(*start, marker="o", color="black", markersize=6, markerfacecolor="white", zorder=6)
    axes.plot(*end, marker="s", color="black", markersize=5, zorder=6)
    ahead = track.positions[len(track) // 20, :2] - start
    beside = 11.0 * np.array([-ahead[1], ahead[0]]) / max(float(np.linalg.norm(ahead)), 1e-9)  # [pt]
    side = "right" if beside[0] < 0 else "left"
    axes.annotate(
        name, start, xytext=beside, textcoords="offset points", ha=side, va="center", bbox=LABEL_BOX, zorder=7
    )


def _mark_ends_3d(axes: Any, name: str, track: Trajectory) -> None:
    if len(track) == 0:
        return
    start, end = track.positions[0], track.positions[-1]
    axes.plot(
        *start[:, None], marker="o", color="black", markersize=6, markerfacecolor="white", zorder=6, clip_on=False
    )
    axes.plot(*end[:, None], marker="s", color="black", markersize=5, zorder=6, clip_on=False)
    axes.text(*start, f"{name}   ", ha="right", va="bottom", zorder=7)


def _legend(result: FlightResult) -> list[Line2D]:
    present = {name for vehicle in result.vehicles.values() for name in tracks_of(vehicle)}
    shown = [name for name in ("truth", "c_slam", "s_slam", "smoothed", "ins") if name in present]
    lines = [Line2D([], [], label=STYLES[name].label, **_line(name)) for name in shown]
    start = Line2D([], [], linestyle="", marker="o", color="black", markerfacecolor="white", label="Start")
    return [*lines, start, Line2D([], [], linestyle="", marker="s", color="black", label="End")]
