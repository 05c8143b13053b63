# SPDX-License-Identifier: Apache-2.0
"""Monitoring of the rig's epipolar geometry and of missing pairs."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.vision.health import COUNTED_PAIRS, EPIPOLAR_FRAMES, FrontendHealth

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
    """Return the rig with its right camera rotated about its y axis, which moves points off their epipolar lines."""
    turn = Pose(so3_exp(np.deg2rad([0.0, degrees, 0.0])), np.zeros(3))
    return dataclasses.replace(rig, T_body_right=rig.T_body_right @ turn)


def alarms_after(calibrated: StereoRig, pixels: np.ndarray, frames: int) -> dict[str, str]:
    health = FrontendHealth(calibrated, EPIPOLAR_PX)
    for _ in range(frames):
        health.check_points(pixels, calibrated.triangulate(pixels)[:, 2])
    return health.alarms


def test_a_calibrated_rig_raises_no_alarm(rig: StereoRig) -> None:
    assert alarms_after(rig, points_of(rig), EPIPOLAR_FRAMES) == {}


def test_a_bent_rig_is_reported_after_some_frames(rig: StereoRig) -> None:
    pixels = points_of(turned(rig, 0.1))  # 2.9 px at a focal length of 1645 px
    assert alarms_after(rig, pixels, EPIPOLAR_FRAMES - 1) == {}
    assert "2.9 px off their epipolar lines" in alarms_after(rig, pixels, EPIPOLAR_FRAMES)["rig"]


def test_a_gate_that_no_point_passes_is_named(rig: StereoRig) -> None:
    health = FrontendHealth(rig, 1e-9)
    pixels = points_of(rig)
    for _ in range(EPIPOLAR_FRAMES):
        health.check_points(pixels, rig.triangulate(pixels)[:, 2])
    assert "frontend.epipolar_px, 1e-09 px, is too small" in health.alarms["rig"]


def test_points_outside_the_lens_do_not_hide_a_bent_rig(rig: StereoRig) -> None:
    pixels = points_of(turned(rig, 0.1))
    pixels[3, 2:] = np.nan
    assert "2.9 px off their epipolar lines" in alarms_after(rig, pixels, EPIPOLAR_FRAMES)["rig"]


@pytest.mark.parametrize(
    ("scale", "said"), [(1.0, ""), (1000.0, "m away, at a baseline of 776 m"), (0.002, "points are 0.14 m away")]
)
def test_a_baseline_in_another_unit_is_reported(rig: StereoRig, scale: float, said: str) -> None:
    """No point is at a depth that is allowed, so the back end sees none."""
    left, right = rig.T_body_left, rig.T_body_right
    scaled = dataclasses.replace(
        rig, T_body_left=Pose(left.R, scale * left.t), T_body_right=Pose(right.R, scale * right.t)
    )
    health, pixels = FrontendHealth(scaled, EPIPOLAR_PX, (0.3, 500.0)), points_of(rig, noise_px=0.1)
    for _ in range(EPIPOLAR_FRAMES):
        assert "depth" not in health.alarms
        health.check_points(pixels, scaled.triangulate(pixels)[:, 2])
    assert said in health.alarms.get("depth", "")
    assert set(health.alarms) == ({"depth"} if said else set())


def test_swapped_images_are_reported_at_once(rig: StereoRig) -> None:
    alarms = alarms_after(rig, points_of(rig)[:, [2, 3, 0, 1]], 1)
    assert "swapped" in alarms["image order"]


def test_images_that_are_upside_down_are_not_only_taken_for_swapped(rig: StereoRig) -> None:
    alarms = alarms_after(rig, np.tile(np.array(rig.left.size) - 1.0, 2) - points_of(rig), 1)
    assert "upside down" in alarms["image order"]


@pytest.mark.parametrize("count", [0, 5])
def test_too_few_points_raise_no_alarm(rig: StereoRig, count: int) -> None:
    assert alarms_after(rig, points_of(turned(rig, 0.5))[:count], EPIPOLAR_FRAMES) == {}


def pair_alarms(rig: StereoRig, stamps_s: np.ndarray) -> list[str]:
    """Return the alarm about missing pairs at each stamp."""
    health, rng = FrontendHealth(rig, EPIPOLAR_PX), np.random.default_rng(2)
    texts = []
    for stamp_s in stamps_s:
        health.check_images(round(stamp_s * 1e9), *rng.integers(0, 255, (2, 120, 160), np.uint8))
        texts.append(health.alarms.get("pairs", ""))
    return texts


def test_missing_pairs_are_counted_until_none_was_missing_for_a_while(rig: StereoRig) -> None:
    numbers = np.delete(np.arange(1, 60), [20, 21, 25])
    texts = pair_alarms(rig, 0.1 * numbers)
    assert texts[:20] == [""] * 20
    assert texts[20] == "2 of the last 22 image pairs are missing"
    assert texts[23] == "3 of the last 23 image pairs are missing"
    assert texts[23 + COUNTED_PAIRS] == ""


def test_a_third_of_the_pairs_missing_for_long_stays_reported(rig: StereoRig) -> None:
    rng = np.random.default_rng(3)
    numbers = np.concatenate([np.arange(1, 40), 40 + np.flatnonzero(rng.random(400) > 0.3)])
    assert all(pair_alarms(rig, 0.1 * numbers)[60:])


@pytest.mark.parametrize("jitter", [0.02, 5.0])
def test_jittering_and_irregular_stamps_raise_no_alarm(rig: StereoRig, jitter: float) -> None:
    stamps_s = np.cumsum(0.1 + jitter * np.random.default_rng(4).random(60))
    assert pair_alarms(rig, 1.0 + stamps_s) == [""] * 60


def test_a_camera_that_shows_nothing_is_reported_beside_one_that_was_poor_before(rig: StereoRig) -> None:
    health, rng = FrontendHealth(rig, EPIPOLAR_PX), np.random.default_rng(5)
    left, right = rng.integers(0, 120, (2, 120, 160), np.uint8)
    assert health.check_images(1, left, right)
    assert health.check_images(2, 2 * left, right + 1)
    assert list(health.alarms) == ["left image"]
    assert not health.check_images(3, np.zeros_like(left), right)
    assert list(health.alarms) == ["left camera"]
