# SPDX-License-Identifier: Apache-2.0
"""Covariances between two maps, and the four directions in which a map can be moved without changing its shape."""

import numpy as np
import pytest

from uav_vslam.cooperation.common_landmarks import blocks
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.point_pairs import FRAME_DIM, PointPairs, corrected, frame_jacobian, rotated
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy

STEP = 1e-6


@pytest.mark.parametrize("yaw", [0.0, 1e-8, 2.5, np.pi - 1e-9, -np.pi])
def test_the_jacobian_is_the_numerical_one(yaw: float) -> None:
    T = Pose(rotation_from_rpy(0.0, 0.0, yaw), np.array([300.0, -20.0, 7.0]))
    points = np.random.default_rng(0).normal(0, 40, (5, 3))
    steps = STEP * np.eye(FRAME_DIM)
    numerical = [(corrected(T, d).apply(points) - corrected(T, -d).apply(points)).ravel() / (2 * STEP) for d in steps]
    np.testing.assert_allclose(frame_jacobian(T, points), np.transpose(numerical), rtol=0, atol=1e-7)
    assert frame_jacobian(T, points[:0]).shape == (0, FRAME_DIM)


def test_a_covariance_rotates_with_its_points() -> None:
    rng = np.random.default_rng(1)
    factor, R = rng.normal(size=(9, 9)), rotation_from_rpy(0.1, -0.2, 2.0)
    J = np.kron(np.eye(3), R)
    np.testing.assert_allclose(rotated(factor @ factor.T, R), J @ factor @ factor.T @ J.T, rtol=0, atol=1e-12)


def test_the_residuals_covariance_is_of_both_maps_and_the_floor(two_maps) -> None:
    pairs, T = two_maps(right=4)
    pairs = PointPairs(pairs.own, pairs.peer, pairs.own_covariance, pairs.peer_covariance, floor_sigma_m=0.5)
    expected = pairs.own_covariance + rotated(pairs.peer_covariance, T.R) + 0.25 * np.eye(12)
    np.testing.assert_allclose(pairs.covariance(T.R), expected, rtol=0, atol=1e-12)
    k = np.arange(4)
    np.testing.assert_allclose(pairs.pair_covariances(T.R), blocks(expected)[k, k], rtol=0, atol=1e-12)
    two = pairs.pair_covariances(np.stack([T.R, np.eye(3)]))
    np.testing.assert_allclose(two[0], blocks(expected)[k, k], rtol=0, atol=1e-12)
    np.testing.assert_allclose(two[1], pairs.pair_covariances(np.eye(3)), rtol=0, atol=1e-12)


def test_relative_covariances_exclude_translation_and_yaw(two_maps) -> None:
    """A common drift leaves the relative covariance unchanged; a tilt changes the heights."""
    exact, _ = two_maps(drift=(0.0, 0.0, 0.0))
    drifted, _ = two_maps(drift=(50.0, 0.3, 0.0), sigma_m=0.3)
    drifted = PointPairs(exact.own, exact.peer, drifted.own_covariance, drifted.peer_covariance, 0.0)
    largest = np.linalg.eigvalsh(drifted.relative().own_covariance)[-1]
    assert np.linalg.eigvalsh(drifted.own_covariance)[-1] > 1e4
    assert largest < 1.0  # the yaw is linearised about the true points, 0.3 m off
    tilted, _ = two_maps(drift=(0.0, 0.0, 0.1))
    heights = np.diagonal(tilted.relative().own_covariance)[2::3]
    assert np.sqrt(heights.max()) > 2.0


def test_taking_some_pairs_takes_their_covariances(two_maps) -> None:
    pairs, _ = two_maps(right=5)
    some = pairs.take(np.array([3, 1]))
    assert len(some) == 2
    np.testing.assert_array_equal(some.peer, pairs.peer[[3, 1]])
    np.testing.assert_array_equal(some.own_covariance[:3, 3:], pairs.own_covariance[9:12, 3:6])
    assert len(pairs.take(np.zeros(0, np.intp))) == 0


def test_pairs_are_selected_from_map_and_packet(sent_map) -> None:
    rng = np.random.default_rng(2)
    factor = rng.normal(size=(9, 9))
    packet = sent_map(rng.normal(0, 9, (3, 3)), factor @ factor.T, np.zeros((3, 128), np.uint8))
    positions, P = rng.normal(size=(4, 3)), np.diag(np.arange(12.0))
    pairs = PointPairs.of(
        OwnLandmarks(positions, P, np.zeros((4, 128), np.uint8)), packet, np.array([[3, 1], [0, 2]]), 0.3
    )
    np.testing.assert_array_equal(pairs.own, positions[[3, 0]])
    np.testing.assert_array_equal(pairs.peer, packet.positions[[1, 2]])
    np.testing.assert_array_equal(np.diag(pairs.own_covariance), [9, 10, 11, 0, 1, 2])
    np.testing.assert_array_equal(pairs.peer_covariance[:3, 3:], packet.covariance[3:6, 6:9])
