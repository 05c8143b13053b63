# SPDX-License-Identifier: Apache-2.0
"""Plan view of the landmarks with their ellipses, along the estimated path."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from uav_vslam.evaluation.result import FlightResult
from uav_vslam.report.style import LINE_COLOURS, clean, name_axes
from uav_vslam.types import MappedLandmarks

Array = NDArray[np.float64]
Maps = dict[str, MappedLandmarks]

MOST_ELLIPSES = 400  # of a vehicle: more would hide each other
LEAST_SHARE = 0.008  # of the view: the median ellipse is drawn at least so long
STRETCHES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
INNER_PERCENTILES = (1.0, 99.0)  # of the landmarks: the few that are badly triangulated don't set the view


def landmark_view(result: FlightResult) -> Figure | None:
    """Return the view from above; None where the map was not recorded.

    A landmark is a dot where S-SLAM last estimated it at an epoch. Some of them, evenly over the flight, have their
    1-sigma ellipse. Ellipses too small to be seen are all drawn larger by one factor, which the title states.
    """
    maps = known_landmarks(result)
    if not maps:
        return None
    paths = {name: result.vehicles[name].s_slam.positions[:, :2] for name in maps}
    low, high = _limits([*paths.values()], [landmarks.positions[:, :2] for landmarks in maps.values()])
    aspect = float((high[1] - low[1]) / (high[0] - low[0]))
    figure = Figure(figsize=(10.0, float(np.clip(10.0 * aspect, 4.0, 12.0)) + 1.0), layout="constrained")
    axes = figure.add_subplot()
    stretch = draw_landmarks(axes, maps, float((high - low).max()))
    for name, colour in _colours(maps).items():
        _draw_path(axes, paths[name], colour)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    name_axes(axes, result.config)
    axes.set_title(f"{result.name}: S-SLAM's landmarks{ellipse_text(stretch)}")
    clean(axes)
    handles = [
        Line2D([], [], color=_colours(maps)[name], label=f"{name}: {len(landmarks)} landmarks")
        for name, landmarks in maps.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure


def known_landmarks(result: FlightResult) -> Maps:
    """Return the landmarks of each vehicle whose map was recorded."""
    return {name: vehicle.landmarks for name, vehicle in result.vehicles.items() if vehicle.landmarks}


def draw_landmarks(axes: Axes, maps: Maps, size_m: float) -> int:
    """Draw landmarks and their ellipses in a view of that size; return how many times as large the ellipses are."""
    ellipses = {name: horizontal_ellipses(landmarks.covariances) for name, landmarks in maps.items()}
    lengths = [semi_axes[:, 0] for semi_axes, _ in ellipses.values()]
    stretch = _stretch(np.concatenate(lengths), size_m) if lengths else 1
    for name, colour in _colours(maps).items():
        _draw(axes, maps[name], ellipses[name], colour, stretch)
    return stretch


def ellipse_text(stretch: int) -> str:
    """Return what the title says of the ellipses."""
    return ", 1-sigma ellipses" + ("" if stretch == 1 else f" drawn {stretch} times as large")


def landmark_handles(maps: Maps) -> list[Line2D]:
    """Return an entry of the legend for each vehicle's landmarks."""
    dots: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 4, "markerfacecolor": "none"}
    return [Line2D([], [], color=colour, label=f"Map of {name}", **dots) for name, colour in _colours(maps).items()]


def inner_limits(points: Sequence[Array]) -> tuple[Array, Array]:
    """Return lower and upper corner of all but the outermost of several sets of (N, D) points [m]."""
    inner = np.concatenate([np.percentile(some, INNER_PERCENTILES, axis=0) for some in points])
    return inner.min(axis=0), inner.max(axis=0)


def _colours(maps: Maps) -> dict[str, str]:
    return {name: LINE_COLOURS[k % len(LINE_COLOURS)] for k, name in enumerate(maps)}


def _draw(axes: Axes, landmarks: MappedLandmarks, ellipses: tuple[Array, Array], colour: str, stretch: int) -> None:
    """Draw one vehicle's landmarks and some of their ellipses."""
    rows = np.linspace(0, len(landmarks) - 1, min(len(landmarks), MOST_ELLIPSES)).astype(int)
    semi_axes, angles_deg = (values[rows] for values in ellipses)
    lengths = 2.0 * stretch * semi_axes
    axes.add_collection(
        EllipseCollection(
            lengths[:, 0],
            lengths[:, 1],
            angles_deg,
            units="xy",
            offsets=landmarks.positions[rows, :2],
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors=colour,
            linewidths=0.6,
        )
    )
    axes.plot(*landmarks.positions[:, :2].T, ".", color=colour, markersize=1.5)


def _draw_path(axes: Axes, path: Array, colour: str) -> None:
    axes.plot(*path.T, color="white", linewidth=4.5)  # a rim, so that the path stands out
    axes.plot(*path.T, color=colour, linewidth=2.0)
    axes.plot(*path[0], marker="o", color=colour, markerfacecolor="white", markersize=6)


def horizontal_ellipses(covariances: Array) -> tuple[Array, Array]:
    """Return the (N, 2) standard deviations along the axes of the horizontal ellipses, the longer first, and (N,) the
    angle of the longer one from east [deg].
    """
    values, vectors = np.linalg.eigh(covariances[:, :2, :2])
    longer = vectors[:, :, 1]
    return np.sqrt(np.maximum(values[:, ::-1], 0.0)), np.degrees(np.arctan2(longer[:, 1], longer[:, 0]))


def _limits(paths: list[Array], landmarks: list[Array]) -> tuple[Array, Array]:
    every = np.concatenate([*paths, np.array(inner_limits(landmarks))])
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.05 * float((high - low).max()) or 1.0
    return low - margin, high + margin


def _stretch(sigma_m: Array, size_m: float) -> int:
    """Return by how much ellipses are enlarged so that the median one is visible."""
    length = 2.0 * float(np.median(sigma_m))
    return next((factor for factor in STRETCHES if factor * length >= LEAST_SHARE * size_m), STRETCHES[-1])
