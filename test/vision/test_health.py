# SPDX-License-Identifier: Apache-2.0
"""How the points of both images lie to one another."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.vision.health import EPIPOLAR_FRAMES, FrontendHealth

EPIPOLAR_PX = 2.0


@pytest.fixture
def rig() -> StereoRig:
    return kagaru_rig()


def points_of(rig: StereoRig, *, noise_px: float = 0.3) -> np.ndarray:
    """Return (100, 4) noisy stereo pixels of ground 70 m below."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-20, 20, 100), rng.uniform(-15, 15, 100), rng.uniform(68, 72, 100)])
    return rig.project(points) + rng.normal(0.0, noise_px, (100, 4))


def turned(rig: StereoRig, degrees: float) -> StereoRig:
    """Return the rig with its right camera turned about its y axis, which moves points off their epipolar lines."""
    turn = Pose(so3_exp(np.deg2rad([0.0, degrees, 0.0])), np.zeros(3))
    return dataclasses.replace(rig, T_body_right=rig.T_body_right @ turn)


def judged(calibrated: StereoRig, pixels: np.ndarray, frames: int) -> dict[str, str]:
    health = FrontendHealth(calibrated, EPIPOLAR_PX)
    for _ in range(frames):
        health.judge(pixels)
    return health.alarms


def test_a_rig_as_it_was_calibrated_raises_no_alarm(rig: StereoRig) -> None:
    assert judged(rig, points_of(rig), EPIPOLAR_FRAMES) == {}


def test_a_rig_that_was_bent_is_told_after_some_frames(rig: StereoRig) -> None:
    pixels = points_of(turned(rig, 0.1))  # 2.9 px at a focal length of 1645 px
    assert judged(rig, pixels, EPIPOLAR_FRAMES - 1) == {}
    assert "2.9 px off their epipolar lines" in judged(rig, pixels, EPIPOLAR_FRAMES)["rig"]


def test_points_outside_the_lens_do_not_hide_a_bent_rig(rig: StereoRig) -> None:
    pixels = points_of(turned(rig, 0.1))
    pixels[3, 2:] = np.nan
    assert "2.9 px off their epipolar lines" in judged(rig, pixels, EPIPOLAR_FRAMES)["rig"]


def test_points_of_swapped_images_are_told_at_once(rig: StereoRig) -> None:
    alarms = judged(rig, points_of(rig)[:, [2, 3, 0, 1]], 1)
    assert "changed places" in alarms["image order"]


@pytest.mark.parametrize("count", [0, 5])
def test_a_few_points_say_nothing(rig: StereoRig, count: int) -> None:
    assert judged(rig, points_of(turned(rig, 0.5))[:count], EPIPOLAR_FRAMES) == {}
