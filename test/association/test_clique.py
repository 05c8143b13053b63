# SPDX-License-Identifier: Apache-2.0
"""The maximum clique is found, and large or hard problems terminate."""

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_vslam.association.clique import largest_clique


def random_agreement(seed: int, count: int, share: float) -> np.ndarray:
    upper = np.triu(np.random.default_rng(seed).random((count, count)) < share, 1)
    return upper | upper.T


def is_clique(agree: np.ndarray, rows: np.ndarray) -> bool:
    return bool((agree | np.eye(len(agree), dtype=bool))[np.ix_(rows, rows)].all())


@given(st.integers(0, 2**32 - 1), st.integers(1, 20), st.floats(0.0, 1.0))
def test_small_problems_are_solved_exactly(seed: int, count: int, share: float) -> None:
    agree = random_agreement(seed, count, share)
    rows = largest_clique(agree)
    assert is_clique(agree, rows)
    best, _ = nx.max_weight_clique(nx.from_numpy_array(agree), weight=None)
    assert len(rows) == len(best)


@pytest.mark.parametrize("wrong", [0, 20, 100])
def test_correct_matches_are_found_among_hundreds(wrong: int) -> None:
    """Two hundred correct ones that agree in 99 % of cases, and wrong ones that agree with 10 %."""
    count = 200
    agree = random_agreement(1, count + wrong, 0.1)
    agree[:count, :count] = random_agreement(2, count, 0.99)
    rows = largest_clique(agree)
    assert is_clique(agree, rows)
    assert (rows < count).all()
    assert len(rows) > 0.4 * count


@pytest.mark.parametrize("seed", range(10))
def test_a_vertex_that_agrees_with_the_whole_clique_is_included_in_large_problems(seed: int) -> None:
    agree = random_agreement(seed, 80, 0.6)
    rows = largest_clique(agree)
    assert is_clique(agree, rows)
    assert not agree[rows].all(axis=0).any()


def test_the_diagonal_is_ignored_and_an_empty_graph_has_no_clique() -> None:
    agree = random_agreement(3, 12, 0.5)
    np.testing.assert_array_equal(largest_clique(agree), largest_clique(agree | np.eye(12, dtype=bool)))
    assert len(largest_clique(np.zeros((0, 0), dtype=bool))) == 0


def test_the_argument_is_not_modified() -> None:
    agree = random_agreement(4, 15, 0.7)
    before = agree.copy()
    largest_clique(agree)
    np.testing.assert_array_equal(agree, before)
