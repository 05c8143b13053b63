# SPDX-License-Identifier: Apache-2.0
"""The motion between two pairs over flat ground is unbiased, and as uncertain as claimed."""

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.inspection.two_views import motion_between
from uav_vslam.simulation.rig import kagaru_rig

RIG = kagaru_rig(0.375)
TRUE = Pose(so3_exp([-0.011, -0.018, 0.010]), np.array([0.0, -2.8, 0.03]))
SEEDS = 30


def observed(seed: int, *, wrong: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([30, 80], [450, 300], (170, 2))
    points = RIG.left.bearings(pixels) * rng.normal(70.0, 2.0, (170, 1))
    start, end = RIG.project(points), RIG.project(TRUE.inverse().apply(points))
    start, end = start + rng.normal(0.0, 0.2, start.shape), end + rng.normal(0.0, 0.2, end.shape)
    end[:wrong] += rng.uniform(10, 40, (wrong, 4))
    return start, end


def test_motion_has_no_bias_and_the_claimed_spread() -> None:
    positions, rotations, sigmas = [], [], []
    for seed in range(SEEDS):
        found = motion_between(*observed(seed), RIG)
        assert found is not None
        positions.append(found.T_start_end.t - TRUE.t)
        rotations.append(so3_log(TRUE.R.T @ found.T_start_end.R))
        sigmas.append((found.sigma_position, found.sigma_rotation))
    for errors, sigma in zip((np.array(positions), np.array(rotations)), np.mean(sigmas, axis=0), strict=True):
        assert (np.abs(errors.mean(axis=0)) < 3.0 * sigma / np.sqrt(SEEDS)).all()
        worst = errors.std(axis=0).max()
        assert 0.7 * sigma < worst < 1.4 * sigma  # 3 sigma of a standard deviation over 30 seeds


def test_wrong_matches_are_left_out() -> None:
    found = motion_between(*observed(1, wrong=40), RIG)
    assert found is not None
    assert np.linalg.norm(found.T_start_end.t - TRUE.t) < 4.0 * found.sigma_position


@pytest.mark.parametrize(("start_px", "end_px"), [(4.5, 9.0), (0.0, -30.0)])
def test_wrong_matches_of_the_right_image_alone_are_left_out(start_px: float, end_px: float) -> None:
    """They fit the motion in the left image, and ran to infinity, or behind the camera: a singular matrix."""
    start, end = observed(0)
    start[:10, 3] += start_px
    end[:10, 3] += end_px
    found = motion_between(start, end, RIG)
    assert found is not None
    assert np.linalg.norm(found.T_start_end.t - TRUE.t) < 4.0 * found.sigma_position


def test_without_common_points_there_is_no_motion() -> None:
    start, end = observed(1)
    assert motion_between(start, np.random.default_rng(1).permutation(end), RIG) is None
    assert motion_between(start[:0], end[:0], RIG) is None
