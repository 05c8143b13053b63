# SPDX-License-Identifier: Apache-2.0
"""Pictures of a map for people: the height as shaded relief, and how many views show each place."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from uav_vslam.report.style import save

Bounds = tuple[float, float, float, float]  # west, south, east, north [m]

COLOURS, COUNT_COLOURS = "viridis", "cividis"  # both of even lightness for the colour-blind
LIGHT = LightSource(azdeg=315, altdeg=45)
PERCENTILES = (0.5, 99.5)  # of the heights, between which the colours lie
STEEPENED = 2.0  # factor of the slopes in the shading
CONTRAST = 0.8  # of the shading
DARKEST = 0.35  # part of the colour that is left in the shade
WIDTH_IN, LEAST_IN, MOST_IN = 10.0, 3.0, 14.0  # of the figure; the height follows the map
MOST_CELLS = 2000  # each way that are drawn: more than the figure has pixels
TEXT_PT = 16  # legible where the page is as narrow as a telephone
SCALE_BAR_SHARE = 0.25  # of the width, at most


@dataclass(frozen=True, slots=True)
class Frame:
    """Names of the axes, and their unit."""

    x: str
    y: str
    unit: str


def frame_of(*, north: bool, unit: str = "m") -> Frame:
    """Return the axes of a map with a unit of length, whose y axis points north or somewhere else."""
    return Frame(*(("East", "North") if north else ("x", "y")), unit)


def draw_ground(
    height: NDArray[np.floating],
    counts: NDArray[np.integer],
    bounds: Bounds,
    frame: Frame,
    folder: Path,
    *,
    label: str = "Views",
) -> None:
    """Draw height.png and overlap.png into a folder.

    Args:
        height: (rows, columns) of the surface, south first; NaN where it is unknown.
        counts: views that show each cell.
        bounds: west, south, east, north.
        frame: of the map.
        folder: that of the map.
        label: what is counted.
    """
    figures = {
        "height.png": height_picture(height, bounds, frame),
        "overlap.png": overlap_picture(counts, bounds, frame, label=label),
    }
    for name, figure in figures.items():
        if figure is not None:
            save(figure, folder / name)


def height_picture(height: NDArray[np.floating], bounds_m: Bounds, frame: Frame) -> Figure | None:
    """Return the shaded relief of (rows, columns) heights [m], south first; None if none is known."""
    height, bounds_m = _thinned(height, bounds_m)
    known = np.isfinite(height)
    if not known.any():
        return None
    low, high = np.percentile(height[known], PERCENTILES)
    scale, colours = Normalize(low, max(high, low + 1e-3)), colormaps[COLOURS]
    level = np.where(known, height, np.median(height[known]))
    cell_m = (bounds_m[2] - bounds_m[0]) / height.shape[1]
    shade = LIGHT.hillshade(np.flipud(level), vert_exag=STEEPENED, dx=cell_m, dy=cell_m, fraction=CONTRAST)
    picture = colours(scale(np.flipud(level)))[..., :3] * (DARKEST + (1.0 - DARKEST) * shade[..., None])
    picture = np.dstack([np.clip(picture, 0.0, 1.0), np.flipud(known)])
    figure, axes = _figure(bounds_m, frame)
    axes.imshow(picture, extent=_extent(bounds_m), interpolation="nearest")
    _add_colours(figure, axes, ScalarMappable(scale, colours), f"Height [{frame.unit}]", extend="both")
    return figure


def overlap_picture(count: NDArray[np.integer], bounds_m: Bounds, frame: Frame, *, label: str) -> Figure | None:
    """Return the number of views of each cell, (rows, columns), south first; None if there are no views."""
    count, bounds_m = _thinned(count, bounds_m)
    if count.size == 0 or not count.any():
        return None
    figure, axes = _figure(bounds_m, frame)
    shown = np.ma.masked_equal(np.flipud(count), 0)
    drawn = axes.imshow(shown, extent=_extent(bounds_m), interpolation="nearest", cmap=COUNT_COLOURS)
    _add_colours(figure, axes, drawn, label, ticks=MaxNLocator(integer=True))
    return figure


def _thinned(values: NDArray[Any], bounds_m: Bounds) -> tuple[NDArray[Any], Bounds]:
    """Return every so many rows and columns of a large map, and the bounds of these wider cells."""
    step = -(-max(values.shape) // MOST_CELLS)
    if step <= 1:
        return values, bounds_m
    west, south, east, north = bounds_m
    (rows, columns), thinned = values.shape, values[::step, ::step]
    wide = (east - west) / columns * step, (north - south) / rows * step
    return thinned, (west, south, west + wide[0] * thinned.shape[1], south + wide[1] * thinned.shape[0])


def _add_colours(figure: Figure, axes: Axes, drawn: ScalarMappable, label: str, **options: Any) -> None:
    """Add the scale of the colours."""
    bar = figure.colorbar(drawn, ax=axes, shrink=0.8, **options)
    bar.set_label(label, size=TEXT_PT)
    bar.ax.tick_params(labelsize=TEXT_PT)


def _figure(bounds_m: Bounds, frame: Frame) -> tuple[Figure, Axes]:
    """Return a figure of the map's shape, with axes of equal scale and a scale bar."""
    west, south, east, north = bounds_m
    height_in = float(np.clip(0.8 * WIDTH_IN * (north - south) / max(east - west, 1e-9) + 1.0, LEAST_IN, MOST_IN))
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    axes = figure.add_subplot()
    axes.set(aspect="equal", xlim=(west, east), ylim=(south, north))
    axes.set_xlabel(f"{frame.x} [{frame.unit}]", size=TEXT_PT)
    axes.set_ylabel(f"{frame.y} [{frame.unit}]", size=TEXT_PT)
    axes.tick_params(labelsize=TEXT_PT)
    length = _round_length(SCALE_BAR_SHARE * (east - west))
    left, bottom = west + 0.03 * (east - west), south + 0.05 * (north - south)
    halo = [withStroke(linewidth=6, foreground="white")]  # the map may be dark there
    axes.plot(
        [left, left + length],
        [bottom, bottom],
        color="black",
        linewidth=3,
        solid_capstyle="butt",
        zorder=3,
        path_effects=halo,
    )
    text, middle = f"{length:g} {frame.unit}", (left + 0.5 * length, bottom)
    axes.annotate(text, middle, (0, 4), textcoords="offset points", ha="center", size=TEXT_PT, path_effects=halo)
    return figure, axes


def _round_length(most_m: float) -> float:
    """Return the longest of 1, 2, 5, 10, … that is not longer."""
    power = 10.0 ** np.floor(np.log10(max(most_m, 1e-9)))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= most_m * (1.0 + 1e-9)))


def _extent(bounds_m: Bounds) -> tuple[float, float, float, float]:
    west, south, east, north = bounds_m
    return west, east, south, north
