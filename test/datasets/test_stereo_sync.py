# SPDX-License-Identifier: Apache-2.0
"""Images pair up by stamp in any order of arrival, and nothing waits without end."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_vslam.datasets.stereo_sync import WAITING, StereoPair, StereoPairer
from uav_vslam.stamps import RUN_LENGTH

MS = 1_000_000


def test_equal_stamps_pair_in_either_order() -> None:
    pairer: StereoPairer[str] = StereoPairer()
    assert pairer.add("left", 10 * MS, "l1") is None
    assert pairer.add("right", 10 * MS, "r1") == StereoPair(10 * MS, "l1", "r1")
    assert pairer.add("right", 20 * MS, "r2") is None
    assert pairer.add("left", 20 * MS, "l2") == StereoPair(20 * MS, "l2", "r2")
    assert pairer.dropped == 0


def test_the_pair_has_the_left_stamp() -> None:
    pairer: StereoPairer[str] = StereoPairer(tolerance_ns=2 * MS)
    pairer.add("right", 10 * MS, "r")
    assert pairer.add("left", 11 * MS, "l") == StereoPair(11 * MS, "l", "r")


def test_stamps_farther_apart_than_the_tolerance_never_pair() -> None:
    pairer: StereoPairer[str] = StereoPairer(tolerance_ns=2 * MS)
    assert pairer.add("left", 10 * MS, "l") is None
    assert pairer.add("right", 13 * MS, "r") is None


def test_the_nearest_stamp_wins() -> None:
    pairer: StereoPairer[str] = StereoPairer(tolerance_ns=5 * MS)
    pairer.add("left", 10 * MS, "far")
    pairer.add("left", 13 * MS, "near")
    assert pairer.add("right", 14 * MS, "r") == StereoPair(13 * MS, "near", "r")
    assert pairer.dropped == 1


def test_an_image_without_partner_is_dropped_and_counted() -> None:
    pairer: StereoPairer[int] = StereoPairer()
    for k in (0, 1, 2, 4):
        pairer.add("left", k * 100 * MS, k)
    pairs = [pairer.add("right", k * 100 * MS, k) for k in (0, 2, 3, 4)]
    assert [pair.left if pair else None for pair in pairs] == [0, 2, None, 4]
    assert pairer.dropped == 2  # left 1 and right 3


def test_a_stamp_that_does_not_increase_is_dropped() -> None:
    pairer: StereoPairer[str] = StereoPairer()
    pairer.add("left", 10 * MS, "l")
    assert pairer.add("left", 10 * MS, "again") is None
    assert pairer.add("left", 9 * MS, "older") is None
    assert pairer.dropped == 2
    assert pairer.add("right", 10 * MS, "r") == StereoPair(10 * MS, "l", "r")


def test_a_camera_that_misses_its_first_image_costs_only_that_one_at_50_hertz() -> None:
    pairer: StereoPairer[int] = StereoPairer()
    pairs = []
    pairer.add("right", 0, 0)
    for k in range(1, 8):
        pairs += [pairer.add("left", k * 20 * MS, k), pairer.add("right", k * 20 * MS, k)]
    assert [(pair.left, pair.right) for pair in pairs if pair] == [(k, k) for k in range(1, 8)]
    assert pairer.dropped == 1


def test_a_dead_camera_does_not_fill_the_memory() -> None:
    pairer: StereoPairer[int] = StereoPairer()
    for k in range(1000):
        pairer.add("left", k * MS * 10, k)
    assert pairer.dropped == 1000 - WAITING


@given(st.lists(st.integers(0, 3), min_size=1, max_size=30), st.randoms(use_true_random=False))
def test_with_equal_stamps_every_common_image_pairs_once(presence: list[int], random: object) -> None:
    """Per stamp: 0 none, 1 left only, 2 right only, 3 both; sides may run ahead of each other."""
    pairer: StereoPairer[int] = StereoPairer()
    found = []
    for k, what in enumerate(presence):
        stamp = (k + 1) * 100 * MS
        sides = {1: ["left"], 2: ["right"], 3: ["left", "right"]}.get(what, [])
        random.shuffle(sides)  # type: ignore[attr-defined]
        found += [pair for side in sides if (pair := pairer.add(side, stamp, k))]
    assert [pair.left for pair in found] == [k for k, what in enumerate(presence) if what == 3]
    assert all(pair.left == pair.right for pair in found)


@pytest.mark.parametrize("lag", range(4))
def test_one_camera_may_lag_by_some_frames(lag: int) -> None:
    pairer: StereoPairer[int] = StereoPairer()
    found = []
    for k in itertools.takewhile(lambda n: n < 20, itertools.count()):
        found.append(pairer.add("left", k * 100 * MS, k))
        if k >= lag:
            found.append(pairer.add("right", (k - lag) * 100 * MS, k - lag))
    assert [pair.right for pair in found if pair] == list(range(20 - lag))


def test_a_lone_stamp_from_the_future_costs_one_image() -> None:
    pairer: StereoPairer[int] = StereoPairer()
    found = []
    for k in range(6):
        stamp_ns = (10**6 if k == 2 else k) * 100 * MS
        found += [pairer.add("left", stamp_ns, k), pairer.add("right", k * 100 * MS, k)]
    assert [pair.left for pair in found if pair] == [0, 1, 3, 4, 5]
    assert pairer.dropped == 2  # both of the pair


@pytest.mark.parametrize("jump_s", [-55, -5, 55])
def test_pairing_goes_on_when_the_clock_of_the_cameras_was_set(jump_s: int) -> None:
    pairer: StereoPairer[int] = StereoPairer()
    stamps_ns = [(60_000 + 100 * k + (1000 * jump_s if k >= 5 else 0)) * MS for k in range(10)]
    found = [pair for s in stamps_ns for pair in (pairer.add("left", s, s), pairer.add("right", s, s)) if pair]
    assert [pair.stamp_ns for pair in found] == stamps_ns
    assert pairer.tolerance_ns == 20 * MS


def test_a_clock_set_back_a_little_costs_as_many_images_as_show_it() -> None:
    pairer: StereoPairer[int] = StereoPairer()
    stamps_ns = [(60_000 + 100 * k - (1500 if k >= 20 else 0)) * MS for k in range(40)]
    found = [pair for s in stamps_ns for pair in (pairer.add("left", s, s), pairer.add("right", s, s)) if pair]
    assert [pair.stamp_ns for pair in found] == stamps_ns[:20] + stamps_ns[20 + RUN_LENGTH - 1 :]
