# SPDX-License-Identifier: Apache-2.0
"""Fills narrow gaps of a height map.

Gaps lie mostly behind what stands, where no pair saw the ground, so they take the lower of the surfaces around them.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

LOWEST = 3  # that many neighbours may be lower than the lower surface: a wrong height does not spread
STANDING_M = 1.0  # above the lower surface, a neighbour belongs to another surface


def narrow_gaps(known: Mask, cells: int) -> Mask:
    """Return the unknown cells of gaps that are at most `cells` wide in some direction: a closing of the known ones.

    Args:
        known: (rows, columns).
        cells: width of the widest gap; 0 fills nothing.
    """
    if cells < 1 or not known.any():
        return np.zeros_like(known)
    # No larger element of the same shape fits into a gap unless it is wider.
    side = cells + 1
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    grown = np.pad(known.astype(np.uint8), side)
    closed = cv2.morphologyEx(grown, cv2.MORPH_CLOSE, element)[side:-side, side:-side]
    return np.asarray((closed > 0) & ~known)


def fill(height: Floats, gaps: Mask, cells: int) -> Floats:
    """Return heights with the gaps filled by the lower surface among the known cells within `cells`.

    Args:
        height: (rows, columns) [m], NaN unknown.
        gaps: (rows, columns) cells to fill; one without known cells around it stays unknown.
        cells: reach.
    """
    filled = height.copy()
    rows, columns = np.nonzero(gaps)
    if len(rows) == 0:
        return filled
    offsets = np.stack(np.meshgrid(np.arange(-cells, cells + 1), np.arange(-cells, cells + 1)), axis=-1).reshape(-1, 2)
    padded = np.pad(height, cells, constant_values=np.nan)
    around = padded[rows[:, None] + cells + offsets[:, 1], columns[:, None] + cells + offsets[:, 0]]
    weight = 1.0 / np.maximum((offsets**2).sum(axis=1), 1) ** 2
    ranked = np.partition(np.where(np.isnan(around), np.inf, around), LOWEST, axis=1)
    lowest = ranked[:, LOWEST : LOWEST + 1]
    weights = np.where(around <= lowest + STANDING_M, weight, 0.0)
    total = weights.sum(axis=1)
    mean = (weights * np.nan_to_num(around)).sum(axis=1) / np.where(total > 0.0, total, 1.0)
    filled[rows, columns] = np.where(total > 0.0, mean, np.nan)
    return filled
