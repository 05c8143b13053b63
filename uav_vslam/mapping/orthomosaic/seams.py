# SPDX-License-Identifier: Apache-2.0
"""How well neighbouring views agree where they meet: the shift and the step of brightness across seams.

At places along each seam, both views are drawn onto the surface, corrected as in the mosaic, and compared. No truth is
needed.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.orthomosaic.exposure import Correction
from uav_vslam.mapping.orthomosaic.mosaic import Orthomosaic, Picture
from uav_vslam.mapping.orthomosaic.rectification import Drawing
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.view import View
from uav_vslam.vision.patch_shift import patch_shift

Array = NDArray[np.float64]
Real = NDArray[np.float32]

PATCH_PX = 64
PLACES = 5  # at most, along each seam
LEAST_LENGTH_PX = 40  # of a seam


@dataclass(frozen=True, slots=True)
class Seams:
    """Places along seams.

    Attributes:
        points: (N, 2) x, y [m].
        shifts_px: (N, 2) of one view against the other, in pixels of the mosaic, along x and y.
        steps: (N,) ratio of their brightness, less 1.
    """

    points: Array
    shifts_px: Array
    steps: Array

    def figures(self) -> dict[str, float]:
        """Return median and 90th percentile of the shift [px] and of the step of brightness; NaN without a seam."""
        if len(self.points) == 0:
            return dict.fromkeys(("median_px", "p90_px", "median_step", "p90_step"), float("nan"))
        length, step = np.linalg.norm(self.shifts_px, axis=1), np.abs(self.steps)
        return {
            "median_px": float(np.median(length)),
            "p90_px": float(np.quantile(length, 0.9)),
            "median_step": float(np.median(step)),
            "p90_step": float(np.quantile(step, 0.9)),
        }


@dataclass(frozen=True, slots=True)
class _Place:
    """A pixel of the grid (column, row from its origin) on a seam between two views."""

    column: int
    row: int
    views: tuple[int, int]


def seams(mosaic: Orthomosaic, picture: Picture, views: Iterable[View]) -> Seams:
    """Measure the seams of a mosaic.

    Args:
        mosaic: all of its views added.
        picture: of all of it.
        views: the same views again; those that it has not are passed over.
    """
    places = _places(picture)
    numbers = {(view.vehicle, view.stamp_ns): number for number, view in enumerate(mosaic.views)}
    patches: dict[tuple[_Place, int], Real] = {}
    for view in views:
        number = numbers.get((view.vehicle, view.stamp_ns))
        own = [place for place in places if number in place.views]
        drawing = Drawing.of(view, mosaic.surface, mosaic.m_per_px) if own else None
        if number is None or drawing is None:
            continue
        correction = mosaic.views[number].correction
        patches |= {
            (place, number): patch for place in own if (patch := _patch(drawing, correction, place)) is not None
        }
    return _compared(places, patches, mosaic.m_per_px)


def _places(picture: Picture) -> list[_Place]:
    """Return places along the seams between each two views, evenly."""
    found: dict[tuple[int, int], list[tuple[int, int]]] = {}
    labels = picture.labels
    for one, other in ((labels[:-1], labels[1:]), (labels[:, :-1], labels[:, 1:])):
        rows, columns = np.nonzero((one != other) & (one >= 0) & (other >= 0))
        pairs = np.sort(np.stack([one[rows, columns], other[rows, columns]], axis=1), axis=1)
        for pair, row, column in zip(map(tuple, pairs.tolist()), rows.tolist(), columns.tolist(), strict=True):
            found.setdefault(pair, []).append((row, column))
    places = []
    for pair, pixels in sorted(found.items()):
        if len(pixels) < LEAST_LENGTH_PX:
            continue
        for k in np.linspace(0, len(pixels) - 1, PLACES + 2)[1:-1].astype(int):
            row, column = pixels[k]
            places.append(_Place(picture.raster.column + column, picture.raster.row + row, pair))
    return places


def _patch(drawing: Drawing, correction: Correction, place: _Place) -> Real | None:
    """Return the (PATCH_PX, PATCH_PX) grey surroundings of a place; None if the view does not see all of them."""
    west, south = place.column - PATCH_PX // 2, place.row - PATCH_PX // 2
    drawn = drawing.draw(Raster(drawing.raster.cell_m, west, south, PATCH_PX, PATCH_PX))
    if not (drawn.score > 0).all():
        return None
    corrected = correction.applied(drawn.image, drawn.radius2)
    return corrected[..., 0] if corrected.shape[2] == 1 else cv2.cvtColor(corrected, cv2.COLOR_BGR2GRAY)


def _compared(places: list[_Place], patches: dict[tuple[_Place, int], Real], m_per_px: float) -> Seams:
    points, shifts, steps = [], [], []
    for place in places:
        a, b = (patches.get((place, number)) for number in place.views)
        if a is None or b is None:
            continue
        shift = patch_shift(a, b)
        if shift is None:
            continue
        points.append(((place.column + 0.5) * m_per_px, (place.row + 0.5) * m_per_px))
        shifts.append(shift)
        steps.append(float(b.mean()) / max(float(a.mean()), 1.0) - 1.0)
    return Seams(np.array(points).reshape(-1, 2), np.array(shifts).reshape(-1, 2), np.array(steps))
