# SPDX-License-Identifier: Apache-2.0
"""How all plots look: the thesis's colours, and the part of the world worth showing."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from uav_vslam.evaluation.result import VehicleResult
from uav_vslam.evaluation.study import Row
from uav_vslam.evaluation.trajectory import Trajectory

Array = NDArray[np.float64]

DPI = 150
GRID = "#d9d9d9"
BAND = "#d7ecd9"  # behind figures that are as they should be
LINE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#555555")  # told apart by all eyes
MANY_DECADES = 500.0  # largest over smallest above which a logarithmic axis has room for powers of ten only
INS_MARGIN = 0.25  # the INS may widen the view by this share on each side; what lies beyond is cut off


@dataclass(frozen=True, slots=True)
class TrackStyle:
    """Name, colour and line of one kind of track."""

    label: str
    colour: str
    width: float
    dashes: str = "-"
    order: int = 2


STYLES = {  # the truth is a broad ribbon under the estimates
    "c_slam": TrackStyle("C-SLAM", "#00b8d4", 1.8, order=5),
    "s_slam": TrackStyle("S-SLAM", "black", 1.3, order=4),
    "ins": TrackStyle("INS", "#d62728", 1.3, "--", order=3),
    "truth": TrackStyle("Truth", "#8fa8ee", 5.0, order=2),
}


def tracks_of(vehicle: VehicleResult) -> dict[str, Trajectory]:
    """Return the tracks that the vehicle has and that hold a pose, by name."""
    found = {name: getattr(vehicle, name) for name in STYLES}
    return {name: track for name, track in found.items() if track is not None and len(track)}


def view_limits(vehicles: list[VehicleResult]) -> tuple[Array, Array]:
    """Return the (3,) lower and upper corner of what is worth showing [m]: all SLAM and truth, and INS near them."""
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


def clean(axes: Axes) -> None:
    """Give a flat plot a light grid and no box."""
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow("line")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def plain_log(axes: Axes, which: str) -> None:
    """Make the "x" or "y" axis logarithmic, with ticks written out: at 1, 2, 5, or at 1 over many decades."""
    axes.set(**{f"{which}scale": "log"})
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axis.get_view_interval()
    subs = (1.0, 2.0, 5.0) if high <= MANY_DECADES * low else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def column(rows: Sequence[Row], key: str) -> list[float]:
    """Return what rows hold under a key, NaN where that is nothing."""
    return [float("nan") if row[key] is None else row[key] for row in rows]


def save(figure: Figure, path: Path) -> Path:
    """Write a picture; no date and no version inside, so that the same figures give the same bytes."""
    figure.savefig(path, dpi=DPI, bbox_inches="tight", pad_inches=0.15, metadata={"Software": None})
    return path
