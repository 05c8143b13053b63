# SPDX-License-Identifier: Apache-2.0
import cv2
import numpy as np
import pytest

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.vision.pnp import pnp_ransac

CAMERA = PinholeCamera(1280, 960, 1642.0, 1640.0, 640.0, 480.0)
T_MAP_LEFT = Pose(so3_exp([np.pi - 0.05, 0.1, 0.04]), np.array([120.0, -40.0, 71.0]))  # looks down from 71 m


def observe(count=120, wrong=0.0, noise_px=0.3, seed=0, relief_m=2.0):
    """Return ground points, their pixels, and the mask of correct pixels."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([0, 0], [1280, 960], (count, 2))
    rays_map = CAMERA.bearings(pixels) @ T_MAP_LEFT.R.T
    height = rng.normal(0, relief_m, count)
    points = T_MAP_LEFT.t + ((height - T_MAP_LEFT.t[2]) / rays_map[:, 2])[:, None] * rays_map
    pixels = pixels + rng.normal(0, noise_px, pixels.shape)
    true = rng.random(count) >= wrong
    pixels[~true] = rng.uniform([0, 0], [1280, 960], (int((~true).sum()), 2))
    return points, pixels, true


def pose_error(T: Pose) -> tuple[float, float]:
    difference = T_MAP_LEFT.inverse() @ T
    return float(np.linalg.norm(difference.t)), float(np.linalg.norm(so3_log(difference.R)))


@pytest.mark.parametrize("wrong", [0.0, 0.3, 0.6])
def test_pose_and_inliers_are_found_among_wrong_matches(wrong):
    points, pixels, true = observe(wrong=wrong)
    T, inliers = pnp_ransac(points, pixels, CAMERA, None, threshold_px=3.0)
    metres, radians = pose_error(T)
    assert metres < 0.3
    assert radians < 3e-3
    assert inliers[true].mean() > 0.99
    assert inliers[~true].sum() <= 1


def test_flat_ground_is_not_ambiguous():
    for seed in range(20):
        points, pixels, _ = observe(seed=seed, relief_m=0.0)
        T, inliers = pnp_ransac(points, pixels, CAMERA, None, threshold_px=3.0)
        assert inliers.all()
        assert pose_error(T)[1] < 3e-3


@pytest.mark.parametrize("count", [0, 1, 3])
def test_fewer_than_four_points_give_nothing(count):
    points, pixels, _ = observe(count)
    assert pnp_ransac(points, pixels, CAMERA, T_MAP_LEFT, threshold_px=3.0) is None


@pytest.mark.parametrize("count", [4, 5, 6])
def test_few_exact_points_are_enough(count):
    points, pixels, _ = observe(count, noise_px=0.0, seed=5)
    T, inliers = pnp_ransac(points, pixels, CAMERA, None, threshold_px=2.0)
    assert inliers.all()
    assert pose_error(T)[0] < 1e-3


def test_a_good_guess_succeeds_where_sampling_fails():
    points, pixels, true = observe(150, wrong=0.92, seed=3)
    close = Pose(T_MAP_LEFT.R @ so3_exp([1e-3, 0, 0]), T_MAP_LEFT.t + np.array([0.05, 0.0, 0.05]))
    T, inliers = pnp_ransac(points, pixels, CAMERA, close, threshold_px=6.0)
    assert pose_error(T)[0] < 1.5
    assert inliers[true].mean() > 0.9


def test_a_bad_guess_does_no_harm():
    points, pixels, _ = observe(wrong=0.3)
    alone = pnp_ransac(points, pixels, CAMERA, None, threshold_px=3.0)
    misled = pnp_ransac(points, pixels, CAMERA, Pose(np.eye(3), np.array([0.0, 0.0, 500.0])), threshold_px=3.0)
    np.testing.assert_array_equal(alone[0].matrix, misled[0].matrix)


def test_the_result_does_not_depend_on_earlier_random_draws():
    points, pixels, _ = observe(wrong=0.5)
    cv2.setRNGSeed(1)
    first = pnp_ransac(points, pixels, CAMERA, None, threshold_px=3.0)
    pnp_ransac(*observe(wrong=0.2, seed=9)[:2], CAMERA, None, threshold_px=3.0)
    cv2.setRNGSeed(2)
    second = pnp_ransac(points, pixels, CAMERA, None, threshold_px=3.0)
    np.testing.assert_array_equal(first[0].matrix, second[0].matrix)
    np.testing.assert_array_equal(first[1], second[1])


def test_points_behind_the_camera_are_never_inliers():
    points, pixels, _ = observe(40, noise_px=0.0)
    mirrored = 2 * T_MAP_LEFT.t - points  # the same pixels, from behind
    on_axis = T_MAP_LEFT.apply([[0.0, 0.0, -30.0]])
    everything = np.vstack([points, mirrored, on_axis])
    seen = np.vstack([pixels, pixels, [[CAMERA.cx, CAMERA.cy]]])
    _, inliers = pnp_ransac(everything, seen, CAMERA, T_MAP_LEFT, threshold_px=2.0)
    assert inliers[:40].all()
    assert not inliers[40:].any()


def test_identical_points_give_nothing_or_a_pose_but_never_an_exception():
    found = pnp_ransac(np.zeros((6, 3)), np.full((6, 2), 100.0), CAMERA, None, threshold_px=2.0)
    assert found is None or np.isfinite(found[0].matrix).all()
