# SPDX-License-Identifier: Apache-2.0
import dataclasses
import math

import numpy as np
import pytest

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.vision.stereo_gate import StereoGate, epipolar_distances, epipolar_gate, stereo_candidates

CAMERA = PinholeCamera(1280, 960, 1642.0, 1642.0, 640.0, 480.0)


@pytest.fixture(params=[[0.776, 0.0, 0.0], [0.0, 0.776, 0.0], [0.5, 0.5, 0.1]], ids=["along u", "along v", "oblique"])
def rig(request):
    T_body_right = Pose(so3_exp([0.05, -0.04, 0.2]), np.array(request.param))
    return StereoRig(CAMERA, CAMERA, Pose.identity(), T_body_right)


def observe(rig, depth, count=30):
    rng = np.random.default_rng(0)
    rays = CAMERA.bearings(rng.uniform([200, 200], [1000, 700], (count, 2)))
    return rig.project(rays * depth)


def test_true_pairs_are_allowed_and_most_others_are_not(rig):
    z = observe(rig, 70.0)
    allowed = stereo_candidates(z[:, :2], z[:, 2:], rig, epipolar_px=2.0, depth_range_m=(20.0, 500.0))
    assert np.diagonal(allowed).all()
    assert allowed.mean() < 0.05


def test_depth_range_closes_the_gate(rig):
    z = observe(rig, 70.0)
    for depth_range_m in ((80.0, 500.0), (0.3, 60.0)):
        allowed = stereo_candidates(z[:, :2], z[:, 2:], rig, epipolar_px=2.0, depth_range_m=depth_range_m)
        assert not np.diagonal(allowed).any()


def test_all_pair_distances_equal_the_rigs_single_ones(rig):
    z = observe(rig, 70.0)
    distances = epipolar_distances(z[:, :2], z[::-1, 2:], rig)
    np.testing.assert_allclose(np.diagonal(distances), rig.epipolar_distance(np.hstack([z[:, :2], z[::-1, 2:]])))


@pytest.mark.parametrize(("count_left", "count_right"), [(0, 0), (0, 3), (3, 0)])
def test_no_points_give_an_empty_gate(rig, count_left, count_right):
    z = observe(rig, 70.0, 3)
    allowed = stereo_candidates(
        z[:count_left, :2], z[:count_right, 2:], rig, epipolar_px=2.0, depth_range_m=(1.0, 100.0)
    )
    assert allowed.shape == (count_left, count_right)


def test_a_rigid_rig_has_the_configured_gate(rig):
    assert epipolar_gate(rig, 2.0, RigConfig(attitude_sigma_deg=1.0, vibration_sigma_deg=1.0)) == 2.0


def test_the_gate_of_a_flexing_rig_accepts_pairs_of_a_rotated_camera(rig):
    config = RigConfig(flexing=True, attitude_sigma_deg=0.04, vibration_sigma_deg=0.03)
    epipolar_px = epipolar_gate(rig, 0.5, config)
    farthest = []
    for axis in np.eye(3):
        turn = Pose(so3_exp(math.radians(3.0 * 0.05) * axis), np.zeros(3))
        z = observe(dataclasses.replace(rig, T_body_right=rig.T_body_right @ turn), 70.0)
        allowed = stereo_candidates(z[:, :2], z[:, 2:], rig, epipolar_px=epipolar_px, depth_range_m=(20.0, 500.0))
        assert np.diagonal(allowed).all()
        farthest.append(rig.epipolar_distance(z).max())
    assert max(farthest) > 0.5 * epipolar_px  # no wider than needed


@pytest.mark.parametrize(("depth_m", "good"), [(9.0, False), (12.0, True), (90.0, True), (120.0, False)])
def test_points_outside_the_range_of_depths_or_off_their_line_are_not_believed(rig, depth_m: float, good) -> None:
    config = FrontendConfig(min_depth_m=10.0, max_depth_m=100.0)
    gate = StereoGate(rig, config, RigConfig(), noise_px=1.0)
    z = observe(rig, depth_m)
    depth, believed = gate.check(z)
    np.testing.assert_allclose(depth, depth_m, rtol=1e-6)
    assert (believed == good).all()
    lines = np.hstack([z[:, :2], np.ones((len(z), 1))]) @ rig.fundamental.T
    across = lines[:, :2] / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    off = z + np.hstack([np.zeros((len(z), 2)), (gate.epipolar_px + 0.5) * across])
    assert not gate.check(off)[1].any()


def test_noise_does_not_make_a_possible_depth_impossible() -> None:
    """Points at 150 m with 0.33 px of disparity, off by 0.25 px, seem 600 m away; without them the rest is too near."""
    rig = StereoRig(CAMERA, CAMERA, Pose.identity(), Pose(np.eye(3), np.array([0.03, 0.0, 0.0])))
    gate = StereoGate(rig, FrontendConfig(max_depth_m=500.0), RigConfig(), noise_px=0.3)
    depth, good = gate.check(observe(rig, 150.0) + np.array([0.0, 0.0, 0.25, 0.0]))
    assert (depth > 550.0).all()
    assert good.all()
