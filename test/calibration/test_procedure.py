# SPDX-License-Identifier: Apache-2.0
"""What does not fit is rejected with its reason, and what is doubtful is told."""

from dataclasses import replace

import numpy as np
import pytest
from board_scene import HEIGHT, WIDTH, corner_pairs, grid_of, imaged, rig_of

from uav_vslam.calibration.boards import Board, Chessboard, Corners
from uav_vslam.calibration.bundle import BoardPair
from uav_vslam.calibration.procedure import Boards, calibrate, coverage, find_boards
from uav_vslam.calibration.solve import Lens, reproject, rms
from uav_vslam.errors import CalibrationError

BOARD = Chessboard(9, 6, 0.03)
LENS = Lens("plumb_bob", ("k3",))
SIGMA_PX = 0.15


def boards(count: int = 12, seed: int = 1) -> Boards:
    pairs = corner_pairs(rig_of(), BOARD, count, np.random.default_rng(seed), sigma_px=SIGMA_PX)
    return Boards(pairs, [], (WIDTH, HEIGHT))


@pytest.mark.slow
def test_all_pairs_of_a_rigid_rig_are_used_and_nothing_is_doubtful() -> None:
    found = calibrate(boards(24), LENS)
    assert len(found.pairs) == 24
    assert found.rejected == []
    assert found.warnings == []


def test_each_half_is_judged_by_the_cameras_of_the_other() -> None:
    found = calibrate(boards(16), LENS)
    first, second = (half.rig for half in found.check.halves)
    for error, rig, half in zip(
        found.check.other_px, (second, first), (found.pairs[::2], found.pairs[1::2]), strict=True
    ):
        assert error == pytest.approx(rms([part for pair in reproject(rig, half) for part in pair]))
    assert np.all(np.array(found.check.other_px) > found.check.own_px)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 4])
def test_a_pair_whose_images_are_of_two_moments_is_rejected(seed: int) -> None:
    """A joint solution of all ten would not tell it: there the pair has less than thrice the median error."""
    given = boards(10, seed)
    mixed = replace(given.pairs[5], right=given.pairs[6].right)
    found = calibrate(replace(given, pairs=[*given.pairs[:5], mixed, *given.pairs[6:]]), LENS)
    assert [pair.name for pair in found.rejected] == ["05"]
    assert "outlier" in found.rejected[0].reason
    assert found.solution.rig.baseline_m == pytest.approx(rig_of().baseline_m, rel=0.01)


def test_too_few_pairs_that_agree_are_refused() -> None:
    given = boards(8)
    mixed = replace(given.pairs[5], right=given.pairs[6].right)
    with pytest.raises(CalibrationError, match="only 7 pairs agree, 8 are needed"):
        calibrate(replace(given, pairs=[*given.pairs[:5], mixed, *given.pairs[6:]]), LENS)


@pytest.mark.slow
def test_halves_that_disagree_are_told() -> None:
    """Every second picture is of a board that is 3 % larger, as if two boards had been mixed up."""
    given = boards(24)
    larger = [
        replace(pair, **{side: scaled(getattr(pair, side), 1.03) for side in ("left", "right")}) if k % 2 else pair
        for k, pair in enumerate(given.pairs)
    ]
    found = calibrate(replace(given, pairs=larger), LENS)
    assert found.check.baseline_difference == pytest.approx(0.03, abs=0.005)
    assert any("baseline from odd and from even pairs differs by" in text for text in found.warnings)


def scaled(corners: Corners, factor: float) -> Corners:
    return Corners(factor * corners.points_board, corners.pixels)


@pytest.mark.slow
def test_boards_that_face_the_camera_leave_the_focal_length_open() -> None:
    rig, points = rig_of(), boards(1).pairs[0].left.points_board
    rng, pairs = np.random.default_rng(3), []
    for k in range(8):
        shift = np.array([-0.12 + 0.005 * k, -0.075, 0.36])
        left, right = (
            Corners(points, pixels + rng.normal(0.0, SIGMA_PX, pixels.shape)) for pixels in imaged(rig, points + shift)
        )
        pairs.append(BoardPair(f"{k}", left, right))
    found = calibrate(Boards(pairs, [], (WIDTH, HEIGHT)), LENS)
    assert any("focal length uncertain by" in text for text in found.warnings)


def test_coverage_counts_the_cells_with_a_corner() -> None:
    found = calibrate(boards(12), LENS)
    corner = np.array([[1.0, 1.0], [WIDTH - 1.0, HEIGHT - 1.0], [WIDTH / 2 + 1, 1.0], [2.0, 2.0]])
    only = replace(found.pairs[0], left=Corners(np.zeros((4, 3)), corner))
    assert coverage(replace(found, pairs=[only]), "left") == 3 / 64


class Marked:
    """A board that is found where the image's first pixel is bright; the second one counts its corners."""

    ADVICE = "paint it"
    columns, rows, square_m = 9, 6, 0.03

    def detect(self, image: np.ndarray) -> Corners | None:
        return Corners(grid_of(BOARD)[: image[0, 1]], np.zeros((image[0, 1], 2))) if image[0, 0] else None

    def size_in(self, image: np.ndarray) -> None:
        return None

    def like(self, corners: Corners, reference: Corners) -> Corners:
        return corners


SEEN, SEEN_RIGHT, BLANK = np.full((40, 60), 54, np.uint8), np.full((40, 60), 53, np.uint8), np.zeros((40, 60), np.uint8)
ONE_ROW = np.full((40, 60), 9, np.uint8)


def looked_at(*images: tuple[np.ndarray, np.ndarray], board: Board | None = None) -> Boards:
    return find_boards(((f"{k}", *pair) for k, pair in enumerate(images)), board or Marked())


def test_pictures_without_a_board_are_rejected_with_the_side() -> None:
    found = looked_at(*[(SEEN, SEEN_RIGHT)] * 8, (BLANK, SEEN_RIGHT), (SEEN, BLANK), (BLANK, BLANK))
    assert len(found.pairs) == 8
    assert found.size == (60, 40)
    sides = ["the left image", "the right image", "both images"]
    assert [pair.reason for pair in found.rejected] == [f"no board found in {side}" for side in sides]


def test_pictures_whose_corners_do_not_tell_the_pose_are_rejected_with_the_side() -> None:
    found = looked_at(*[(SEEN, SEEN_RIGHT)] * 8, (ONE_ROW, SEEN_RIGHT), (SEEN, ONE_ROW), (ONE_ROW, ONE_ROW + 1))
    assert len(found.pairs) == 8
    sides = ["the left image", "the right image", "both images"]
    assert [pair.name for pair in found.rejected] == ["8", "9", "10"]
    for pair, side in zip(found.rejected, sides, strict=True):
        assert pair.reason.startswith(f"the corners found in {side} lie in one line")


class Larger(Marked):
    """One of which the board that is looked for is a part, in images with a dark third pixel."""

    def size_in(self, image: np.ndarray) -> tuple[int, int]:
        return (11, 7) if image[0, 2] == 1 else (9, 6)


def test_a_board_that_is_a_part_of_the_one_in_most_pictures_is_refused() -> None:
    larger = SEEN.copy()
    larger[0, 2] = 1
    with pytest.raises(
        CalibrationError, match=r"a board of 9x6 inner corners is a part .* 6 images .* use --board 11x7"
    ):
        looked_at(*[(larger, SEEN_RIGHT)] * 6, *[(SEEN, SEEN_RIGHT)] * 4, board=Larger())
    assert len(looked_at(*[(larger, SEEN_RIGHT)] * 4, *[(SEEN, SEEN_RIGHT)] * 6, board=Larger()).pairs) == 10
    with pytest.raises(CalibrationError, match=r"3 of 3 pairs .* take more"):
        looked_at(*[(larger, SEEN_RIGHT)] * 3, board=Larger())


ROW, NEXT = list(range(9)), 9  # corners of the board's first row, and the first one of the second


@pytest.mark.parametrize(
    ("chosen", "told"),
    [
        ([], False),
        ([0, 1, NEXT], False),
        (ROW, False),
        ([*ROW, NEXT], False),
        ([0, 10, 20, 30, 40], False),  # a diagonal
        ([*ROW, NEXT, NEXT + 1], True),
        ([0, 1, NEXT, NEXT + 1], True),
        ([8, NEXT, 45, 53], True),
    ],
)
def test_corners_tell_the_pose_if_two_lie_beside_any_line(chosen: list[int], told: bool) -> None:
    assert Corners(grid_of(BOARD)[chosen], np.zeros((len(chosen), 2))).fix_pose == told


def test_a_pair_of_another_size_is_rejected_with_the_side() -> None:
    found = looked_at(*[(SEEN, SEEN_RIGHT)] * 8, (SEEN, SEEN_RIGHT[:30]))
    assert len(found.pairs) == 8
    assert [pair.reason for pair in found.rejected] == [
        "the right picture of pair 8 is 60x30 px but the first picture 60x40"
    ]


def test_pictures_of_another_size_are_refused() -> None:
    with pytest.raises(CalibrationError, match="right picture of pair 1 is 60x30 px but the first picture 60x40"):
        looked_at((SEEN, SEEN_RIGHT), (SEEN, SEEN_RIGHT[:30]))


def test_the_same_pictures_on_both_sides_are_refused() -> None:
    with pytest.raises(CalibrationError, match="both pictures of pair 2 are the same; name each camera's own"):
        looked_at((SEEN, SEEN_RIGHT), (BLANK, BLANK), (SEEN, SEEN))


def test_too_few_boards_are_refused_with_what_to_count() -> None:
    with pytest.raises(
        CalibrationError, match=r"1 of 2 pairs show the 9x6 board in both images; 8 are needed; paint it"
    ):
        looked_at((SEEN, SEEN_RIGHT), (BLANK, SEEN_RIGHT))
    with pytest.raises(
        CalibrationError, match="7 of 7 pairs show the 9x6 board in both images; 8 are needed; take more"
    ):
        looked_at(*[(SEEN, SEEN_RIGHT)] * 7)
