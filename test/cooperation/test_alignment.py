# SPDX-License-Identifier: Apache-2.0
"""The alignment is found despite wrong matches, its covariance is consistent, and weak evidence is refused."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from uav_vslam.cooperation.alignment import (
    MAX_SIGMA_YAW,
    STEP_SIGMA_M,
    Alignment,
    Refusal,
    _consistent,
    align,
    fit,
    follow,
    sigma_yaw,
)
from uav_vslam.cooperation.point_pairs import FLAT_SIGMA, FRAME_DIM, PointPairs, frame_jacobian
from uav_vslam.cooperation.two_point import GATE, gated
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy, so3_log

NO_DRIFT = (0.0, 0.0, 0.0)
RIGHT = 14


def aligned(pairs: PointPairs) -> Alignment:
    found = align(pairs)
    assert isinstance(found, Alignment), found
    return found


def refused(pairs: PointPairs) -> str:
    found = align(pairs)
    assert isinstance(found, Refusal), found
    return found.reason


def error_of(found: Pose, T: Pose) -> np.ndarray:
    """Return the (4,) error of translation and yaw."""
    return np.append(T.t - found.t, so3_log(T.R @ found.R.T)[2])


@given(
    yaw=st.floats(-np.pi, np.pi),
    t=st.tuples(*[st.floats(-1000.0, 1000.0)] * 3),
    wrong=st.integers(0, RIGHT),
)
@settings(max_examples=40)
def test_maps_without_noise_are_aligned_exactly_for_any_transform(two_maps, yaw: float, t, wrong: int) -> None:
    pairs, T = two_maps(right=RIGHT, wrong=wrong, sigma_m=0.0, drift=NO_DRIFT, yaw=yaw, t=t)
    found = aligned(pairs)
    np.testing.assert_array_equal(found.inliers, np.arange(RIGHT))
    np.testing.assert_allclose(found.T_own_peer.R, T.R, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.T_own_peer.t, T.t, rtol=0, atol=1e-7)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("wrong", [6, 14])
def test_drifted_maps_are_aligned_despite_wrong_matches(two_maps, seed: int, wrong: int) -> None:
    pairs, T = two_maps(seed, right=RIGHT, wrong=wrong)
    found = aligned(pairs)
    assert set(found.inliers) <= set(range(RIGHT))
    assert len(found.inliers) >= RIGHT - 1
    error = error_of(found.T_own_peer, T)
    assert np.linalg.norm(error[:3]) < 5 * np.sqrt(np.trace(found.covariance[:3, :3]))


def test_common_drift_of_a_map_rejects_no_pairs(two_maps) -> None:
    """Each map may be 50 m and 20 degrees off: the transform absorbs it, and its covariance includes it."""
    pairs, _ = two_maps(drift=(50.0, 0.0, 0.0), wrong=6)
    exact, _ = two_maps(drift=NO_DRIFT, wrong=6)
    found = aligned(pairs)
    np.testing.assert_array_equal(found.inliers, aligned(exact).inliers)
    assert np.sqrt(found.covariance[0, 0]) > 50.0


def test_the_covariance_is_consistent(two_maps) -> None:
    """NEES over draws of both maps from their own covariances; the bounds hold in 999 of 1000 studies."""
    runs, total = 200, 0.0
    for seed in range(runs):
        pairs, T = two_maps(seed, right=10)
        found, covariance = fit(pairs, T)
        error = error_of(found, T)
        total += error @ np.linalg.solve(covariance, error)
    low, high = chi2.ppf([0.0005, 0.9995], FRAME_DIM * runs) / FRAME_DIM / runs
    assert low < total / FRAME_DIM / runs < high


def test_the_fit_does_not_depend_on_its_initial_value(two_maps) -> None:
    pairs, T = two_maps(right=10)
    there, covariance = fit(pairs, T)
    distant = Pose(rotation_from_rpy(0.0, 0.0, 0.3) @ T.R, T.t + 20.0)
    again, same = fit(pairs, distant)
    np.testing.assert_allclose(again.matrix, there.matrix, rtol=0, atol=1e-5)
    np.testing.assert_allclose(same, covariance, rtol=1e-3)


def test_tilt_is_never_estimated(two_maps) -> None:
    pairs, _ = two_maps(drift=(1.0, 0.01, 0.05), wrong=3)  # both maps are tilted by degrees
    R = aligned(pairs).T_own_peer.R
    np.testing.assert_array_equal(R[2], [0.0, 0.0, 1.0])
    np.testing.assert_array_equal(R[:, 2], [0.0, 0.0, 1.0])


def test_an_outlier_inside_its_own_gate_is_rejected_by_the_others(two_maps) -> None:
    """The own map has a scale error of a tenth, so each landmark's gate is wide, but all share one error."""
    pairs, T = two_maps(sigma_m=0.1, drift=NO_DRIFT)
    stretch = 0.1 * (pairs.own - pairs.own.mean(axis=0))
    k = int(np.argmax(np.linalg.norm(stretch, axis=1)))
    own = pairs.own.copy()
    own[k] += 0.7 * stretch[k]  # less than a sigma
    covariance = pairs.own_covariance + np.outer(stretch.ravel(), stretch.ravel())
    pairs = dataclasses.replace(pairs, own=own, own_covariance=covariance)
    assert k in gated(pairs.relative(), T)
    assert set(aligned(pairs).inliers) == set(range(RIGHT)) - {k}


def test_the_result_is_the_same_each_time_and_in_any_order(two_maps) -> None:
    pairs, _ = two_maps(wrong=10)
    found = aligned(pairs)
    np.testing.assert_array_equal(aligned(pairs).T_own_peer.matrix, found.T_own_peer.matrix)
    backwards = aligned(pairs.take(np.arange(len(pairs))[::-1]))
    np.testing.assert_array_equal(np.sort(len(pairs) - 1 - backwards.inliers), found.inliers)
    np.testing.assert_allclose(backwards.T_own_peer.matrix, found.T_own_peer.matrix, rtol=0, atol=1e-9)


def test_landmarks_along_one_line_are_enough(two_maps) -> None:
    """A row of trees: roll about it would be unknown, but gravity fixes that."""
    points = np.column_stack([np.random.default_rng(3).uniform(-50, 50, RIGHT), np.zeros(RIGHT), np.zeros(RIGHT)])
    pairs, T = two_maps(points=points, drift=NO_DRIFT)
    assert np.abs(error_of(aligned(pairs).T_own_peer, T)).max() < 1.0


def test_vertically_aligned_landmarks_are_refused(two_maps) -> None:
    points = np.column_stack([np.zeros((RIGHT, 2)), np.linspace(0.0, 40.0, RIGHT)])
    pairs, _ = two_maps(points=points)
    assert "no two" in refused(pairs)


@pytest.mark.parametrize(("right", "reason"), [(0, "0 matches"), (7, "7 matches")])
def test_few_matches_are_refused(two_maps, right: int, reason: str) -> None:
    assert reason in refused(two_maps(right=right)[0])


def test_few_matches_that_agree_are_refused(two_maps) -> None:
    assert "of 20 matches agree, 8 needed" in refused(two_maps(right=5, wrong=15)[0])


@pytest.mark.parametrize("seed", range(20))
def test_matches_that_are_all_wrong_are_refused(two_maps, seed: int) -> None:
    pairs, _ = two_maps(seed, right=0, wrong=40)
    assert refused(pairs)


def test_agreement_in_wide_gates_may_be_chance(two_maps) -> None:
    pairs, _ = two_maps(right=RIGHT, wrong=RIGHT, sigma_m=6.0)
    assert "chance" in refused(pairs)


def test_landmarks_in_one_spot_are_refused(two_maps) -> None:
    """Right matches within two metres determine the other map's translation, but not its yaw."""
    rng = np.random.default_rng(5)
    spot = rng.normal(0.0, 1.0, (RIGHT, 3)) * [1.0, 1.0, 0.1]
    far = np.column_stack([rng.uniform(-50, 50, (6, 2)), np.zeros(6)])
    pairs, _ = two_maps(right=RIGHT, points=np.vstack([spot, far]), wrong=6, sigma_m=0.2, drift=NO_DRIFT)
    assert "close together" in refused(pairs)


def test_a_second_transform_that_explains_the_rest_is_refused(two_maps) -> None:
    """Rows of crops: part of the matches are all one row off."""
    pairs, _ = two_maps(right=2 * RIGHT, sigma_m=0.1)
    own = pairs.own.copy()
    own[RIGHT + 3 :] += [6.0, 0.0, 0.0]
    assert "ambiguous" in refused(dataclasses.replace(pairs, own=own))


@pytest.mark.parametrize("right", [3, 5])
def test_a_known_frame_is_refined_from_few_matches(two_maps, right: int) -> None:
    pairs, T = two_maps(right=right, wrong=4, drift=(0.3, 0.01, 0.001))
    near = Pose(rotation_from_rpy(0.0, 0.0, 0.01) @ T.R, T.t + np.array([0.3, -0.2, 0.1]))
    found = follow(pairs, near)
    assert found is not None
    np.testing.assert_array_equal(found.inliers, np.arange(right))


def test_inliers_outside_a_rough_frame_s_gate_are_recovered_by_the_fit(two_maps) -> None:
    pairs, T = two_maps(right=RIGHT, wrong=4)
    turn = Pose(rotation_from_rpy(0.0, 0.0, 0.15), np.zeros(3))
    centre = Pose(np.eye(3), pairs.own.mean(axis=0))
    rough = centre @ turn @ centre.inverse() @ T
    assert len(gated(pairs.relative(), rough, slack_m=STEP_SIGMA_M)) < RIGHT
    found = follow(pairs, rough)
    assert found is not None
    np.testing.assert_array_equal(found.inliers, np.arange(RIGHT))


def test_a_frame_without_inliers_is_not_refined(two_maps) -> None:
    pairs, T = two_maps(right=6)
    assert follow(pairs, Pose(T.R, T.t + 100.0)) is None
    assert follow(pairs.take(np.zeros(0, np.intp)), T) is None


def test_sigma_of_yaw_falls_with_the_spread_of_the_landmarks(two_maps) -> None:
    pairs, T = two_maps()
    covariance = fit(pairs, T)[1]
    all_of_them = Alignment(T, covariance, np.arange(len(pairs)))
    assert sigma_yaw(pairs.relative(), all_of_them) < 0.25 * MAX_SIGMA_YAW
    two_near = Alignment(T, covariance, np.argsort(np.linalg.norm(pairs.own - pairs.own[0], axis=1))[:2])
    assert sigma_yaw(pairs.relative(), two_near) > MAX_SIGMA_YAW


@pytest.mark.parametrize("away_m", [3e4, 5e6])
def test_points_close_together_do_not_determine_yaw_however_far_from_the_origin_they_are(away_m: float) -> None:
    """At 30 km the flat prior of the translation, 1 km, would alone make yaw known to 2 degrees."""
    rng, count = np.random.default_rng(1), 12
    points = rng.normal(size=(count, 3)) * np.array([0.5, 0.5, 0.1])
    sigmas = []
    for origin in (np.zeros(3), np.array([away_m, -away_m, 0.0])):
        at, P = points + origin, 0.01 * np.eye(3 * count)
        pairs = PointPairs(at, at, P, P, 0.3)
        found = Alignment(Pose.identity(), np.eye(4), np.arange(count))
        sigmas.append(sigma_yaw(pairs.relative(), found))
    assert sigmas[0] > 2.0 * MAX_SIGMA_YAW
    np.testing.assert_allclose(sigmas[1], sigmas[0], rtol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_pairs_that_contradict_the_others_go_as_if_all_were_weighed_afresh_each_time(two_maps, seed: int) -> None:
    """The Schur complements against the dense information of the pairs that are left, the frame marginalised out."""
    pairs, T = two_maps(seed, right=6, wrong=5, drift=(3.0, 0.05, 0.02))
    rows = np.arange(len(pairs))
    while len(rows) > 2:
        left = pairs.take(rows)
        A = frame_jacobian(T, left.peer)
        B = np.linalg.inv(left.covariance(T.R) + A @ np.diag(FLAT_SIGMA**2) @ A.T)
        pull = (B @ left.residuals(T).ravel()).reshape(-1, 3)
        distance2 = [p @ np.linalg.solve(B[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], p) for k, p in enumerate(pull)]
        if max(distance2) <= GATE:
            break
        rows = np.delete(rows, np.argmax(distance2))
    np.testing.assert_array_equal(_consistent(pairs, T), rows)
    assert len(rows) < len(pairs)


@pytest.mark.parametrize(
    ("t", "yaw", "contradicts"), [((0, 0, 0), 0.0, False), ((30, 0, 0), 0.0, True), ((0, 0, 0), 0.5, True)]
)
def test_only_maps_displaced_by_more_than_they_claim_contradict_a_common_frame(two_maps, t, yaw, contradicts) -> None:
    """Each map claims a shift of 1 m, a tenth of a degree of yaw, and 0.3 m of each landmark."""
    for seed in range(20):
        pairs, _ = two_maps(seed, wrong=6, t=t, yaw=yaw)
        found = align(pairs)
        assert isinstance(found, Alignment)
        assert found.contradicts_common_frame is contradicts, seed
