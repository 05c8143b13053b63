# SPDX-License-Identifier: Apache-2.0
"""False pairs are found by stronger ones around a loop of pictures, whatever the cameras' tilt."""

from dataclasses import replace

import numpy as np
import pytest
from orbit_pictures import Orbit, orbit

from uav_vslam.mapping.pictures.loops import MOST_STEPS, without_contradicted
from uav_vslam.mapping.pictures.pairs import MatchedPair

FALSE_MATCHES, OFFSET_PX = 40, np.array([15.0, 5.0])


@pytest.fixture(scope="module")
def flown() -> Orbit:
    """Pictures in a bank."""
    return orbit()


def kept(flown: Orbit, pairs: list[MatchedPair]) -> list[tuple[int, int]]:
    sides = np.array([float(max(picture.width, picture.height)) for picture in flown.pictures])
    remaining = without_contradicted(pairs, [each.pixels for each in flown.features], sides)
    return [(pair.first, pair.second) for pair in remaining]


def false_pair(flown: Orbit, first: int, second: int) -> MatchedPair:
    """Return a pair of few points of one geometry: those that `first` and the next share, said to be in `second`."""
    pair = next(pair for pair in flown.pairs if (pair.first, pair.second) == (first, first + 1))
    pixels = flown.features[first].pixels[pair.rows[:, 0]]
    rows = []
    for row, pixel in zip(pair.rows[:, 0], pixels, strict=True):
        apart = np.linalg.norm(flown.features[second].pixels - pixel - OFFSET_PX, axis=1)
        rows.append((row, int(np.argmin(apart))))
    nearest = np.array(rows)[:FALSE_MATCHES]
    return MatchedPair(first, second, nearest, np.eye(2))


def test_true_pairs_stay_in_their_order(flown: Orbit) -> None:
    assert kept(flown, flown.pairs) == [(pair.first, pair.second) for pair in flown.pairs]


def test_a_false_pair_beside_true_ones_goes(flown: Orbit) -> None:
    chain = [pair for pair in flown.pairs if pair.second - pair.first == 1]
    false = false_pair(flown, 10, 10 + MOST_STEPS)
    assert kept(flown, [*chain, false]) == [(pair.first, pair.second) for pair in chain]


def test_a_pair_that_no_short_way_judges_stays(flown: Orbit) -> None:
    chain = [pair for pair in flown.pairs if pair.second - pair.first == 1]
    false = false_pair(flown, 10, 11 + MOST_STEPS)
    assert (false.first, false.second) in kept(flown, [*chain, false])


def test_the_stronger_pair_is_believed(flown: Orbit) -> None:
    chain = [pair for pair in flown.pairs if pair.second - pair.first == 1 and pair.first in (10, 11)]
    false = false_pair(flown, 10, 12)
    weak = [replace(pair, rows=pair.rows[: FALSE_MATCHES // 2]) if pair.first == 11 else pair for pair in chain]
    assert kept(flown, [*weak, false]) == [(10, 11), (10, 12)]
