# SPDX-License-Identifier: Apache-2.0
"""The orthomosaic of a reconstruction, its files and its seams."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.files.writing import write_json
from uav_vslam.mapping.georeference import write_bands
from uav_vslam.mapping.orthomosaic import blended_mosaic
from uav_vslam.mapping.orthomosaic.output import write_orthomosaic
from uav_vslam.mapping.orthomosaic.seams import seams
from uav_vslam.mapping.pictures.output import map_figures, seam_figures
from uav_vslam.mapping.pictures.reconstruction import Reconstruction
from uav_vslam.mapping.pictures.views import PictureViews
from uav_vslam.mapping.progress import counted

Figures = dict[str, Any]

PASSES = 3  # over all pictures: brightness, picture, seams


def draw(
    found: Reconstruction,
    counts: NDArray[np.uint16],
    pixel_m: float,
    folder: Path,
    *,
    on_view: Callable[[], None] = lambda: None,
) -> Figures:
    """Write the orthomosaic, heights and map.json into a folder; return size, pixel and seams of the mosaic.

    Args:
        found: poses and surface.
        counts: (rows, columns) pictures that show each cell of the surface; where none does, no height is known.
        pixel_m: side of the mosaic's pixels [m].
        folder: where the files go.
        on_view: called `PASSES` times for each picture used.
    """
    views = PictureViews(found.pictures, found.adjusted)
    datum = found.placement.datum
    with TemporaryDirectory(dir=folder, prefix="tiles_") as tiles:
        mosaic = blended_mosaic(lambda: iter(views), found.surface, pixel_m, folder=Path(tiles), on_view=on_view)
        picture = mosaic.picture()
        drawn = write_orthomosaic(mosaic, picture, folder, datum)
        seam = seam_figures(seams(mosaic, picture, counted(views, on_view)))
    heights = np.where(counts > 0, found.surface.grid, np.nan)
    write_bands(folder / "height.tif", {"height": heights}, found.surface.raster, datum)
    size = {key: drawn[key] for key in ("m_per_px", "width", "height")}
    tree = map_figures(found, heights) | {"orthomosaic": size | {"seam_px": seam["median_px"]}}
    write_json(folder / "map.json", tree)
    return size | {"seam": seam}
