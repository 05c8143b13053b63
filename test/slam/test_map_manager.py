# SPDX-License-Identifier: Apache-2.0
"""Removal from the map: failed landmarks, each policy's choice, and those above the cap."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import BackendConfig
from uav_vslam.slam.landmark_map import LandmarkMap
from uav_vslam.slam.map_manager import FAILED_AFTER_FRAMES, RETENTION, MapView, rows_to_remove

CONFIG = BackendConfig()
FRAME = 100


def view_of(
    *,
    positions=None,
    in_view=None,
    observations=None,
    born=None,
    seen=None,
    variance=None,
    count: int = 0,
) -> MapView:
    given = [g for g in (positions, in_view, observations, born, seen, variance) if g is not None]
    n = len(given[0]) if given else count
    landmark_map = LandmarkMap()
    landmark_map.append(np.zeros((n, 128), np.uint8), 0, np.zeros(n, np.uint32))
    landmark_map.observations = np.full(n, 10) if observations is None else np.array(observations)
    landmark_map.born = np.zeros(n, np.intp) if born is None else np.array(born)
    landmark_map.seen = np.full(n, FRAME) if seen is None else np.array(seen)
    return MapView(
        landmark_map,
        np.column_stack([np.arange(n) * 100.0, np.zeros((n, 2))]) if positions is None else np.array(positions, float),
        lambda: np.ones(n) if variance is None else np.array(variance),
        np.ones(n, bool) if in_view is None else np.array(in_view, bool),
        FRAME,
    )


@pytest.mark.parametrize("policy", sorted(RETENTION))
def test_nothing_is_removed_from_an_empty_map(policy: str) -> None:
    config = dataclasses.replace(CONFIG, retention=policy)
    assert rows_to_remove(view_of(count=0), config).tolist() == []


@pytest.mark.parametrize("policy", sorted(RETENTION))
def test_rows_are_unique_ascending_integers_and_nothing_is_modified(policy: str) -> None:
    rng = np.random.default_rng(1)
    n = 300
    view = view_of(
        positions=rng.uniform(-100, 100, (n, 3)),
        in_view=rng.random(n) < 0.4,
        observations=rng.integers(1, 9, n),
        born=rng.integers(0, FRAME, n),
        seen=rng.integers(FRAME - 20, FRAME + 1, n),
        variance=rng.random(n),
    )
    before = [view.positions.copy(), view.landmarks.observations.copy(), view.landmarks.ids.copy()]
    removed = rows_to_remove(view, dataclasses.replace(CONFIG, retention=policy))
    assert removed.dtype == np.intp
    assert (np.diff(removed) > 0).all()
    assert n - len(removed) <= CONFIG.max_landmarks
    for then, now in zip(before, (view.positions, view.landmarks.observations, view.landmarks.ids), strict=True):
        np.testing.assert_array_equal(then, now)


def test_a_rarely_observed_landmark_fails_when_in_view_but_not_observed() -> None:
    long_ago = FRAME - FAILED_AFTER_FRAMES
    view = view_of(
        in_view=[True, True, True, True],
        observations=[2, 2, 3, 1],
        seen=[long_ago, long_ago + 1, long_ago, FRAME],
    )
    assert rows_to_remove(view, CONFIG).tolist() == [0]


def test_out_of_view_each_cell_keeps_its_most_observed_landmark() -> None:
    view = view_of(
        positions=[[1, 1, 0], [2, 2, 0], [24, 24, 0], [26, 1, 0], [3, 3, 0], [-1, 1, 0]],
        in_view=[False, False, False, False, True, False],
        observations=[4, 9, 9, 3, 99, 2],
    )
    # rows 0 to 2 share a cell of 25 m, where 1 is the first of the most observed; 5 is not established
    assert rows_to_remove(view, CONFIG).tolist() == [0, 2, 5]


def spaced(count: int) -> np.ndarray:
    """Return (N, 3) positions, one in the middle of each of N cells in a row."""
    return np.column_stack([CONFIG.retention_cell_m * (np.arange(count) + 0.5), np.zeros((count, 2))])


def test_cells_grow_until_there_is_capacity_for_new_landmarks() -> None:
    config = dataclasses.replace(CONFIG, max_in_view=50, max_landmarks=60, max_new_landmarks=20)
    removed = rows_to_remove(view_of(positions=spaced(64), in_view=[False] * 64), config)
    kept = np.setdiff1d(np.arange(64), removed)
    assert 32 <= len(kept) <= 40  # the capacity is 40; 64 cells of twice the size would be 32
    assert np.diff(kept).max() == 2  # the whole ground stays covered


@pytest.mark.parametrize("policy", sorted(RETENTION))
def test_every_policy_keeps_capacity_for_new_landmarks(policy: str) -> None:
    config = dataclasses.replace(CONFIG, retention=policy, max_in_view=50, max_landmarks=100, max_new_landmarks=20)
    view = view_of(
        positions=spaced(100),
        in_view=[False] * 70 + [True] * 30,
        born=np.arange(100),
        seen=[50] * 70 + [FRAME] * 30,
    )
    assert 100 - len(rows_to_remove(view, config)) <= 80


@pytest.mark.parametrize("places", [0, 1, 3])
def test_ground_on_both_sides_of_the_origin_fits_into_a_small_capacity(places: int) -> None:
    config = dataclasses.replace(CONFIG, max_in_view=1, max_landmarks=places + 1, max_new_landmarks=1)
    corners = 200.0 * np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])
    view = view_of(positions=corners, in_view=[False] * 4, observations=[4, 7, 5, 6])
    assert rows_to_remove(view, config).tolist() == sorted([0, 2, 3, 1][: 4 - places])


def test_the_capacity_is_used_even_for_rarely_observed_landmarks() -> None:
    config = dataclasses.replace(CONFIG, retention="most_observed", max_in_view=2, max_landmarks=8, max_new_landmarks=2)
    view = view_of(in_view=[False] * 6, observations=[1, 1, 2, 9, 3, 1], seen=[95, 96, 40, 30, 31, 97])
    assert rows_to_remove(view, config).tolist() == []
    tight = dataclasses.replace(config, max_landmarks=6)
    assert rows_to_remove(view, tight).tolist() == [0, 1]  # seen once; of these, the longest unseen
    tighter = dataclasses.replace(config, max_landmarks=3)
    assert rows_to_remove(view, tighter).tolist() == [0, 1, 2, 3, 5]  # of established ones, the longest unseen


def test_without_retention_only_what_is_in_view_stays() -> None:
    view = view_of(in_view=[True, False, True, False])
    assert rows_to_remove(view, dataclasses.replace(CONFIG, retention="none")).tolist() == [1, 3]


def test_first_and_last_removes_the_middle_of_the_flight() -> None:
    config = dataclasses.replace(CONFIG, retention="first_last", max_in_view=4, max_landmarks=6, max_new_landmarks=0)
    view = view_of(born=[0, 10, 20, 30, 40, 50, 60, 70], in_view=[False] * 8)
    assert rows_to_remove(view, config).tolist() == [3, 4]
    assert rows_to_remove(view_of(born=[0, 10, 20]), config).tolist() == []
    roomy = dataclasses.replace(config, max_new_landmarks=2)
    assert rows_to_remove(view, roomy).tolist() == [2, 3, 4, 5]  # two more, for new ones


def test_the_twentieth_with_the_largest_covariance_is_removed_but_no_new_landmark() -> None:
    config = dataclasses.replace(CONFIG, retention="largest_covariance")
    variance = np.arange(42.0)
    born = np.zeros(42, int)
    born[41] = FRAME  # the most uncertain one was born in this frame
    assert rows_to_remove(view_of(variance=variance, born=born), config).tolist() == [39, 40]


def test_the_cap_removes_the_longest_unseen_mature_landmarks() -> None:
    config = dataclasses.replace(CONFIG, max_in_view=3, max_landmarks=3)
    view = view_of(
        in_view=[True] * 6,
        seen=[90, 80, 80, 70, FRAME, FRAME],
        observations=[9, 9, 8, 9, 9, 9],
        born=[0, 0, 0, FRAME - 4, 0, 0],
    )
    # 3 is young; of the rest 2 and 1 were unseen the longest, then 0
    assert rows_to_remove(view, config).tolist() == [0, 1, 2]


def test_young_landmarks_stay_even_above_the_cap() -> None:
    config = dataclasses.replace(CONFIG, max_in_view=2, max_landmarks=2)
    assert rows_to_remove(view_of(born=[FRAME - 1] * 5), config).tolist() == []
