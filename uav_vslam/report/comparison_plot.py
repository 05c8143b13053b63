# SPDX-License-Identifier: Apache-2.0
"""Several runs in one figure: plan view, height and error over the distance flown."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from uav_vslam.evaluation.comparison import PairedRun, aligned_positions
from uav_vslam.report.layout import ALIGNMENT_TITLES
from uav_vslam.report.style import STYLES, clean, numbered_line, plain_log, save

Array = NDArray[np.float64]

MARGIN = 0.4  # of the truth's size that a diverging run may widen the view on each side; the rest is clipped
FAR_APART = 30.0  # ratio of the runs' largest errors from which the error's axis is logarithmic
PLAN_SHAPE = 0.85  # height over width of the plan view's panel
SHORT_LABEL = 28  # letters of which four fit beside each other
NAME = "comparison.png"


def write_comparison_plot(runs: Sequence[PairedRun], folder: Path, *, alignment: str, title: str) -> Path:
    """Draw the runs, aligned in the same way, into the folder; return the image's path."""
    return save(comparison_plot(runs, alignment=alignment, title=title), folder / NAME)


def comparison_plot(runs: Sequence[PairedRun], *, alignment: str, title: str) -> Figure:
    """Return the figure of runs aligned in the same way (a name of `ALIGNMENTS`)."""
    positions = [aligned_positions(run, alignment) for run in runs]
    figure = Figure(figsize=(13.0, 7.0), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    plan = figure.add_subplot(grid[:, 0])
    height, error = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    _draw_truth(runs, plan, height)
    for k, (run, estimate) in enumerate(zip(runs, positions, strict=True)):
        plan.plot(estimate[:, 0], estimate[:, 1], **numbered_line(k, width=1.3))
        height.plot(run.flown_m, estimate[:, 2], **numbered_line(k, width=1.3))
        error.plot(run.flown_m, _errors_m(run, estimate), **numbered_line(k, width=1.3))
    _finish(runs, positions, plan, height, error)
    figure.suptitle(f"{title} ({ALIGNMENT_TITLES[alignment]})")
    columns = 4 if max(len(run.run.label) for run in runs) <= SHORT_LABEL else 3
    figure.legend(handles=_legend(runs), loc="outside lower center", ncols=columns, frameon=False)
    return figure


def _draw_truth(runs: Sequence[PairedRun], plan: Axes, height: Axes) -> None:
    style = STYLES["truth"]
    for run in runs:
        x, y, _ = run.true_path.positions.T
        plan.plot(x, y, **style.line)
        height.plot(run.flown_m, run.truth.positions[:, 2], **style.line)
        plan.plot(x[0], y[0], marker="o", color="black", markersize=6, markerfacecolor="white", zorder=6)


def _finish(runs: Sequence[PairedRun], positions: Sequence[Array], plan: Axes, height: Axes, error: Axes) -> None:
    """Set limits, labels and scales."""
    low, high = _limits([run.true_path.positions for run in runs], positions)
    x, y = _filling(low[:2], high[:2])
    plan.set(xlim=x, ylim=y, xlabel="x (east) [m]", ylabel="y (north) [m]")
    plan.set_aspect("equal")
    height.set(ylim=(low[2], high[2]), ylabel="z (up) [m]")
    error.set(xlabel="Distance flown [m]", ylabel="Position error [m]")
    largest = [float(_errors_m(run, p).max()) for run, p in zip(runs, positions, strict=True)]
    if max(largest) > FAR_APART * min(largest) > 0.0:
        error.set_ylim(0.03 * min(largest), 1.5 * max(largest))
        plain_log(error, "y")
    else:
        error.set_ylim(bottom=0.0)
    for axes in (plan, height, error):
        clean(axes)


def _limits(truths: Sequence[Array], estimates: Sequence[Array]) -> tuple[Array, Array]:
    """Return the view's (3,) corners [m]: the truth, and the estimates near it."""
    truth, estimate = np.concatenate(truths), np.concatenate(estimates)
    low, high = truth.min(axis=0), truth.max(axis=0)
    size = np.maximum(high - low, 0.1 * max(float((high - low).max()), 1.0))
    low = np.maximum(np.minimum(low, estimate.min(axis=0)), low - MARGIN * size)
    high = np.minimum(np.maximum(high, estimate.max(axis=0)), high + MARGIN * size)
    return low - 0.05 * size, high + 0.05 * size


def _filling(low: Array, high: Array) -> Array:
    """Return (2, 2) limits of x and y [m] that contain the corners and fill the plan view's panel."""
    half = 0.5 * (high - low)
    half = np.maximum(half, half[::-1] * [1.0 / PLAN_SHAPE, PLAN_SHAPE])
    centre = 0.5 * (low + high)
    return np.stack([centre - half, centre + half], axis=1)


def _errors_m(run: PairedRun, positions: Array) -> Array:
    return np.asarray(np.linalg.norm(positions - run.truth.positions, axis=1))


def _legend(runs: Sequence[PairedRun]) -> list[Line2D]:
    truth = STYLES["truth"]
    lines = [Line2D([], [], label=run.run.label, **numbered_line(k, width=1.3)) for k, run in enumerate(runs)]
    start = Line2D([], [], linestyle="", marker="o", color="black", markerfacecolor="white", label="Start")
    return [Line2D([], [], label=truth.label, **truth.line), *lines, start]
