# SPDX-License-Identifier: Apache-2.0
"""The contract of every matcher, and further properties of the ratio test."""

import numpy as np
import pytest

from uav_vslam.vision.features import Keypoints
from uav_vslam.vision.matching import MATCHERS, match_descriptors, match_gated
from uav_vslam.vision.matching.nn_ratio import squared_distances


def descriptors(count, seed=0, length=128):
    return np.random.default_rng(seed).integers(0, 256, (count, length)).astype(np.uint8)


def keypoints(described, seed=0):
    pixels = np.random.default_rng(seed).uniform(0, 500, (len(described), 2)).astype(np.float32)
    return Keypoints(pixels, np.ones(len(described), np.float32), described)


@pytest.fixture(params=sorted(MATCHERS))
def matcher(request):
    return MATCHERS[request.param]


def test_shuffled_noisy_copies_are_found(matcher):
    rng = np.random.default_rng(1)
    a = keypoints(descriptors(80))
    order = rng.permutation(80)
    noisy = np.clip(a.descriptors[order].astype(int) + rng.integers(-9, 10, (80, 128)), 0, 255).astype(np.uint8)
    pairs = matcher(a, Keypoints(a.pixels[order] + 7, a.responses, noisy), 0.8)
    reduced = matcher in (MATCHERS["cds_nn"], MATCHERS["cds_gtm"])
    assert len(pairs) == 80 or (reduced and len(pairs) > 8)
    np.testing.assert_array_equal(order[pairs[:, 1]], pairs[:, 0])


@pytest.mark.parametrize(("rows_a", "rows_b"), [(0, 0), (0, 5), (5, 0), (1, 0), (0, 1)])
def test_empty_sides_match_nothing(matcher, rows_a, rows_b):
    pairs = matcher(keypoints(descriptors(rows_a)), keypoints(descriptors(rows_b)), 0.8)
    assert pairs.shape == (0, 2)
    assert np.issubdtype(pairs.dtype, np.integer)


@pytest.mark.parametrize(("rows_a", "rows_b"), [(1, 1), (1, 5), (5, 1), (2, 2), (3, 3), (5, 5)])
def test_few_keypoints_are_handled(matcher, rows_a, rows_b):
    pairs = matcher(keypoints(descriptors(rows_a)), keypoints(descriptors(rows_b, 1)), 0.99)
    assert pairs.shape[1] == 2
    assert len(pairs) <= rows_a


def test_equal_keypoints_are_resolved_or_rejected(matcher):
    same = Keypoints(np.full((40, 2), 9, np.float32), np.ones(40, np.float32), np.repeat(descriptors(1), 40, axis=0))
    assert len(matcher(same, same, 1.0)) == 0


def test_matching_is_deterministic_and_does_not_modify_its_input(matcher):
    a, b = keypoints(descriptors(50, 1), 1), keypoints(descriptors(60, 2), 2)
    copies = [array.copy() for side in (a, b) for array in (side.pixels, side.descriptors)]
    np.testing.assert_array_equal(matcher(a, b, 0.99), matcher(a, b, 0.99))
    for array, copy in zip([a.pixels, a.descriptors, b.pixels, b.descriptors], copies, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_no_keypoint_is_used_twice(matcher):
    a, b = keypoints(descriptors(300, 1, 8), 1), keypoints(descriptors(200, 2, 8), 2)
    pairs = matcher(a, b, 0.95)
    assert (np.diff(pairs[:, 0]) > 0).all()
    if matcher is not MATCHERS["nn"]:
        assert len(np.unique(pairs[:, 1])) == len(pairs)


def test_distances_are_exact_for_bytes():
    a, b = descriptors(40, 1), descriptors(30, 2)
    exact = ((a[:, None].astype(np.int64) - b[None]) ** 2).sum(axis=2)
    np.testing.assert_array_equal(squared_distances(a, b), exact)


def test_the_ratio_is_of_distances_not_of_their_squares():
    a, b = np.array([[0.0, 0.0]]), np.array([[7.0, 0.0], [0.0, 10.0]])
    assert len(match_descriptors(a, b, 0.71)) == 1
    assert len(match_descriptors(a, b, 0.69)) == 0


def test_equally_near_candidates_are_no_match():
    a = descriptors(1)
    assert len(match_descriptors(a, np.vstack([a, a]), 1.0)) == 0


def test_mutual_keeps_one_of_two_matches():
    a, b = np.array([[1.0], [2.0]]), np.array([[0.0], [100.0]])
    assert match_descriptors(a, b, 0.8).tolist() == [[0, 0]]
    assert match_descriptors(a, b, 0.8, mutual=False).tolist() == [[0, 0], [1, 0]]


def test_the_gate_applies_to_the_ratio_test():
    a, b = np.array([[0.0]]), np.array([[7.0], [8.0], [100.0]])
    assert len(match_descriptors(a, b, 0.8)) == 0
    allowed = np.array([[True, False, True]])
    assert match_gated(a, b, allowed, 0.8).tolist() == [[0, 0]]


def test_a_single_candidate_must_be_near():
    a, b = np.array([[0.0], [500.0]]), np.array([[100.0], [900.0]])
    allowed = np.eye(2, dtype=bool)
    assert match_gated(a, b, allowed, 0.8, single_distance=101.0).tolist() == [[0, 0]]
    assert len(match_gated(a, b, allowed, 0.8, single_distance=100.0)) == 0
    assert len(match_gated(a, b, allowed, 0.8, single_distance=401.0)) == 2


def test_nothing_outside_the_gate_ever_matches():
    a = descriptors(60)
    allowed = np.random.default_rng(3).random((60, 60)) < 0.1
    pairs = match_gated(a, a, allowed, 1.0, single_distance=1e9)
    assert allowed[pairs[:, 0], pairs[:, 1]].all()
    assert len(match_gated(a, a, np.zeros((60, 60), bool), 1.0)) == 0


def test_an_open_gate_changes_nothing():
    a, b = descriptors(60, 1, 4), descriptors(70, 2, 4)
    open_gate = np.ones((60, 70), bool)
    np.testing.assert_array_equal(match_gated(a, b, open_gate, 0.9), match_descriptors(a, b, 0.9))


def test_a_gate_of_the_wrong_shape_is_rejected():
    with pytest.raises(ValueError, match=r"\(2, 3\)"):
        match_gated(descriptors(3), descriptors(2), np.ones((2, 3), bool), 0.8)
