# SPDX-License-Identifier: Apache-2.0
"""Plots of a mosaic of plain pictures: heights, and how many pictures show each place."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.report.height_picture import Bounds, Frame, height_picture, overlap_picture
from uav_vslam.report.mosaic_table import unit_of
from uav_vslam.report.style import save


def draw_ground(
    height: NDArray[np.floating], counts: NDArray[np.integer], bounds: Bounds, frame: Frame, folder: Path
) -> None:
    """Draw height.png and overlap.png into a folder.

    Args:
        height: (rows, columns) of the surface, south first.
        counts: pictures that show each cell.
        bounds: west, south, east, north.
        frame: of the map.
        folder: that of the map.
    """
    figures = {
        "height.png": height_picture(np.where(counts > 0, height, np.nan), bounds, frame),
        "overlap.png": overlap_picture(counts, bounds, frame, label="Pictures"),
    }
    for name, figure in figures.items():
        if figure is not None:
            save(figure, folder / name)


def frame_of(scale: str, *, north: bool) -> Frame:
    """Return the axes of a mosaic with a scale as in mosaic.json, whose north is known or not."""
    return Frame(*(("East", "North") if north else ("x", "y")), unit_of(scale))
