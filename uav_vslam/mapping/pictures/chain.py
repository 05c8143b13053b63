# SPDX-License-Identifier: Apache-2.0
"""The thesis's chain of homographies over a folder's pictures, as a baseline; in pixels of the first picture."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from uav_vslam.errors import PictureError
from uav_vslam.mapping.georeference import write_picture
from uav_vslam.mapping.homography_chain import chain_homographies, chained_mosaic
from uav_vslam.mapping.opacity import with_alpha
from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.mapping.pictures.raw_values import RawValues
from uav_vslam.mapping.progress import counted
from uav_vslam.mapping.view import Image
from uav_vslam.vision.images import to_bgr8

MOST_SIDE = 20_000  # pixels of the mosaic; a chain that has gone astray grows without bound


def draw_chain(
    pictures: Sequence[Picture], pixel: float, folder: Path, *, on_picture: Callable[[], None] = lambda: None
) -> Path:
    """Write the chain's picture and return its path.

    Args:
        pictures: in order, all of one size.
        pixel: side of a pixel, in pixels of the first picture.
        folder: where it goes.
        on_picture: called twice for each picture.

    Raises:
        PictureError: sizes differ, or the chain has gone astray.
        UavVslamError: two consecutive pictures have too little in common.
    """
    sizes = {(picture.width, picture.height) for picture in pictures}
    if len(sizes) > 1:
        raise PictureError(f"pictures have sizes {sorted(sizes)}; a chain of homographies needs one size")

    values = RawValues()

    def searched() -> Iterator[Image]:
        for picture in pictures:
            stored, opaque = picture.stored(), picture.opaque()
            values.add(picture.camera, stored, opaque)
            yield with_alpha(to_bgr8(stored), opaque)

    up = np.diag([1.0, -1.0, 1.0])  # the map's y runs up, the image's down
    names = [picture.name for picture in pictures]
    to_map = [up @ H for H in chain_homographies(counted(searched(), on_picture), names)]
    width, height = sizes.pop()
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]], float).T
    mapped = np.concatenate([H @ corners for H in to_map], axis=1)
    if (mapped[2] <= 0.0).any() or np.ptp(mapped[:2] / mapped[2], axis=1).max() > MOST_SIDE * pixel:
        raise PictureError(f"the chain of homographies has gone astray, beyond {MOST_SIDE} px; use --method bundle")
    drawn = (with_alpha(picture.read(), picture.opaque()) for picture in values.levelled(pictures))
    chained = chained_mosaic(counted(drawn, on_picture), to_map, pixel)
    return write_picture(folder / "orthomosaic", chained.image, chained.raster, None, seen=chained.seen)
