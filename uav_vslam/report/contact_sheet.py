# SPDX-License-Identifier: Apache-2.0
"""Several pictures with captions on one sheet."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

TILE_IN = 3.6  # width of a picture
TITLE_IN = 0.5
COLUMNS = 4


def contact_sheet(tiles: Sequence[tuple[NDArray[np.uint8], str]], title: str) -> Figure | None:
    """Return a sheet of pictures, (H, W, 3) BGR of one size, each below its caption; None without any."""
    if not tiles:
        return None
    columns = min(COLUMNS, len(tiles))
    rows = math.ceil(len(tiles) / columns)
    height, width = tiles[0][0].shape[:2]
    tile_height = TILE_IN * height / width + 0.3
    figure = Figure(figsize=(columns * TILE_IN, rows * tile_height + TITLE_IN), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, (image, caption) in zip(grid.flat, tiles, strict=False):
        axes.imshow(image[:, :, ::-1], interpolation="antialiased")
        axes.set_title(caption, fontsize=9)
    figure.suptitle(title)
    return figure
