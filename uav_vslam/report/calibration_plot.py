# SPDX-License-Identifier: Apache-2.0
"""Where a board's corners fell on the images, their residuals, and the error of each pair."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uav_vslam.calibration.procedure import CELLS, StereoCalibration, cells, coverage
from uav_vslam.calibration.solve import rms
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.report.style import LINE_COLOURS, clean, save

Array = NDArray[np.float64]

ARROW_SHARE = 0.03  # of the image width: length of a vector of RMS size
EMPTY = "#e6e6e6"  # cells of the image without a corner


def write_calibration_plot(found: StereoCalibration, name: str, folder: Path) -> Path:
    """Draw into `calibration.png`; return its path."""
    return save(calibration_plot(found, name), folder / "calibration.png")


def calibration_plot(found: StereoCalibration, name: str) -> Figure:
    """Return both images with corners and magnified residuals, and below them the error of each pair.

    Args:
        found: the calibration.
        name: for the title.
    """
    camera = found.solution.rig.left
    figure = Figure(figsize=(13.0, 3.4 + 6.2 * camera.height / camera.width), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=[6.2 * camera.height / camera.width, 2.4])
    overall = rms([part for pair in found.solution.residuals for part in pair])
    magnified = max(1.0, float(f"{ARROW_SHARE * camera.width / overall:.1g}"))
    for side in range(2):
        _draw_image(figure.add_subplot(grid[0, side]), found, side, magnified)
    _draw_errors(figure.add_subplot(grid[1, :]), found)
    figure.suptitle(f"{name}: corners, residuals x {magnified:g} (+ principal point, grey: no corner)")
    return figure


def _draw_image(axes: Axes, found: StereoCalibration, side: int, magnified: float) -> None:
    name = SIDES[side]
    camera = getattr(found.solution.rig, name)
    pixels = np.concatenate([getattr(pair, name).pixels for pair in found.pairs])
    residuals = np.concatenate([pair[side] for pair in found.solution.residuals])
    filled = np.zeros((CELLS, CELLS))
    column, row = cells(pixels, camera).T
    filled[row, column] = 1.0
    extent = (0, camera.width, camera.height, 0)
    axes.imshow(filled, extent=extent, cmap=ListedColormap([EMPTY, "white"]), vmin=0, vmax=1, zorder=0)
    axes.quiver(
        *pixels.T,
        *(magnified * residuals).T,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.0015,
        color=LINE_COLOURS[1],
    )
    axes.plot(*pixels.T, ".", color=LINE_COLOURS[0], markersize=2.0)
    axes.plot(camera.cx, camera.cy, "+", color="black", markersize=12)
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
    axes.set_title(
        f"{name}: {rms([residuals]):.3f} px rms, corners in {100 * coverage(found, name):.0f} % of the cells"
    )


def _draw_errors(axes: Axes, found: StereoCalibration) -> None:
    places = np.arange(len(found.pairs))
    clean(axes)
    for side, name in enumerate(SIDES):
        errors = [rms([pair[side]]) for pair in found.solution.residuals]
        axes.bar(places + 0.4 * (side - 0.5), errors, 0.38, color=LINE_COLOURS[side], label=name)
    axes.set_xticks(places, [pair.name for pair in found.pairs], rotation=90, fontsize=7)
    axes.set(xlabel="Pair", ylabel="Reprojection [px]", xlim=(-0.7, len(places) - 0.3))
    axes.legend(loc="upper right", ncols=2, frameon=False)
