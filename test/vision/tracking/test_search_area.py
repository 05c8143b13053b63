# SPDX-License-Identifier: Apache-2.0
"""Where new points are searched: in the smallest rectangle of cells that lacks most of them."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.geometry.image_grid import CELLS_PER_AXIS
from uav_vslam.vision.tracking.search_area import MARGIN, MOST, missing_points, search_area, whole

Array = NDArray[np.float64]

SHAPE = (480, 640)
CELL_PX = np.array(SHAPE) / CELLS_PER_AXIS


def tracks(seed: int, *, from_row_px: float = 0.0) -> Array:
    return np.random.default_rng(seed).uniform([0.0, from_row_px], [640.0, 480.0], (200, 2))


@pytest.mark.parametrize("count", [1, 40, 300])
def test_missing_points_fill_the_emptiest_cells_to_one_level(count: int) -> None:
    tracked = tracks(1, from_row_px=150.0)
    missing = missing_points(tracked, count, SHAPE)
    present, *_ = np.histogram2d(tracked[:, 1], tracked[:, 0], bins=8, range=((0, 480), (0, 640)))
    assert missing.sum() == pytest.approx(count)
    filled = (present + missing)[missing > 0]
    np.testing.assert_allclose(filled, filled[0])
    assert (present[missing == 0] >= filled[0] - 1e-9).all()


@pytest.mark.parametrize("seed", range(5))
def test_no_smaller_rectangle_lacks_as_many_points_and_no_equal_one_more(seed: int) -> None:
    tracked, count = tracks(seed, from_row_px=100.0 * (seed % 3)), 60
    missing = missing_points(tracked, count, SHAPE)

    def size_and_missing(top: int, bottom: int, left: int, right: int) -> tuple[int, float]:
        return -(bottom - top) * (right - left), round(missing[top:bottom, left:right].sum(), 9)

    spans = list(itertools.combinations(range(CELLS_PER_AXIS + 1), 2))
    every = [size_and_missing(*rows, *columns) for rows, columns in itertools.product(spans, spans)]
    top, bottom, left, right = [
        bound
        for part, cell_px in zip(search_area(tracked, count, SHAPE), CELL_PX, strict=True)
        for bound in (round(part.start / cell_px + MARGIN), round(part.stop / cell_px - MARGIN))
    ]
    assert size_and_missing(top, bottom, left, right) == max(one for one in every if one[1] >= MOST * count)


def test_ground_that_has_come_into_view_is_searched() -> None:
    rows, columns = search_area(tracks(1, from_row_px=180.0), 100, SHAPE)
    assert rows.start == 0
    assert rows.stop <= 180 + CELL_PX[0]
    assert columns.stop - columns.start >= 0.6 * 640


def test_without_tracks_most_of_the_image_is_searched_and_never_more_than_all() -> None:
    rows, columns = search_area(np.zeros((0, 2)), 300, SHAPE)
    everything = whole(SHAPE)
    assert (rows.stop - rows.start) * (columns.stop - columns.start) >= MOST * 480 * 640
    for part, all_of_it in zip((rows, columns), everything, strict=True):
        assert all_of_it.start <= part.start < part.stop <= all_of_it.stop
