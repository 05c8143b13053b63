# SPDX-License-Identifier: Apache-2.0
"""Files of an orthomosaic."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.files.geodetic import Datum
from uav_vslam.mapping.georeference import naming, write_picture
from uav_vslam.mapping.orthomosaic.mosaic import Orthomosaic, Picture

LARGEST_PREVIEW_BYTES = 3_000_000
PREVIEW_QUALITY = 85
LONGEST_PREVIEW_PX = 6000


def write_orthomosaic(
    mosaic: Orthomosaic, picture: Picture, folder: Path, datum: Datum | None = None
) -> dict[str, Any]:
    """Write `orthomosaic.tif` (with a datum) or `.png` and `.pgw`, and a small `orthomosaic.jpg`.

    Args:
        mosaic: with at least one view.
        picture: of all of it.
        folder: to write to.
        datum: of the map frame, if known.

    Returns:
        "m_per_px", "width", "height", and the number of "views" in the picture.

    Raises:
        UavVslamError: a file can't be written.
    """
    write_picture(folder / "orthomosaic", picture.image, picture.raster, datum, seen=picture.seen)
    preview = folder / "orthomosaic.jpg"
    with naming(preview):
        preview.write_bytes(_preview(picture.image[::-1]))
    return {
        "m_per_px": mosaic.m_per_px,
        "width": picture.raster.columns,
        "height": picture.raster.rows,
        "views": len(mosaic.views),
    }


def _preview(image: NDArray[np.uint8]) -> bytes:
    """Return a JPEG that is as large as its limit allows."""
    scale = min(1.0, LONGEST_PREVIEW_PX / max(image.shape[:2]))
    while True:
        size = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
        smaller = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        _, data = cv2.imencode(".jpg", smaller, [cv2.IMWRITE_JPEG_QUALITY, PREVIEW_QUALITY])
        if len(data) <= LARGEST_PREVIEW_BYTES:
            return bytes(data)
        scale *= 0.8
