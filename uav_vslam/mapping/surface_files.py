# SPDX-License-Identifier: Apache-2.0
"""The files of a surface: its tiles, `height.tif` and the figures of `map.json`."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.files.geodetic import Datum
from uav_vslam.evaluation.files.writing import write_json
from uav_vslam.mapping.georeference import write_bands
from uav_vslam.mapping.overlap import Overlap
from uav_vslam.mapping.summary import map_figures
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.surface.mapper import SurfaceMapper

FIGURES = "map.json"


def write_surface(
    grid: HeightGrid, overlap: Overlap, mapper: SurfaceMapper, folder: Path, datum: Datum | None = None
) -> dict[str, Any]:
    """Write what has been mapped so far into a folder, and return the figures of `map.json`.

    Args:
        grid: the surface.
        overlap: of all views.
        mapper: which made it.
        folder: where the files go.
        datum: of the map frame, if known.

    Raises:
        OSError: the disk is full, or the folder can't be written.
    """
    grid.flush()
    tree = map_figures(grid, overlap, mapper.views)
    tree |= {"datum": datum.figures()} if datum else {}
    tree["surface"] |= {"pairs": mapper.pairs, "refused_pairs": dict(mapper.refused)}
    if grid.extent.columns:
        window = grid.window(grid.extent)
        bands: dict[str, NDArray[np.generic]] = {
            "height": window.height,
            "sigma": window.sigma,
            "count": window.count,
            "view angle": window.angle,
            "filled": window.filled,
        }
        write_bands(folder / "height.tif", bands, window.raster, datum)
    write_json(folder / FIGURES, tree)
    return tree
