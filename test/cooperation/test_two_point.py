# SPDX-License-Identifier: Apache-2.0
"""Two pairs with equal distance and height give a transform."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.cooperation import two_point
from uav_vslam.cooperation.point_pairs import PointPairs
from uav_vslam.cooperation.two_point import GATE, TWO_GATE, gated, hypotheses
from uav_vslam.geometry.pose import Pose


def tried(pairs, seed: int = 0):
    return hypotheses(pairs.relative(), rng=np.random.default_rng(seed))


def test_two_right_pairs_give_the_transform(two_maps) -> None:
    pairs, T = two_maps(right=2, sigma_m=1e-4, drift=(0.0, 0.0, 0.0))
    found = tried(pairs)
    assert len(found) == 1
    np.testing.assert_allclose(found.best().matrix, T.matrix, rtol=0, atol=1e-3)


@pytest.mark.parametrize("stretch", [(1.1, 1.1, 1.0), (1.0, 1.0, 4.0)])
def test_two_pairs_at_another_distance_or_height_are_not_tried(two_maps, stretch) -> None:
    pairs, _ = two_maps(right=2, drift=(0.0, 0.0, 0.0))
    assert len(tried(pairs)) == 1
    assert len(tried(dataclasses.replace(pairs, peer=pairs.peer * stretch + [0.0, 0.0, 0.0]))) == 0


def test_vertically_aligned_points_do_not_determine_yaw(two_maps) -> None:
    points = np.column_stack([np.zeros((9, 2)), np.linspace(0, 40, 9)])
    pairs, _ = two_maps(right=9, points=points, sigma_m=0.01, drift=(0.0, 0.0, 0.0))
    assert len(tried(pairs)) == 0


def test_wrong_pairs_rarely_give_transforms_and_are_outliers_of_the_best(two_maps) -> None:
    pairs, T = two_maps(right=12, wrong=12, sigma_m=0.1)
    found = tried(pairs)
    assert len(found) < 0.5 * 24 * 23 / 2
    inliers = found.inliers[np.argmax(found.inliers.sum(axis=1))]
    assert inliers[:12].all()
    assert not inliers[12:].any()
    np.testing.assert_array_equal(gated(pairs.relative(), found.best()), np.flatnonzero(inliers))
    np.testing.assert_allclose(found.best().R, T.R, rtol=0, atol=0.1)


def test_distances_are_those_of_the_residuals(two_maps) -> None:
    pairs, _ = two_maps(right=6)
    relative = pairs.relative()
    found = tried(pairs)
    h = len(found) // 2
    residual = pairs.own - (pairs.peer @ found.R[h].T + found.t[h])
    S = relative.pair_covariances(found.R[h])
    expected = [r @ np.linalg.solve(C, r) for r, C in zip(residual, S, strict=True)]
    np.testing.assert_allclose(found.distance2[h], expected, rtol=1e-9)
    np.testing.assert_array_equal(found.inliers[h], found.distance2[h] <= GATE)


def test_the_random_subset_depends_on_the_seed_alone(two_maps, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(two_point, "MAX_HYPOTHESES", 20)
    pairs, _ = two_maps(right=14)
    assert len(tried(pairs)) == 20
    np.testing.assert_array_equal(tried(pairs, 3).t, tried(pairs, 3).t)
    assert not np.array_equal(tried(pairs, 3).t, tried(pairs, 4).t)


def test_slack_widens_the_gate(two_maps) -> None:
    pairs, T = two_maps(sigma_m=0.1, drift=(0.0, 0.0, 0.0))
    off = Pose(T.R, T.t + np.array([1.5, 0.0, 0.0]))
    assert len(gated(pairs.relative(), off)) == 0
    assert len(gated(pairs.relative(), off, slack_m=1.0)) == len(pairs)


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_pairs_give_no_transform(two_maps, count: int) -> None:
    pairs, _ = two_maps(right=2)
    few = pairs.take(np.arange(count))
    assert len(hypotheses(few, rng=np.random.default_rng(0))) == 0


@pytest.mark.parametrize(("share", "tried_at_all"), [(0.99, True), (1.01, False)])
@pytest.mark.parametrize("axis", [0, 2], ids=["distance", "height"])
def test_two_pairs_are_tried_by_the_covariance_of_distance_and_height(axis: int, share: float, tried_at_all) -> None:
    """Dense reference just inside and just outside of the gate; the floor of both points counts."""
    rng, floor_m = np.random.default_rng(1), 0.5
    A, B = rng.normal(0, 0.3, (2, 6, 6))
    D, axes = np.hstack([-np.eye(3), np.eye(3)]), np.eye(3)
    own = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0]])
    pairs = PointPairs(own, own, A @ A.T, B @ B.T, floor_m)
    variance = axes[axis] @ D @ (A @ A.T + B @ B.T) @ D.T @ axes[axis] + 2 * floor_m**2
    peer = own + np.outer([0.0, share * np.sqrt(TWO_GATE * variance)], axes[axis])
    found = hypotheses(dataclasses.replace(pairs, peer=peer), rng=rng)
    assert len(found) == tried_at_all
