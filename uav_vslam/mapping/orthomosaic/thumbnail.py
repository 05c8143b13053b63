# SPDX-License-Identifier: Apache-2.0
"""Views as small as the comparison of their brightness needs them."""

import cv2
import numpy as np

from uav_vslam.mapping.orthomosaic.heights import Heights
from uav_vslam.mapping.orthomosaic.rectification import Drawing, Rectified
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.view import View

DRAWN_PX = 4  # pixels of the mosaic along the side of a pixel that is drawn
CELL_PX = 4  # such pixels along the side of a cell: the mean over one and the same piece of ground in each view


def thumbnail(view: View, surface: Heights, m_per_px: float) -> Rectified | None:
    """Return the view's mean brightness in cells of 16 pixels; None if it sees nothing of the surface.

    Args:
        view: the image, its camera and pose.
        surface: heights in the map frame.
        m_per_px: side of a pixel of the mosaic [m].
    """
    drawing = Drawing.of(view, surface, DRAWN_PX * m_per_px)
    if drawing is None:
        return None
    fine = drawing.raster.grown(CELL_PX, align=CELL_PX)
    drawn = drawing.draw(fine)
    cell_m = fine.cell_m * CELL_PX
    raster = Raster(cell_m, *(n // CELL_PX for n in (fine.column, fine.row, fine.columns, fine.rows)))
    size = raster.columns, raster.rows
    inside = cv2.erode((drawn.score > 0).astype(np.float32), np.ones((3, 3)), borderValue=0.0)  # whole pixels only
    share = cv2.resize(inside, size, interpolation=cv2.INTER_AREA)
    score, radius2 = (cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in (drawn.score, drawn.radius2))
    image = cv2.resize(drawn.image, size, interpolation=cv2.INTER_AREA).reshape(*raster.shape, -1)
    return Rectified(raster, image, np.where(share > 0.999, score, np.float32(0.0)), radius2)
