# SPDX-License-Identifier: Apache-2.0
"""Points are selected evenly over the image, best first."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_vslam.geometry.image_grid import CELLS_PER_AXIS, spread, spread_after

SIZE = (640, 480)
CELL = (SIZE[0] / CELLS_PER_AXIS, SIZE[1] / CELLS_PER_AXIS)
PIXELS = st.lists(st.tuples(st.floats(-50, 700), st.floats(-50, 530)), max_size=60)


def cell_centre(column: int, row: int) -> list[float]:
    return [(column + 0.5) * CELL[0], (row + 0.5) * CELL[1]]


def test_each_cell_gives_its_best_before_any_gives_its_second() -> None:
    pixels = [cell_centre(0, 0), cell_centre(0, 0), cell_centre(5, 5), cell_centre(0, 0), cell_centre(7, 7)]
    assert spread(pixels, 3, size=SIZE).tolist() == [0, 2, 4]
    assert spread(pixels, 5, size=SIZE).tolist() == [0, 2, 4, 1, 3]


def test_points_selected_before_count_towards_their_cells() -> None:
    pixels = [cell_centre(1, 1), cell_centre(2, 2)]
    assert spread(pixels, 1, size=SIZE, taken=[cell_centre(1, 1)]).tolist() == [1]
    assert spread(pixels, 2, size=SIZE, taken=[cell_centre(1, 1)]).tolist() == [1, 0]


@given(PIXELS, st.integers(0, 70), PIXELS)
def test_the_selection_has_the_requested_size_and_no_duplicates(pixels, count: int, taken) -> None:
    chosen = spread(pixels, count, size=SIZE, taken=taken)
    assert len(chosen) == min(count, len(pixels)) == len(set(chosen.tolist()))


@given(PIXELS, st.integers(0, 70))
def test_a_smaller_selection_is_a_prefix_of_a_larger_one(pixels, count: int) -> None:
    assert spread(pixels, count, size=SIZE).tolist() == spread(pixels, 70, size=SIZE).tolist()[:count]


@pytest.mark.parametrize("pixels", [[], np.zeros((0, 2))])
def test_no_points_give_no_selection(pixels) -> None:
    assert spread(pixels, 5, size=SIZE).shape == (0,)


def test_over_the_ground_those_that_go_first_leave_the_rest_of_the_room_to_others() -> None:
    ground = np.column_stack([np.repeat([0.0, 100.0], 3), np.zeros((6, 2))])  # two places
    assert spread_after(ground, np.array([4]), np.array([0, 1, 2, 5]), 3).tolist() == [4, 0, 5]
    assert spread_after(ground, np.array([0, 1, 3]), np.array([4]), 2).tolist() == [0, 3]
    assert spread_after(ground, np.array([2]), np.array([0]), 9).tolist() == [2, 0]
    assert spread_after(ground, np.zeros(0, np.intp), np.zeros(0, np.intp), 9).tolist() == []
