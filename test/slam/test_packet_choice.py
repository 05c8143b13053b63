# SPDX-License-Identifier: Apache-2.0
"""A packet shows what a peer shares, then what promises most, and in time everything."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_vslam.slam.packet.choice import choose_landmarks, expected_gain
from uav_vslam.types import JointInformation

TWENTY = JointInformation(
    1,
    "uav1",
    1,
    None,  # type: ignore[arg-type]  # the choice looks at landmarks only
    np.arange(1, 21, dtype=np.uint32),
    np.random.default_rng(0).uniform(-40, 40, (20, 3)),
    np.eye(66),
    np.zeros((20, 128), np.uint8),
)
EQUAL = np.ones(20)


@given(st.integers(0, 25), st.integers(0, 100), st.sets(st.integers(1, 20)))
@settings(max_examples=50)
def test_the_choice_is_ascending_without_repeats_and_as_large_as_asked(count, sequence, matched) -> None:
    rows = choose_landmarks(TWENTY, EQUAL, count, matched_ids=matched, sequence=sequence)
    assert len(rows) == min(count, 20)
    assert (np.diff(rows) > 0).all()
    chosen_matched = len(matched & set((rows + 1).tolist()))
    assert chosen_matched == min(len(matched), count)  # shared landmarks go first


@pytest.mark.parametrize("count", [3, 6, 7, 19])
def test_in_time_every_landmark_is_offered(count: int) -> None:
    offered = [choose_landmarks(TWENTY, EQUAL, count, matched_ids=(2, 9), sequence=k) for k in range(1, 20)]
    assert all({1, 8} <= set(rows.tolist()) for rows in offered)
    assert set(np.concatenate(offered).tolist()) == set(range(20))


def test_half_of_the_room_is_for_the_most_promising() -> None:
    corner = dataclasses.replace(TWENTY, positions=np.zeros((20, 3)))  # all in one place: nothing to spread
    gain = np.arange(20.0)
    for sequence in range(1, 9):
        rows = choose_landmarks(corner, gain, 9, matched_ids=(1,), sequence=sequence)
        assert {0, 16, 17, 18, 19} <= set(rows.tolist())


def test_of_two_in_one_place_the_more_promising_goes_first() -> None:
    positions = np.repeat(np.random.default_rng(1).uniform(-40, 40, (10, 3)), 2, axis=0)
    joint = dataclasses.replace(TWENTY, positions=positions)
    rows = choose_landmarks(joint, np.tile([1.0, 2.0], 10), 10, matched_ids=range(1, 21), sequence=1)
    assert rows.tolist() == list(range(1, 20, 2))


def test_surplus_shared_landmarks_are_spread_over_the_ground() -> None:
    corners = np.array([[0, 0], [0, 40], [40, 0], [40, 40]], float)
    positions = np.vstack([np.full((16, 2), 20.0), corners])
    joint = dataclasses.replace(TWENTY, positions=np.column_stack([positions, np.zeros(20)]))
    rows = choose_landmarks(joint, EQUAL, 5, matched_ids=range(1, 21), sequence=1)
    assert rows.tolist() == [0, 16, 17, 18, 19]


def test_nothing_is_chosen_of_nothing() -> None:
    none = dataclasses.replace(TWENTY, ids=TWENTY.ids[:0], positions=TWENTY.positions[:0])
    assert choose_landmarks(none, EQUAL[:0], 5, matched_ids=(3,), sequence=1).shape == (0,)


def test_the_gain_is_half_the_bits_that_a_peer_as_uncertain_as_the_vehicle_would_learn() -> None:
    P = np.diag([2.0, 2.0, 2.0, 1e-4, 1e-4, 1e-4, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    np.testing.assert_allclose(expected_gain(P), [1.5 * np.log(3.0), 1.5 * np.log(2.0)], rtol=1e-12)
    assert expected_gain(P[:6, :6]).shape == (0,)
