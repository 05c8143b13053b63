# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
from rendered_views import ground, pose, view

from uav_vslam.mapping.surface.prepared import PreparedView
from uav_vslam.mapping.surface.rectification import Depths, rectify
from uav_vslam.mapping.surface.settings import SurfaceSettings
from uav_vslam.mapping.surface.stereo import PairPoints, match, sigmas_m
from uav_vslam.mapping.view import View

SETTINGS = SurfaceSettings(scale=1.0)
POND_M = 8.0


def points(last: int = 4, relief_m: float = 2.0, bank_deg: float = 0.0, noise_grey: float = 0.0) -> PairPoints:
    left, right = (PreparedView.of(noisy(view(k, relief_m, bank_deg), noise_grey, k), 1.0) for k in (0, last))
    pair = rectify(left, right, Depths(-8.0, 0.0, 8.0), most=160, overlap=0.2)
    assert pair is not None
    return match(pair, SETTINGS)


def noisy(clean: View, noise_grey: float, seed: int) -> View:
    noise = np.random.default_rng(seed).normal(0.0, noise_grey, clean.image.shape)
    return replace(clean, image=np.clip(np.rint(clean.image + noise), 0, 255).astype(np.uint8))


def errors(found: PairPoints, relief_m: float) -> np.ndarray:
    x, y, z = found.points_map.T.astype(float)
    return np.asarray(z - ground(relief_m).relief.height(x, y))


@pytest.mark.parametrize("relief_m", [0.0, 2.0])
def test_the_surface_is_found_without_bias_as_exactly_as_claimed(relief_m: float) -> None:
    found = points(relief_m=relief_m)
    error = errors(found, relief_m)
    assert found.share > 0.8
    assert abs(np.median(error)) < 0.3 * found.noise_m
    assert 0.3 < np.percentile(np.abs(error), 68) / found.noise_m < 1.2


@pytest.mark.parametrize("noise_grey", [6.0, 12.0])
def test_noisy_images_are_claimed_to_be_worse(noise_grey: float) -> None:
    """With a fixed noise of the disparities, heights of noisy images were over-confident by more than twice."""
    found = points(noise_grey=noise_grey)
    assert found.noise_m > 1.5 * points().noise_m
    assert 0.3 < np.percentile(np.abs(errors(found, 2.0)), 68) / found.noise_m < 1.2


def test_a_shorter_baseline_is_claimed_and_found_to_be_worse() -> None:
    near, far = points(2), points(4)
    assert near.noise_m == pytest.approx(2.0 * far.noise_m, rel=0.05)
    assert np.percentile(np.abs(errors(near, 2.0)), 68) > 1.5 * np.percentile(np.abs(errors(far, 2.0)), 68)


def test_oblique_views_are_claimed_to_be_worse_the_farther_they_look() -> None:
    """Heights err by depth times fall: with the same noise everywhere, far points were over-confident by twice."""
    found = points(bank_deg=45.0)
    points_map, error = found.points_map.astype(float), np.abs(errors(found, 2.0))
    claimed = found.noise_m * found.lever(points_map)
    far = claimed > np.percentile(claimed, 75.0)
    assert np.percentile(error[far], 68) > 2.0 * found.noise_m
    assert 0.3 < np.percentile(error[far] / claimed[far], 68) < 1.2
    assert 0.3 < np.percentile(error[~far] / claimed[~far], 68) < 1.2


def test_heights_have_no_terraces_at_whole_disparities() -> None:
    """The share of heights near whole disparities is that of chance; interpolated matching costs double it."""
    left, right = (PreparedView.of(view(k), 1.0) for k in (0, 4))
    pair = rectify(left, right, Depths(-8.0, 0.0, 8.0), most=128, overlap=0.2)
    assert pair is not None
    depth = pose(0).t[2] - match(pair, SETTINGS).points_map[:, 2].astype(float)
    fraction = (pair.focal_px * pair.baseline_m / depth - pair.shift_px) % 1.0
    near_whole = np.mean((fraction < 0.15) | (fraction > 0.85))
    assert near_whole == pytest.approx(0.3, abs=0.06)


def test_a_wrong_relative_pose_shifts_the_heights_as_the_sigma_says() -> None:
    """First order: dZ = Z/B dB and Z^2/B da, against a pair whose poses are wrong by just that."""
    wrong = pose(4)
    wrong.t[0] += 0.2
    left, right = PreparedView.of(view(0, 0.0), 1.0), PreparedView.of(view(4, 0.0), 1.0)
    moved = rectify(left, PreparedView(right.camera, wrong, right.grey), Depths(-8.0, 0.0, 8.0), most=128, overlap=0.2)
    assert moved is not None
    settings = SurfaceSettings(scale=1.0, relative_position_m=0.2, relative_attitude_rad=0.0)
    shift = abs(float(np.median(match(moved, settings).points_map[:, 2])))
    assert sigmas_m(moved, 70.0, settings, settings.match_px)[1] == pytest.approx(shift, rel=0.1)


def test_different_grounds_do_not_match() -> None:
    left = PreparedView.of(view(0), 1.0)
    other = PreparedView(left.camera, pose(4), PreparedView.of(view(40), 1.0).grey)
    pair = rectify(left, other, Depths(-8.0, 0.0, 8.0), most=128, overlap=0.2)
    assert pair is not None
    assert match(pair, SETTINGS).share < 0.1


def with_pond(k: int) -> View:
    """Return a view of level ground, `POND_M` around the middle of which are water: one grey, and noise."""
    seen = view(k, 0.0)
    u, v = np.meshgrid(np.arange(seen.camera.width), np.arange(seen.camera.height))
    rays = seen.camera.bearings(np.stack([u, v], axis=-1).reshape(-1, 2).astype(float)) @ seen.T_map_cam.R.T
    apart = seen.T_map_cam.t[:2] - seen.T_map_cam.t[2] * rays[:, :2] / rays[:, 2:] - middle_of_pond()
    water = np.linalg.norm(apart, axis=1).reshape(u.shape) < POND_M
    return noisy(replace(seen, image=np.where(water, np.uint8(90), seen.image)), 2.0, k)


def middle_of_pond() -> np.ndarray:
    return 0.5 * (pose(0).t + pose(4).t)[:2]


def test_water_gives_no_height() -> None:
    """It took a height from its banks, metres off, over all of it and with a sigma of centimetres."""
    left, right = (PreparedView.of(with_pond(k), 1.0) for k in (0, 4))
    pair = rectify(left, right, Depths(-8.0, 0.0, 8.0), most=160, overlap=0.2)
    assert pair is not None
    from_middle = np.linalg.norm(match(pair, SETTINGS).points_map[:, :2] - middle_of_pond(), axis=1)
    within = np.mean(from_middle < 0.7 * POND_M)  # nearer to the bank, blocks show it
    assert np.mean(from_middle < 2.0 * POND_M) > 0.4
    assert within < 0.005


def test_matching_is_deterministic() -> None:
    assert np.array_equal(points().points_map, points().points_map)


def test_points_below_the_searched_heights_and_above_the_cameras_are_dropped() -> None:
    """One of 14 km made a raster of gigabytes."""
    near = [[0.0, 0.0, 1.0], [1.0, 1.0, 2.0], [2.0, 2.0, -3.0]]
    points = np.array([*near, [9000.0, 0.0, -2000.0], [3687.0, 1931.0, 14239.0]], np.float32)
    down = np.array([0.0, 0.0, -1.0])
    kept = PairPoints(points, np.array([0.0, 0.0, 70.0]), down, 70.0, 0.1, 0.1, 0.8).above(-3.0)
    np.testing.assert_array_equal(kept.points_map, near)
    assert kept.share == pytest.approx(0.48)
