# SPDX-License-Identifier: Apache-2.0
"""Style of all plots: the thesis's colours, and the view limits."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import AutoLocator, FuncFormatter, Locator, LogLocator, NullFormatter
from numpy.typing import NDArray

from uav_vslam.evaluation.result import VehicleResult
from uav_vslam.evaluation.study import Row
from uav_vslam.evaluation.trajectory import Trajectory

Array = NDArray[np.float64]

mpl.rcParams["text.parse_math"] = False  # a $ in the name of a flight, file or setting is no formula

DPI = 150
GRID = "#d9d9d9"
BAND = "#d7ecd9"  # background of the consistent range
LINE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#555555")  # colour-blind safe
LINE_DASHES = ("-", "--", ":", "-.")
MANY_DECADES = 500.0  # largest over smallest from which a logarithmic axis shows powers of ten only
NARROW = 3.0  # largest over smallest up to which 1, 2 and 5 may leave a logarithmic axis with a single label
AXES = ("East", "North", "Up")
OWN_AXES = ("x", "y", "Up")  # of a map that begins with a start found at rest or in flight: x is where that headed
SIGMAS = 3.0  # half the width of the bands around errors
INS_MARGIN = 0.25  # the INS may widen the view by this share on each side; the rest is clipped


@dataclass(frozen=True, slots=True)
class TrackStyle:
    """Name, colour and line of one kind of track."""

    label: str
    colour: str
    width: float
    dashes: str = "-"
    order: int = 2

    @property
    def line(self) -> dict[str, Any]:
        """How `Axes.plot` is to draw it."""
        return {"color": self.colour, "linewidth": self.width, "linestyle": self.dashes, "zorder": self.order}


STYLES = {  # the ground truth is a broad line below the estimates
    "c_slam": TrackStyle("C-SLAM", "#00b8d4", 1.8, order=5),
    "smoothed": TrackStyle("Smoothed", "#ff8c00", 1.3, order=6),
    "s_slam": TrackStyle("S-SLAM", "black", 1.3, order=4),
    "ins": TrackStyle("INS", "#d62728", 1.3, "--", order=3),
    "truth": TrackStyle("Truth", "#8fa8ee", 5.0, order=2),
}


def axes_of(config: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return the names of the axes of a flight's maps, by its parameter file (which may be empty)."""
    settings = [part.get("ros__parameters", {}) for part in config.values() if isinstance(part, dict)]
    found_itself = any(own.get("start", {}).get("method") in {"static", "in_flight"} for own in settings)
    return OWN_AXES if found_itself else AXES


def name_axes(axes: Axes, config: Mapping[str, Any]) -> None:
    """Name the axes of a view from above."""
    x, y, _ = axes_of(config)
    axes.set(xlabel=f"{x} [m]", ylabel=f"{y} [m]")


def tracks_of(vehicle: VehicleResult) -> dict[str, Trajectory]:
    """Return the vehicle's tracks that have at least one pose, by name."""
    found = {name: getattr(vehicle, name) for name in STYLES}
    return {name: track for name, track in found.items() if track is not None and len(track)}


def view_limits(vehicles: list[VehicleResult]) -> tuple[Array, Array]:
    """Return the view's (3,) lower and upper corners [m]: all SLAM tracks and ground truth, and the INS near them."""
    tracks = [tracks_of(vehicle) for vehicle in vehicles]
    core = [track.positions for named in tracks for name, track in named.items() if name != "ins"]
    drift = [named["ins"].positions for named in tracks if "ins" in named]
    everything = core or drift or [np.zeros((1, 3))]
    low, high = _extent(everything)
    size = float((high - low).max()) or 1.0
    if drift:
        ins_low, ins_high = _extent(drift)
        low = np.minimum(low, np.maximum(ins_low, low - INS_MARGIN * size))
        high = np.maximum(high, np.minimum(ins_high, high + INS_MARGIN * size))
    margin = 0.07 * float((high - low).max()) or 1.0
    return low - margin, high + margin


def _extent(positions: list[Array]) -> tuple[Array, Array]:
    every = np.concatenate(positions)
    every = every[np.isfinite(every).all(axis=1)]
    return (every.min(axis=0), every.max(axis=0)) if len(every) else (np.zeros(3), np.zeros(3))


def numbered_line(number: int, *, width: float) -> dict[str, Any]:
    """Return the style of one of many lines: by colour, and by dashes once the colours are used up."""
    dashes = LINE_DASHES[number // len(LINE_COLOURS) % len(LINE_DASHES)]
    return {"color": LINE_COLOURS[number % len(LINE_COLOURS)], "linestyle": dashes, "linewidth": width}


def clean(axes: Axes) -> None:
    """Give a 2-D plot a light grid and no box."""
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow("line")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def shared_legend(figure: Figure, panels: Iterable[Axes], *, above: bool = False, **options: Any) -> None:
    """Add a legend below or above the whole figure, of what some panels show, each label once."""
    shown = {label: line for axes in panels for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    options |= {"loc": "outside upper center" if above else "outside lower center", "frameon": False}
    figure.legend(shown.values(), shown.keys(), **options)


def plain_log(axes: Axes, which: str) -> None:
    """Make the "x" or "y" axis logarithmic, with plain tick labels; one without any value above zero stays linear.

    They are at 1, 2, 5; over many decades at powers of ten, and over a narrow range evenly spaced.
    """
    axes.set(**{f"{which}scale": "log"})
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axis.get_view_interval()
    if low <= 0.0:
        axes.set(**{f"{which}scale": "linear"})
        return
    subs = (1.0, 2.0, 5.0) if high <= MANY_DECADES * low else (1.0,)
    locator: Locator = AutoLocator() if high <= NARROW * low else LogLocator(subs=subs, numticks=12)
    axis.set_major_locator(locator)
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def column(rows: Sequence[Row], key: str) -> list[float]:
    """Return the rows' values of a key, NaN for None."""
    return [float("nan") if row[key] is None else row[key] for row in rows]


def save(figure: Figure, path: Path) -> Path:
    """Write an image without date and version, so that the same figure gives the same bytes."""
    figure.savefig(path, dpi=DPI, bbox_inches="tight", pad_inches=0.15, metadata={"Software": None})
    return path
