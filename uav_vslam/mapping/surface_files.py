# SPDX-License-Identifier: Apache-2.0
"""The files of a surface: its tiles, `height.tif` and the figures of `map.json`."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.files.geodetic import Datum
from uav_vslam.evaluation.files.writing import write_json
from uav_vslam.mapping.georeference import write_parts
from uav_vslam.mapping.overlap import Overlap
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.summary import MapFrame, map_figures
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.surface.mapper import SurfaceMapper

FIGURES = "map.json"
BANDS = "height", "sigma", "count", "view angle", "filled"  # of height.tif


def write_surface(
    grid: HeightGrid,
    overlap: Overlap,
    mapper: SurfaceMapper,
    folder: Path,
    frame: MapFrame,
    datum: Datum | None = None,
) -> dict[str, Any]:
    """Write what has been mapped so far into a folder, and return the figures of `map.json`.

    Args:
        grid: the surface.
        overlap: of all views.
        mapper: which made it.
        folder: where the files go.
        frame: of the map.
        datum: of the map frame, if known.

    Raises:
        OSError: the disk is full, or the folder can't be written.
    """
    grid.flush()
    tree = map_figures(grid, overlap, mapper.views, frame)
    tree |= {"datum": datum.figures()} if datum else {}
    tree["surface"] |= {"pairs": mapper.pairs, "refused_pairs": dict(mapper.refused)}
    if grid.extent.columns:
        write_parts(folder / "height.tif", BANDS, partial(_bands, grid), grid.extent, datum)
    write_json(folder / FIGURES, tree)
    return tree


def _bands(grid: HeightGrid, raster: Raster) -> list[NDArray[np.generic]]:
    """Return the `BANDS` of a window."""
    window = grid.window(raster)
    return [window.height, window.sigma, window.count, window.angle, window.filled]
