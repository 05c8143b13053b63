# SPDX-License-Identifier: Apache-2.0
"""Boards are found where they are rendered."""

import cv2
import numpy as np
import pytest
from board_scene import HEIGHT, WIDTH, grid_of, imaged, poses, rendered_pair, rig_of

from uav_vslam.calibration.boards import Board, Charuco, Chessboard, Corners
from uav_vslam.errors import CalibrationError

CORNER_PX = 0.1  # of a rendered corner, rms
BOARDS = {"chessboard": Chessboard(8, 5, 0.03), "charuco": Charuco(6, 4, 0.03, 0.022, "DICT_4X4_50")}
RIG = rig_of()


@pytest.mark.parametrize("board", BOARDS.values(), ids=list(BOARDS))
def test_corners_are_where_the_cameras_image_them(board: Board) -> None:
    for pose in poses(board, RIG, 3, np.random.default_rng(1)):
        images = rendered_pair(RIG, board, pose)
        origin = grid_of(board)[0] if isinstance(board, Charuco) else 0.0
        for image, true in zip(images, imaged(RIG, pose.apply(grid_of(board))), strict=True):
            found = board.detect(image)
            assert found is not None
            row = np.rint((found.points_board - origin)[:, :2] / board.square_m).astype(int)
            expected = true.reshape(board.rows, board.columns, 2)[row[:, 1], row[:, 0]]
            error = np.linalg.norm(found.pixels - expected, axis=1)
            turned = np.linalg.norm(found.pixels - expected[::-1], axis=1)
            assert min(np.sqrt(np.mean(error**2)), np.sqrt(np.mean(turned**2))) < CORNER_PX


@pytest.mark.parametrize("board", BOARDS.values(), ids=list(BOARDS))
def test_an_image_without_a_board_has_no_corners(board: Board) -> None:
    noise = np.random.default_rng(2).integers(0, 256, (HEIGHT, WIDTH), np.uint8)
    assert board.detect(cv2.GaussianBlur(noise, (0, 0), 3.0)) is None


def test_half_a_charuco_board_gives_the_corners_that_are_seen() -> None:
    board = BOARDS["charuco"]
    (pose,) = poses(board, RIG, 1, np.random.default_rng(7))
    left, _ = rendered_pair(RIG, board, pose)
    true, _ = imaged(RIG, pose.apply(grid_of(board)))
    hidden = left.copy()
    hidden[:, int(np.median(true[:, 0])) :] = 128
    found = board.detect(hidden)
    assert found is not None
    assert 0.3 * len(true) <= len(found.pixels) <= 0.5 * len(true)
    number = np.rint(found.points_board[:, 1] / board.square_m) * board.columns
    number += np.rint(found.points_board[:, 0] / board.square_m)
    error = np.linalg.norm(found.pixels - true[number.astype(int)], axis=1)
    assert np.median(error) < CORNER_PX


@pytest.mark.parametrize(("columns", "rows", "turns"), [(7, 5, 2), (6, 6, 1), (6, 6, 3)])
def test_a_symmetric_board_is_counted_alike_in_both_images(columns: int, rows: int, turns: int) -> None:
    board = Chessboard(columns, rows, 0.03)
    (pose,) = poses(board, RIG, 1, np.random.default_rng(4))
    points = grid_of(board)
    left, right = (Corners(points, pixels) for pixels in imaged(RIG, pose.apply(points)))
    turned = np.rot90(right.pixels.reshape(rows, columns, 2), turns).reshape(-1, 2)
    np.testing.assert_array_equal(board.like(Corners(points, turned), left).pixels, right.pixels)


def test_a_board_that_tells_its_direction_is_left_as_it_was_found() -> None:
    board = Chessboard(8, 5, 0.03)
    pixels = grid_of(board)[:, :2]
    reversed_corners = Corners(grid_of(board), pixels[::-1])
    np.testing.assert_array_equal(board.like(reversed_corners, Corners(grid_of(board), pixels)).pixels, pixels[::-1])


def test_the_size_of_another_board_is_found() -> None:
    board = BOARDS["chessboard"]
    (pose,) = poses(board, RIG, 1, np.random.default_rng(5))
    sought = Chessboard(9, 6, 0.03)
    assert sought.size_in(rendered_pair(RIG, board, pose)[0]) == (8, 5)
    assert sought.size_in(np.full((HEIGHT, WIDTH), 128, np.uint8)) is None


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Chessboard(2, 9, 0.03), "board 2x9 is too small"),
        (lambda: Chessboard(9, 6, 0.0), "square of 0.0 m must be positive"),
        (lambda: Charuco(9, 6, 0.03, 0.04, "DICT_5X5_100"), "must be smaller than its square"),
        (lambda: Charuco(9, 6, 0.03, 0.02, "DICT_9X9"), "use one of DICT_"),
        (lambda: Charuco(30, 20, 0.03, 0.02, "DICT_4X4_50"), "only 50"),
    ],
)
def test_an_impossible_board_is_refused(make, said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        make()
