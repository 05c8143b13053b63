# SPDX-License-Identifier: Apache-2.0
"""Pictures are laid out where their similarities say; false pairs are found, and islands are told apart."""

import numpy as np
import pytest

from uav_vslam.errors import PictureError
from uav_vslam.mapping.pictures.layout import largest_part, lay_out
from uav_vslam.mapping.pictures.pairs import MatchedPair

RNG = np.random.default_rng(8)
COUNT = 8
TURN = np.exp(RNG.normal(0.0, 0.1, COUNT) + 1j * RNG.uniform(-3.0, 3.0, COUNT))
TURN /= TURN[0]
SHIFT = 300.0 * np.arange(COUNT) * np.exp(0.3j * np.arange(COUNT))
SIDES = np.full(COUNT, 800.0)


def picture_points(ground: np.ndarray, picture: int) -> np.ndarray:
    z = (ground - SHIFT[picture]) / TURN[picture]
    return np.stack([z.real, z.imag], axis=1)


def scene(wanted: list[tuple[int, int]]) -> tuple[list[MatchedPair], list[np.ndarray]]:
    """Return true pairs and the pictures' points: every pair has its own rows of both."""
    points: list[list[np.ndarray]] = [[] for _ in range(COUNT)]
    pairs = []
    for i, j in wanted:
        ground = 0.5 * (SHIFT[i] + SHIFT[j]) + RNG.normal(0.0, 100.0, 30) + 1j * RNG.normal(0.0, 100.0, 30)
        rows = np.stack([30 * len(points[k]) + np.arange(30) for k in (i, j)], axis=1)
        for k in (i, j):
            points[k].append(picture_points(ground, k))
        z = TURN[i] / TURN[j]
        pairs.append(MatchedPair(i, j, rows, np.array([[z.real, -z.imag], [z.imag, z.real]])))
    return pairs, [np.concatenate(each) if each else np.zeros((0, 2)) for each in points]


def chain(reach: int, count: int = COUNT) -> list[tuple[int, int]]:
    return [(i, j) for i in range(count) for j in range(i + 1, min(count, i + 1 + reach))]


def test_exact_similarities_are_recovered() -> None:
    pairs, points = scene(chain(2))
    layout = lay_out(COUNT, pairs, points, SIDES)
    np.testing.assert_allclose(layout.turn, TURN, atol=1e-9)
    np.testing.assert_allclose(layout.shift, SHIFT, atol=1e-5)


def test_a_false_pair_is_dropped_and_does_not_pull() -> None:
    pairs, points = scene([*chain(3), (0, 7)])
    pairs[-1] = MatchedPair(
        0, 7, pairs[-1].rows[::-1] * [1, 0] + pairs[-1].rows * [0, 1], np.array([[0, -1.0], [1, 0]])
    )
    layout = lay_out(COUNT, pairs, points, SIDES)
    assert (0, 7) not in {(pair.first, pair.second) for pair in layout.pairs}
    assert len(layout.pairs) == len(pairs) - 1
    np.testing.assert_allclose(layout.shift, SHIFT, atol=1e-3)


def test_the_largest_island_is_used() -> None:
    pairs, points = scene([*chain(2, 5), (6, 7)])
    assert largest_part(COUNT, pairs).tolist() == [0, 1, 2, 3, 4]
    assert lay_out(COUNT, pairs, points, SIDES).used.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("matches", [30, 12])
@pytest.mark.parametrize("ring", [3, 4])
def test_a_ring_that_contradicts_itself_loses_its_weakest_pair_only(ring: int, matches: int) -> None:
    pairs, points = scene([*chain(1, ring), (0, ring - 1)])
    pairs[-1] = contradicting(pairs[-1], matches)
    layout = lay_out(COUNT, pairs, points, SIDES)
    assert layout.used.tolist() == list(range(ring))
    assert len(layout.pairs) == ring - 1
    if matches < 30:  # the false pair is the weakest, so the true ones are left
        np.testing.assert_allclose(layout.shift[:ring], SHIFT[:ring], atol=1e-3)


def test_pairs_that_all_lack_a_place_are_refused() -> None:
    with pytest.raises(PictureError, match="no two pictures fit together"):
        lay_out(COUNT, [], [np.zeros((0, 2))] * COUNT, SIDES)


def contradicting(pair: MatchedPair, matches: int) -> MatchedPair:
    """Return the pair turned by 60 degrees against the truth."""
    c, s = 0.5, np.sqrt(0.75)
    return MatchedPair(pair.first, pair.second, pair.rows[:matches], pair.similarity @ [[c, -s], [s, c]])
