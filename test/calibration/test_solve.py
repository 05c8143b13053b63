# SPDX-License-Identifier: Apache-2.0
"""The solution is the truth without noise, OpenCV's with noise, and as far off as it says."""

import cv2
import numpy as np
import pytest
from board_scene import HEIGHT, WIDTH, corner_pairs, rig_of
from scipy.stats import chi2

from uav_vslam.calibration.boards import Chessboard, Corners
from uav_vslam.calibration.solve import Lens, board_pose, reproject, rms, solve
from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.stereo import SIDES

BOARD = Chessboard(9, 6, 0.03)
SIZE = WIDTH, HEIGHT
LENSES = {"plumb_bob": Lens("plumb_bob", ("k3",)), "equidistant": Lens("equidistant")}
SIGMA_PX = 0.15


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("model", LENSES)
def test_exact_corners_give_the_true_rig(model: str) -> None:
    true = rig_of(model)
    found = solve(corner_pairs(true, BOARD, 10, rng(), sigma_px=0.0), SIZE, LENSES[model])
    for side in SIDES:
        ours, expected = getattr(found.rig, side), getattr(true, side)
        np.testing.assert_allclose(ours.K, expected.K, atol=1e-3)
        np.testing.assert_allclose(ours.distortion, expected.distortion, atol=1e-4)
    np.testing.assert_allclose(found.rig.T_right_left.matrix, true.T_right_left.matrix, atol=1e-6)
    assert rms([part for pair in found.residuals for part in pair]) < 1e-4


@pytest.mark.slow
def test_the_rational_model_images_points_where_the_true_lens_does() -> None:
    """Its coefficients trade against each other, so that pixels are compared."""
    true = rig_of("rational_polynomial")
    pairs = corner_pairs(true, BOARD, 12, rng(), sigma_px=0.0)
    found = solve(pairs, SIZE, Lens("rational_polynomial"))
    assert rms([part for pair in found.residuals for part in pair]) < 0.01
    assert found.rig.baseline_m == pytest.approx(true.baseline_m, rel=2e-3)


def test_no_solution_of_opencv_has_smaller_residuals() -> None:
    pairs = corner_pairs(rig_of(), BOARD, 10, rng(), sigma_px=SIGMA_PX)
    found = solve(pairs, SIZE, LENSES["plumb_bob"])
    points = [pair.left.points_board.astype(np.float32) for pair in pairs]
    left, right = ([getattr(pair, side).pixels.astype(np.float32) for pair in pairs] for side in SIDES)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    alone = [cv2.calibrateCamera(points, side, SIZE, None, None, flags=cv2.CALIB_FIX_K3)[1:3] for side in (left, right)]
    error, *_, T, _, _ = cv2.stereoCalibrate(
        points,
        left,
        right,
        *alone[0],
        *alone[1],
        SIZE,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3,
        criteria=criteria,
    )
    ours = rms([part for pair in found.residuals for part in pair])
    assert ours <= error + 1e-6
    assert ours == pytest.approx(error, rel=5e-3)  # OpenCV stops short of the minimum
    assert found.rig.baseline_m == pytest.approx(np.linalg.norm(T), abs=0.5 * found.sigma_baseline_m)


def test_fixed_coefficients_stay_zero_and_claim_no_error() -> None:
    found = solve(corner_pairs(rig_of(), BOARD, 8, rng(), sigma_px=SIGMA_PX), SIZE, Lens("plumb_bob", ("k2", "k3")))
    assert np.all(found.rig.left.distortion[[1, 4]] == 0.0)
    assert np.all(found.sigma_left[[5, 8]] == 0.0)
    assert np.all(found.sigma_left[[0, 1, 2, 3, 4, 6, 7]] > 0.0)


@pytest.mark.slow
def test_the_solution_is_as_far_off_as_its_standard_deviations_say() -> None:
    true, squares = rig_of(), []
    for seed in range(20):
        found = solve(corner_pairs(true, BOARD, 10, rng(seed), sigma_px=SIGMA_PX), SIZE, LENSES["plumb_bob"])
        squares.append(
            [
                ((found.rig.baseline_m - true.baseline_m) / found.sigma_baseline_m) ** 2,
                ((found.rig.left.fx - true.left.fx) / found.sigma_left[0]) ** 2,
                ((found.rig.right.cx - true.right.cx) / found.sigma_right[2]) ** 2,
            ]
        )
    low, high = chi2.ppf([0.0005, 0.9995], df=len(squares))
    assert np.all(np.sum(squares, axis=0) > low)
    assert np.all(np.sum(squares, axis=0) < high)


def test_the_true_rig_leaves_the_noise_of_other_pairs() -> None:
    pairs = corner_pairs(rig_of(), BOARD, 10, rng(), sigma_px=SIGMA_PX)
    residuals = reproject(rig_of(), pairs)
    assert [len(part) for pair in residuals for part in pair] == [54] * 20
    coordinates = 4 * 54
    expected = SIGMA_PX * np.sqrt(2.0 * (coordinates - 6) / coordinates)  # six are spent on the board's pose
    assert rms([part for pair in residuals for part in pair]) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("model", "fixed", "said"),
    [("omni", (), "'omni' is not known"), ("equidistant", ("p1",), "equidistant has no coefficient p1; use k1")],
)
def test_a_lens_that_does_not_exist_is_refused(model: str, fixed: tuple[str, ...], said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        Lens(model, fixed)


def test_corners_that_leave_the_pose_open_are_refused() -> None:
    camera = rig_of().left
    points = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.03, 0.0]])
    with pytest.raises(CalibrationError, match="are --board and --model right"):
        board_pose(Corners(points, 300.0 + 1000.0 * points[:, :2]), camera)
