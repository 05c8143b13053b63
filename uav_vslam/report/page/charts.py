# SPDX-License-Identifier: Apache-2.0
"""Charts over time as data for the page's script."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Data = dict[str, Any]

MOST_POINTS = 3000  # of the lines of all vehicles together; more would not be visible
LEAST_POINTS = 150  # of a line, however many vehicles there are
DIGITS = 5  # significant ones of a value


@dataclass(frozen=True, slots=True)
class Line:
    """A curve.

    Attributes:
        label: in the legend.
        colour: name of a colour of the page's palette.
        x, y: (N,) times [s] and values; NaN leaves a gap.
        width: of the line [px]; 0 draws points only.
        dashed: not solid.
        stepped: "after" if a value holds until the next, "before" if it is of the time since the last; "" for neither.
    """

    label: str
    colour: str
    x: Array
    y: Array
    width: float = 1.5
    dashed: bool = False
    stepped: str = ""


@dataclass(frozen=True, slots=True)
class Band:
    """The area between two curves.

    Attributes:
        label: in the legend.
        colour: name of a colour of the page's palette.
        x, low, high: (N,) times [s] and bounds.
    """

    label: str
    colour: str
    x: Array
    low: Array
    high: Array


@dataclass(frozen=True, slots=True)
class Chart:
    """Curves with one axis of values over time.

    Attributes:
        title: of the axis, with the unit.
        lines, bands: what it shows; bands lie below.
        log: whether the axis is logarithmic.
        from_zero: whether the axis includes zero.
        shades: intervals of time [s] that are marked.
        marks: times [s] with the text of what happened then.
    """

    title: str
    lines: tuple[Line, ...]
    bands: tuple[Band, ...] = ()
    log: bool = False
    from_zero: bool = False
    shades: tuple[tuple[float, float], ...] = ()
    marks: tuple[tuple[float, str], ...] = ()


def points_of_each(vehicles: int, most: int = MOST_POINTS) -> int:
    """Return how many points a line of each of so many vehicles may have."""
    return max(LEAST_POINTS, most // max(vehicles, 1))


def chart_data(chart: Chart, most: int = MOST_POINTS) -> Data:
    """Return the chart as the page's script expects it, its lines with about so many points at most."""
    return {
        "title": chart.title,
        "log": chart.log,
        "zero": chart.from_zero,
        "lines": [_line(line, most) for line in chart.lines],
        "bands": [_band(band, most) for band in chart.bands],
        "shades": [numbers(shade) for shade in chart.shades],
        "marks": [{"x": round(x, 3), "text": text} for x, text in chart.marks],
    }


def numbers(values: ArrayLike, *, decimals: int | None = None) -> list[float | None]:
    """Return values as short as they may be in JSON, None for one that is not finite.

    Args:
        values: (N,) numbers.
        decimals: digits after the point; without it, `DIGITS` significant ones.
    """
    form = f".{DIGITS}g" if decimals is None else f".{decimals}f"
    return [_short(float(f"{value:{form}}")) if np.isfinite(value) else None for value in np.asarray(values, float)]


def thinned(count: int, most: int) -> NDArray[np.intp]:
    """Return at most about so many of `count` rows, evenly, the last among them."""
    step = max(1, -(-count // most))
    return np.unique(np.append(np.arange(0, count, step), count - 1)) if count else np.zeros(0, np.intp)


def _short(value: float) -> float:
    return int(value) if value.is_integer() and abs(value) < 1e15 else value


def _line(line: Line, most: int) -> Data:
    rows = thinned(len(line.x), most)
    return {
        "label": line.label,
        "colour": line.colour,
        "width": line.width,
        "dashed": line.dashed,
        "stepped": line.stepped,
        "x": numbers(line.x[rows], decimals=4),
        "y": numbers(line.y[rows]),
    }


def _band(band: Band, most: int) -> Data:
    rows = thinned(len(band.x), most)
    values = {"x": numbers(band.x[rows], decimals=4), "low": numbers(band.low[rows]), "high": numbers(band.high[rows])}
    return {"label": band.label, "colour": band.colour, **values}
