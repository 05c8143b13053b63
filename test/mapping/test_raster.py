# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.mapping.raster import Raster

WINDOW = Raster(0.5, -3, 4, 7, 5)


def test_the_smallest_window_contains_its_points_and_no_empty_border() -> None:
    points = np.array([[-1.49, 2.01, 9.0], [1.99, 4.49, 9.0]])
    assert Raster.covering(points, 0.5) == WINDOW


def test_no_points_make_an_empty_window_without_tiles() -> None:
    empty = Raster.covering(np.zeros((0, 3)), 0.5)
    assert empty.shape == (0, 0)
    assert list(empty.tiles(16)) == []


def test_centres_have_whole_indices() -> None:
    x, y = np.meshgrid(WINDOW.x, WINDOW.y)
    row, column = WINDOW.index(np.stack([x, y], axis=-1))
    assert row == pytest.approx(np.arange(5.0)[:, None] + np.zeros(7))
    assert column == pytest.approx(np.arange(7.0) + np.zeros((5, 1)))


def test_bounds_are_half_a_cell_outside_the_outer_centres() -> None:
    west, south, east, north = WINDOW.bounds_m
    assert (west, east) == pytest.approx((WINDOW.x[0] - 0.25, WINDOW.x[-1] + 0.25))
    assert (south, north) == pytest.approx((WINDOW.y[0] - 0.25, WINDOW.y[-1] + 0.25))


def test_a_window_cut_from_another_has_the_same_cells() -> None:
    whole = Raster(0.5, -10, 0, 40, 30)
    cut = WINDOW.within(whole)
    assert whole.x[cut[1]] == pytest.approx(WINDOW.x)
    assert whole.y[cut[0]] == pytest.approx(WINDOW.y)


def test_windows_intersect_in_their_common_cells() -> None:
    assert WINDOW.intersection(Raster(0.5, 0, 0, 2, 6)) == Raster(0.5, 0, 4, 2, 2)
    assert WINDOW.intersection(Raster(0.5, 40, 0, 2, 6)).shape[1] == 0


def test_a_union_holds_both_and_no_more() -> None:
    other = Raster(0.5, 6, -2, 3, 4)
    for union in (WINDOW.union(other), other.union(WINDOW)):
        assert union == Raster(0.5, -3, -2, 12, 11)
        assert union.intersection(WINDOW) == WINDOW
        assert union.intersection(other) == other
    empty = Raster(0.5, 100, 100, 0, 0)
    assert WINDOW.union(empty) == empty.union(WINDOW) == WINDOW


def test_the_window_around_cells_is_that_around_their_centres() -> None:
    rows, columns = np.array([3, 1, 2]), np.array([5, 6, 5])
    centres = np.column_stack([WINDOW.x[columns], WINDOW.y[rows]])
    assert WINDOW.around(rows, columns) == Raster.covering(centres, WINDOW.cell_m)
    assert WINDOW.around(rows[:0], columns[:0]).shape == (0, 0)


@pytest.mark.parametrize(("margin", "align"), [(0, 1), (3, 1), (0, 4), (1, 4), (5, 8)])
def test_a_grown_window_has_its_margin_aligned_edges_and_nothing_to_spare(margin: int, align: int) -> None:
    grown = WINDOW.grown(margin, align=align)
    for first, size, start, count in (
        (grown.column, grown.columns, WINDOW.column, WINDOW.columns),
        (grown.row, grown.rows, WINDOW.row, WINDOW.rows),
    ):
        assert first % align == size % align == 0
        assert margin <= start - first < margin + align
        assert margin <= first + size - (start + count) < margin + align


@pytest.mark.parametrize("side", [8, 24, 80])
def test_blocks_cover_a_window_once_with_aligned_edges(side: int) -> None:
    window, align = WINDOW.grown(3, align=8), 8
    count = np.zeros(window.shape, int)
    for block in window.blocks(side, align=align):
        assert max(block.shape) <= side
        assert block.column % align == block.row % align == block.columns % align == block.rows % align == 0
        count[block.within(window)] += 1
    assert (count == 1).all()


def test_tiles_cover_a_window_once_and_are_aligned_to_the_origin() -> None:
    count = np.zeros(WINDOW.shape, int)
    for tile in WINDOW.tiles(4):
        assert tile.column % 4 == tile.row % 4 == 0
        common = tile.intersection(WINDOW)
        count[common.within(WINDOW)] += 1
    assert (count == 1).all()
