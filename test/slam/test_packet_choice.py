# SPDX-License-Identifier: Apache-2.0
"""A packet sends shared landmarks and new ones, and over time all."""

import dataclasses
from collections import Counter

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
    None,  # type: ignore[arg-type]  # the choice uses landmarks only
    np.arange(1, 21, dtype=np.uint32),
    np.random.default_rng(0).uniform(-40, 40, (20, 3)),
    np.eye(66),
    np.zeros((20, 128), np.uint8),
)
EQUAL = np.ones(20)


@given(
    st.integers(0, 25),
    st.integers(0, 4),
    st.dictionaries(st.integers(1, 20), st.integers(0, 3)),
    st.sets(st.integers(1, 20)),
)
@settings(max_examples=50)
def test_the_choice_is_ascending_without_repeats_and_as_large_as_asked(count, offered, times_sent, matched) -> None:
    rows = choose_landmarks(TWENTY, EQUAL, count, offered=offered, matched_ids=matched, times_sent=times_sent)
    assert len(rows) == min(count, 20)
    assert (np.diff(rows) > 0).all()
    chosen_matched = len(matched & set((rows + 1).tolist()))
    room = min(offered, count // 2, 20 - len(matched))
    assert chosen_matched == min(len(matched), count - room)  # shared landmarks go first


@pytest.mark.parametrize("count", [3, 6, 7, 19])
def test_all_are_sent_once_before_any_is_sent_again(count: int) -> None:
    times_sent: Counter[int] = Counter()
    for _ in range(20):
        rows = choose_landmarks(TWENTY, EQUAL, count, matched_ids=(2, 9), times_sent=times_sent)
        assert {1, 8} <= set(rows.tolist())
        times_sent.update(TWENTY.ids[rows].tolist())
        others = [times_sent[landmark] for landmark in set(TWENTY.ids.tolist()) - {2, 9}]
        assert max(others) - min(others) <= 1


def test_shared_landmarks_that_would_fill_a_packet_leave_room_for_others() -> None:
    """Vehicles that only repeat what they share would find nothing new in common."""
    times_sent: Counter[int] = Counter()
    for _ in range(2):
        rows = choose_landmarks(TWENTY, EQUAL, 8, offered=3, matched_ids=range(1, 15), times_sent=times_sent)
        times_sent.update(TWENTY.ids[rows].tolist())
        assert (rows < 14).sum() == 5
    assert all(times_sent[landmark] == 1 for landmark in range(15, 21))


def test_of_those_sent_equally_often_the_newest_go_first() -> None:
    times_sent = {20: 1, 18: 1, 3: 2}
    rows = choose_landmarks(TWENTY, EQUAL, 5, matched_ids=(1,), times_sent=times_sent)
    assert (rows + 1).tolist() == [1, 15, 16, 17, 19]
    all_but_three = dict.fromkeys(range(1, 21), 1) | {3: 0}
    assert (choose_landmarks(TWENTY, EQUAL, 3, matched_ids=(), times_sent=all_but_three) + 1).tolist() == [3, 19, 20]


def test_of_two_in_one_cell_the_one_with_more_gain_goes_first() -> None:
    positions = np.repeat(np.random.default_rng(1).uniform(-40, 40, (10, 3)), 2, axis=0)
    joint = dataclasses.replace(TWENTY, positions=positions)
    rows = choose_landmarks(joint, np.tile([1.0, 2.0], 10), 10, matched_ids=range(1, 21), times_sent={})
    assert rows.tolist() == list(range(1, 20, 2))


def test_surplus_shared_landmarks_are_spread_over_the_ground() -> None:
    corners = np.array([[0, 0], [0, 40], [40, 0], [40, 40]], float)
    positions = np.vstack([np.full((16, 2), 20.0), corners])
    joint = dataclasses.replace(TWENTY, positions=np.column_stack([positions, np.zeros(20)]))
    rows = choose_landmarks(joint, EQUAL, 5, matched_ids=range(1, 21), times_sent={})
    assert rows.tolist() == [0, 16, 17, 18, 19]


def test_without_landmarks_none_is_chosen() -> None:
    none = dataclasses.replace(TWENTY, ids=TWENTY.ids[:0], positions=TWENTY.positions[:0])
    assert choose_landmarks(none, EQUAL[:0], 5, matched_ids=(3,), times_sent={}).shape == (0,)


def test_the_gain_is_half_the_bits_that_a_peer_as_uncertain_as_the_vehicle_would_learn() -> None:
    P = np.diag([2.0, 2.0, 2.0, 1e-4, 1e-4, 1e-4, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    np.testing.assert_allclose(expected_gain(P), [1.5 * np.log(3.0), 1.5 * np.log(2.0)], rtol=1e-12)
    assert expected_gain(P[:6, :6]).shape == (0,)
