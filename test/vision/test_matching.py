# SPDX-License-Identifier: Apache-2.0
"""The contract of every matcher, and what the ratio matcher promises beyond it."""

import numpy as np
import pytest

from uav_vslam.vision.matching import MATCHERS, match_descriptors, match_gated
from uav_vslam.vision.matching.nn_ratio import squared_distances


def descriptors(count, seed=0, length=128):
    return np.random.default_rng(seed).integers(0, 256, (count, length)).astype(np.uint8)


@pytest.fixture(params=sorted(MATCHERS))
def matcher(request):
    return MATCHERS[request.param]


def test_shuffled_noisy_copies_are_found(matcher):
    rng = np.random.default_rng(1)
    a = descriptors(80)
    order = rng.permutation(80)
    b = np.clip(a[order].astype(int) + rng.integers(-9, 10, a.shape), 0, 255).astype(np.uint8)
    pairs = matcher(a, b, 0.8)
    assert len(pairs) == 80
    np.testing.assert_array_equal(order[pairs[:, 1]], pairs[:, 0])


@pytest.mark.parametrize(("rows_a", "rows_b"), [(0, 0), (0, 5), (5, 0)])
def test_empty_sides_match_nothing(matcher, rows_a, rows_b):
    pairs = matcher(descriptors(rows_a), descriptors(rows_b), 0.8)
    assert pairs.shape == (0, 2)
    assert np.issubdtype(pairs.dtype, np.integer)


def test_matching_repeats_and_changes_nothing(matcher):
    a, b = descriptors(50, 1), descriptors(60, 2)
    copies = a.copy(), b.copy()
    np.testing.assert_array_equal(matcher(a, b, 0.99), matcher(a, b, 0.99))
    np.testing.assert_array_equal(a, copies[0])
    np.testing.assert_array_equal(b, copies[1])


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


def test_mutual_keeps_one_of_two_claims():
    a, b = np.array([[1.0], [2.0]]), np.array([[0.0], [100.0]])
    assert match_descriptors(a, b, 0.8).tolist() == [[0, 0]]
    assert match_descriptors(a, b, 0.8, mutual=False).tolist() == [[0, 0], [1, 0]]


def test_a_gate_removes_rivals_from_the_ratio():
    a, b = np.array([[0.0]]), np.array([[7.0], [8.0], [100.0]])
    assert len(match_descriptors(a, b, 0.8)) == 0
    allowed = np.array([[True, False, True]])
    assert match_gated(a, b, allowed, 0.8).tolist() == [[0, 0]]


def test_a_single_candidate_must_be_near_in_itself():
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


def test_a_gate_of_the_wrong_shape_is_refused():
    with pytest.raises(ValueError, match=r"\(2, 3\)"):
        match_gated(descriptors(3), descriptors(2), np.ones((2, 3), bool), 0.8)
