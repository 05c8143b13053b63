# SPDX-License-Identifier: Apache-2.0
"""The orthomosaic: views are added one by one, at a cost that depends on what each one sees and not on the map's size.

A view is drawn onto the surface, corrected in brightness, taken apart into bands and merged into the tiles under it.
At any time the picture of any window can be put together. The result does not depend on the order of the views but for
their gains; solve these first (`two_passes`) and it does not depend on it at all, but for ties of the score.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.orthomosaic.exposure import Correction, Exposure
from uav_vslam.mapping.orthomosaic.heights import Heights
from uav_vslam.mapping.orthomosaic.pyramid import ALIGN, LEVELS, MARGIN, REACH, at_level, put_together, take_apart
from uav_vslam.mapping.orthomosaic.rectification import Drawing, Rectified
from uav_vslam.mapping.orthomosaic.thumbnail import thumbnail
from uav_vslam.mapping.orthomosaic.tiles import UNSEEN, MosaicTiles
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.tile_store import KEPT_BYTES, SIDE
from uav_vslam.mapping.view import View

GAP_M = 0.6  # width of gaps across which what is around them continues
BLOCK_PX = 1536  # side of what is taken apart at a time, at most: arrays over a view of 20 megapixels are 250 MB
STRIP_TILES = 4  # tiles that are put together at a time


@dataclass(frozen=True, slots=True)
class Picture:
    """A window of the mosaic.

    Attributes:
        raster: the window; arrays have south first.
        image: (rows, columns) grey or (rows, columns, 3) BGR uint8; 0 where nothing was seen.
        labels: (rows, columns) int32 number of the view that each pixel's detail comes from, -1 for none.
    """

    raster: Raster
    image: NDArray[np.uint8]
    labels: NDArray[np.int32]

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(rows, columns) where there is a picture."""
        return np.asarray(self.labels != UNSEEN)


@dataclass(frozen=True, slots=True)
class AddedView:
    """What the mosaic remembers of a view.

    Attributes:
        vehicle, stamp_ns: which view it was.
        correction: of its brightness.
    """

    vehicle: str
    stamp_ns: int
    correction: Correction


class Orthomosaic:
    """A picture of the ground that grows with each view."""

    def __init__(
        self,
        surface: Heights,
        m_per_px: float,
        *,
        folder: Path | None = None,
        exposure: Exposure | None = None,
        kept_bytes: int = KEPT_BYTES,
    ) -> None:
        """Start without any view.

        Args:
            surface: heights in the map frame; it may change between views.
            m_per_px: side of a pixel [m].
            folder: for tiles that are not in use; None keeps all in memory.
            exposure: with all views added and solved, in the order in which they are added here; None corrects each
                view's brightness by those before it.
            kept_bytes: largest size of the tiles in memory.

        Raises:
            UavVslamError: the size of a pixel is not positive.
        """
        if not m_per_px > 0:
            raise UavVslamError(f"the mosaic's pixel of {m_per_px} m must have a positive size, for instance 0.1")
        self.surface, self.m_per_px = surface, m_per_px
        self.views: list[AddedView] = []
        self._folder, self._kept_bytes = folder, kept_bytes
        self._known_exposure, self._exposure = exposure, Exposure()
        self._considered = 0
        self._tiles: MosaicTiles | None = None

    @property
    def tiles(self) -> MosaicTiles:
        """The tiles so far.

        Raises:
            UavVslamError: no view was added.
        """
        if self._tiles is None:
            raise UavVslamError("the mosaic is empty: no view saw the surface; check the poses and the surface's frame")
        return self._tiles

    def add(self, view: View, *, sharpness: float = 1.0) -> None:
        """Merge a view, unless it sees nothing of the surface.

        Args:
            view: the image, its camera and pose.
            sharpness: factor of its score, less for a blurred image.

        Raises:
            UavVslamError: it is grey among views in colour, or the reverse.
        """
        considered = self._considered
        self._considered += 1
        drawing = Drawing.of(view, self.surface, self.m_per_px, sharpness=sharpness)
        correction = None if drawing is None else self._correction(considered, view)
        if drawing is None or correction is None:
            return
        window = drawing.raster.grown(MARGIN, align=ALIGN)
        for block in window.blocks(BLOCK_PX, align=ALIGN):
            drawn = drawing.draw(block.grown(REACH, align=ALIGN).intersection(window))
            if drawn.score.any():
                self._merge(replace(drawn, image=correction.applied(drawn.image, drawn.radius2)), block)
        self.views.append(AddedView(view.vehicle, view.stamp_ns, correction))

    def picture(self, raster: Raster | None = None) -> Picture:
        """Put a window together; None for all that was seen.

        Raises:
            UavVslamError: no view was added.
        """
        raster = self.seen() if raster is None else raster
        image = np.zeros((*raster.shape, self.tiles.channels), np.uint8)
        labels = np.full(raster.shape, UNSEEN, np.int32)
        for strip in raster.tiles(SIDE * STRIP_TILES):
            part = strip.intersection(raster)
            at = part.within(raster)
            image[at], labels[at] = self._window(part)
        return Picture(raster, image[..., 0] if self.tiles.channels == 1 else image, labels)

    def seen(self) -> Raster:
        """Return the smallest window with all that was seen.

        Raises:
            UavVslamError: no view was added.
        """
        found = Raster(self.m_per_px, 0, 0, 0, 0)
        for raster, tile in self.tiles:
            found = found.union(raster.around(*np.nonzero(tile.labels != UNSEEN)))
        return found

    def shares(self) -> dict[str, float]:
        """Return each vehicle's share of the picture's pixels."""
        counts = np.zeros(len(self.views) + 1, int)
        for _, tile in self.tiles:
            counts += np.bincount(tile.labels.ravel() + 1, minlength=len(counts))
        shares = dict.fromkeys(sorted({view.vehicle for view in self.views}), 0.0)
        for view, count in zip(self.views, counts[1:], strict=True):
            shares[view.vehicle] += float(count / max(counts[1:].sum(), 1))
        return shares

    def _correction(self, considered: int, view: View) -> Correction | None:
        """Return the correction of a view's brightness; None if it shows too little for one."""
        if self._known_exposure is not None:
            return self._known_exposure.correction(considered)
        thumb = thumbnail(view, self.surface, self.m_per_px)
        return None if thumb is None else self._exposure.add(thumb, view.vehicle)

    def _merge(self, drawn: Rectified, block: Raster) -> None:
        """Merge a block of a view, drawn with its surroundings and corrected, into the tiles under it."""
        if self._tiles is None:
            channels = drawn.image.shape[-1]
            self._tiles = MosaicTiles(self.m_per_px, channels, self._folder, kept_bytes=self._kept_bytes)
        bands = take_apart(drawn.image, drawn.score)
        for raster in block.tiles(SIDE):
            common = raster.intersection(block)
            tile = self.tiles.change(raster)
            tile.merge(len(self.views), bands, drawn.score, common.within(raster), common.within(drawn.raster))

    def _window(self, raster: Raster) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
        """Return image (rows, columns, channels) and labels of a window."""
        around = raster.grown(MARGIN, align=ALIGN)  # all bands that reach into the window
        bands = [
            np.zeros((around.rows >> level, around.columns >> level, self.tiles.channels), np.float32)
            for level in range(LEVELS + 1)
        ]
        labels = np.full(around.shape, UNSEEN, np.int32)
        for tile_raster, tile in self.tiles.touching(around):
            common = tile_raster.intersection(around)
            labels[common.within(around)] = tile.labels[common.within(tile_raster)]
            for level, band in enumerate(bands):
                at, cut = (at_level(common.within(window), level) for window in (around, tile_raster))
                band[at] = tile.coefficients(level)[cut]
        labels = _without_gaps(labels, round(GAP_M / self.m_per_px))
        picture = np.clip(np.rint(put_together(bands)), 0, 255).astype(np.uint8)
        picture[labels == UNSEEN] = 0
        inside = raster.within(around)
        return picture[inside], labels[inside]


def _without_gaps(labels: NDArray[np.int32], width_px: int) -> NDArray[np.int32]:
    """Return the labels with those of their surroundings in unseen gaps of at most this width."""
    if width_px < 1:
        return labels
    kernel = np.ones((width_px + 1, width_px + 1), np.uint8)
    closed = cv2.morphologyEx((labels != UNSEEN).astype(np.uint8), cv2.MORPH_CLOSE, kernel) > 0
    nearby = cv2.dilate(labels.astype(np.float32), kernel).astype(np.int32)  # exact below 2^24 views
    return np.where(closed & (labels == UNSEEN), nearby, labels)
