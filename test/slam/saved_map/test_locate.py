# SPDX-License-Identifier: Apache-2.0
"""A frame is located in the map of another flight, as exactly as it claims, and not in a map of other ground."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.geometry.rotation import so3_log
from uav_vslam.simulation.landmarks import observe
from uav_vslam.slam.saved_map import SavedMap
from uav_vslam.slam.saved_map.locate import MIN_INLIERS, Located, MapLocator
from uav_vslam.types import StereoFeatures

SEEDS, FRAMES = (1, 2, 3), (8, 22, 36)


def seen_by_the_other(flight, frame: int) -> StereoFeatures:
    views = observe(flight.vehicles[1], flight.field)
    return next(features for k, (features, _) in enumerate(views) if k == frame)


def located(flight, sections) -> Located:
    """Return where frame 22 is found in a map of other sections."""
    saved = SavedMap(flight.saved.origin, tuple(sections))
    found = MapLocator(saved, flight.vehicles[1].rig, flight.config).locate(seen_by_the_other(flight, 22))
    assert found is not None
    return found


def error_of(flight, frame: int, T_map_body) -> np.ndarray:
    """Return (6,) the true position less the estimate, and the rotation vector between them, in map axes."""
    true = flight.vehicles[1].true_state(int(flight.vehicles[1].frame_stamps_ns[frame])).T_map_body
    return np.concatenate([true.t - T_map_body.t, so3_log(true.R @ T_map_body.R.T)])


@pytest.mark.slow
def test_the_pose_errs_as_its_covariance_says(mapped) -> None:
    values, sigma_m = [], []
    for seed in SEEDS:
        flight = mapped(seed)
        locator = MapLocator(flight.saved, flight.vehicles[1].rig, flight.config)
        for frame in FRAMES:
            found = locator.locate(seen_by_the_other(flight, frame))
            assert found is not None
            assert locator.reason == ""
            error = error_of(flight, frame, found.T_map_body)
            values.append(error @ np.linalg.solve(found.covariance, error) / 6.0)
            sigma_m.append(np.sqrt(np.trace(found.covariance[:3, :3])))
    assert 0.1 < np.mean(values) < 1.3
    assert np.median(sigma_m) < 10.0  # from one view of flat ground, tilt can hardly be told from a shift


def test_the_error_common_to_all_landmarks_is_the_pose_s_too(mapped) -> None:
    flight = mapped(1)
    exact = [dataclasses.replace(section, common_factor=np.zeros((6, 6))) for section in flight.saved.sections]
    found, without = located(flight, flight.saved.sections), located(flight, exact)
    at = found.T_map_body.t
    grown = found.covariance - without.covariance
    assert any(np.allclose(grown, section.common_covariance(at)) for section in flight.saved.sections)


def test_landmarks_that_are_less_certain_make_a_less_certain_pose(mapped) -> None:
    flight = mapped(1)
    vague = [dataclasses.replace(one, own_factors=3.0 * one.own_factors) for one in flight.saved.sections]
    found, less = located(flight, flight.saved.sections), located(flight, vague)
    assert np.trace(less.covariance[:3, :3]) > np.trace(found.covariance[:3, :3])


def test_other_ground_is_not_recognised(mapped) -> None:
    flight, elsewhere = mapped(1), mapped(2)
    locator = MapLocator(elsewhere.saved, flight.vehicles[1].rig, flight.config)
    assert locator.locate(seen_by_the_other(flight, 20)) is None
    assert f"fewer than {MIN_INLIERS}" in locator.reason


@pytest.mark.parametrize("size", [128, 32])
def test_a_frame_without_comparable_points_is_not_located(mapped, size: int) -> None:
    flight = mapped(1)
    features = StereoFeatures(0, np.zeros((0, 4), np.float32), np.zeros((0, size), np.uint8))
    assert MapLocator(flight.saved, flight.vehicles[0].rig, flight.config).locate(features) is None
