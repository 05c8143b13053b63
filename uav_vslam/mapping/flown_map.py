# SPDX-License-Identifier: Apache-2.0
"""The map of one vehicle while it flies: surface, overlap and orthomosaic, saved as it grows."""

import math
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.files.writing import write_json
from uav_vslam.mapping.orthomosaic.heights import GridHeights
from uav_vslam.mapping.orthomosaic.in_flight import FlownOrthomosaic
from uav_vslam.mapping.orthomosaic.mosaic import Orthomosaic
from uav_vslam.mapping.orthomosaic.output import write_orthomosaic
from uav_vslam.mapping.overlap import Overlap
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.summary import MapFrame
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.surface.mapper import SurfaceMapper
from uav_vslam.mapping.surface.settings import SurfaceSettings
from uav_vslam.mapping.surface.tiles import TILES
from uav_vslam.mapping.surface_files import FIGURES, write_surface
from uav_vslam.mapping.tile_store import SIDE
from uav_vslam.mapping.view import View

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

UNSEEN_GREY = 128  # of ground with a height that no key frame has shown yet
LEAST_SEEN = 0.25  # of a cell
MOST_CELLS = 4_000_000  # in the tiles of the map; about half of them have a height


class FlownMap:
    """What a vehicle has flown over so far.

    Attributes:
        grid: the surface.
        mapper: which makes it.
        overlap: of all views.
    """

    def __init__(self, folder: Path | None, frame: MapFrame, *, cell_m: float, pixel_m: float) -> None:
        """Begin an empty map.

        Args:
            folder: a new one, for tiles and files; None keeps all in memory.
            frame: of the poses.
            cell_m: side of a cell of the height grid [m].
            pixel_m: side of a pixel of the orthomosaic [m]; 0 makes none.

        Raises:
            UavVslamError: the folder holds a map already.
        """
        settings = SurfaceSettings()
        self.folder, self._frame = folder, frame
        self.grid = HeightGrid(cell_m, folder / TILES if folder else None)
        self.mapper, self.overlap = SurfaceMapper(self.grid, settings), Overlap()
        self._scratch = TemporaryDirectory(dir=folder, prefix="mosaic_") if folder and pixel_m else None
        tiles = Path(self._scratch.name) if self._scratch else None
        self._picture = None
        if pixel_m:
            mosaic = Orthomosaic(GridHeights(self.grid), pixel_m, folder=tiles)
            self._picture = FlownOrthomosaic(mosaic, settled_ratio=settings.longest_ratio)

    def add(self, view: View) -> None:
        """Add the next view."""
        self.mapper.add_view(view)
        self.overlap.add(view)
        ground_m = self.mapper.ground_m(view.vehicle)
        if self._picture is not None and ground_m is not None:
            self._picture.add(view, ground_m)

    @property
    def stride(self) -> int:
        """In steps of how many cells a live view shows the map: more than one where it has more than `MOST_CELLS`."""
        return max(1, math.ceil(math.sqrt(self.grid.tiles * SIDE**2 / MOST_CELLS)))

    def coloured(self) -> tuple[Array, Bytes]:
        """Return (N, 3) centres of cells with a height [m], in steps of `stride`, and their (N, 3) colours, BGR."""
        points = [window.points(self.stride) for window in self.grid.windows()]
        colours = [self._colours(some) for some in points]
        return np.concatenate([np.zeros((0, 3)), *points]), np.concatenate([np.zeros((0, 3), np.uint8), *colours])

    def save(self) -> dict[str, Any]:
        """Write all files of the map so far, and return the figures of `map.json`.

        Raises:
            UavVslamError: the map is in memory only, or the picture can't be written.
            OSError: the disk is full, or the folder can't be written.
        """
        if self.folder is None:
            raise UavVslamError("the parameter map.folder is empty; start the mapper with a folder to write to")
        tree = write_surface(self.grid, self.overlap, self.mapper, self.folder, self._frame)
        if self._drawn:
            tree["orthomosaic"] = write_orthomosaic(self._drawn, self._drawn.picture(), self.folder)
            write_json(self.folder / FIGURES, tree)
        return tree

    def finish(self) -> None:
        """Map what only the last views show, and draw the last key frames: nothing is added any more."""
        self.mapper.finish()
        if self._picture is not None:
            self._picture.finish()

    def close(self) -> None:
        """Remove what only the running map needs."""
        if self._scratch is not None:
            self._scratch.cleanup()

    @property
    def _drawn(self) -> Orthomosaic | None:
        """The picture, if there is any of it yet."""
        return self._picture.mosaic if self._picture is not None and self._picture.mosaic.views else None

    def _colours(self, points: Array) -> Bytes:
        """Return (N, 3) mean colours of the picture around points that are near each other."""
        if self._drawn is None or len(points) == 0:
            return np.full((len(points), 3), UNSEEN_GREY, np.uint8)
        side = max(1, round(self.grid.cell_m / self._drawn.m_per_px))
        picture = self._drawn.picture(Raster.covering(points, self._drawn.m_per_px).grown(side))
        seen = cv2.blur(picture.seen.astype(np.float32), (side, side))
        total = cv2.blur(picture.image.astype(np.float32), (side, side)).reshape(*seen.shape, -1)
        at = _pixels(picture.raster, points)
        there = seen[at] > LEAST_SEEN
        mean = np.rint(total[at] / np.maximum(seen[at], LEAST_SEEN)[:, None])
        colours = np.where(there[:, None], mean, UNSEEN_GREY).astype(np.uint8)
        return np.broadcast_to(colours, points.shape)  # of grey pictures, too


def _pixels(raster: Raster, points: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return (N,) rows and columns of the pixels that points are in; on an edge, of the one beyond it."""
    row, column = (np.floor(index + 0.5).astype(np.intp) for index in raster.index(points))
    return row, column
