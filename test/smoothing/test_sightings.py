# SPDX-License-Identifier: Apache-2.0
"""Which features become one point, and which points become one landmark."""

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.slam.landmark_map import LONG_FRAMES
from uav_vslam.smoothing.flight import FilteredFlight, FilteredFrame
from uav_vslam.smoothing.sightings import FEW_TRACKS, LONE_TRACKS, MAX_SPAN, Sightings, gather
from uav_vslam.types import ImuIncrement, NavEstimate, NavState, StereoFeatures

ZERO = np.zeros(3)


def flight(frames: list[list[tuple[int, int]]], going_on: int = 0) -> FilteredFlight:
    """Return a flight of features (track, landmark identifier), each 0 for none; u_left counts them.

    In all frames as many more tracks go on as asked for, whose u_left is -1.
    """
    made, count = [], 0
    for k, seen in enumerate(frames):
        pixels = np.full((len(seen) + going_on, 4), -1.0, np.float32)
        pixels[: len(seen), 0] = count + np.arange(len(seen))
        count += len(seen)
        every = [*seen, *((1000 + more, 0) for more in range(going_on))]
        tracks, ids = (np.array([pair[side] for pair in every], np.uint32) for side in (0, 1))
        features = StereoFeatures(k, pixels, np.zeros((len(every), 0), np.uint8), tracks)
        known = np.flatnonzero(ids)
        made.append(FilteredFrame(state(k), increment(k), features, np.column_stack([ids[known], known]).astype(int)))
    return FilteredFlight.of(NavEstimate(state(0), np.eye(15)), made)


def gathered(frames: list[list[tuple[int, int]]], going_on: int = FEW_TRACKS) -> Sightings:
    """Gather a flight, and leave out the tracks that go on throughout."""
    found = gather(flight(frames, going_on))
    return found.chosen(found.pixels[found.starts, 0] >= 0)


def state(stamp_ns: int) -> NavState:
    return NavState(stamp_ns, Pose.identity(), ZERO, ZERO, ZERO)


def increment(k: int) -> ImuIncrement | None:
    if k == 0:
        return None
    return ImuIncrement(k - 1, k, 1, np.eye(3), *[ZERO] * 8, np.zeros((9, 6)), np.eye(9), 1.0, 1.0)


def points_of(sightings: Sightings) -> list[list[int]]:
    """Return the states of each point."""
    return [sightings.states[sightings.points == k].tolist() for k in range(len(sightings.landmarks))]


def test_a_track_is_a_point_and_single_views_are_none() -> None:
    found = gathered([[(7, 0), (9, 0)], [(7, 0)], [(5, 0), (7, 0)], [(5, 0)]])
    assert points_of(found) == [[0, 1, 2], [2, 3]]
    assert found.pixels[:, 0].tolist() == [0, 2, 4, 3, 5]
    assert found.landmarks.tolist() == [-1, -1]
    assert found.tracked


def test_without_tracks_the_associated_landmark_is_the_point() -> None:
    found = gather(flight([[(0, 3)], [(0, 3), (0, 0)], [(0, 0)]]))
    assert points_of(found) == [[0, 1]]
    assert not found.tracked


@pytest.mark.parametrize(("going_on", "landmarks"), [(FEW_TRACKS, [-1, -1]), (FEW_TRACKS - 1, [0, 0])])
def test_a_new_detection_of_a_landmark_is_another_point_tied_where_hardly_a_track_goes_on(
    going_on: int, landmarks: list[int]
) -> None:
    found = gathered([[(7, 1)], [(7, 1)], [(8, 1)], [(8, 1)]], going_on)
    assert points_of(found) == [[0, 1], [2, 3]]
    assert found.landmarks.tolist() == landmarks


def test_single_views_of_a_landmark_bridge_gaps() -> None:
    found = gather(flight([[(7, 1)], [(8, 1)], [(9, 1), (5, 0)]]))
    assert points_of(found) == [[0], [1], [2]]
    assert found.landmarks.tolist() == [0, 0, 0]


def test_a_landmark_seen_again_after_long_ties_its_visits() -> None:
    empty: list[list[tuple[int, int]]] = [[] for _ in range(LONG_FRAMES)]
    found = gathered([[(7, 1), (6, 2)], [(7, 1), (6, 2)], *empty, [(8, 1)], [(8, 1), (9, 0)], [(9, 0)]])
    assert [found.landmarks[points_of(found).index(states)] for states in ([32, 33], [33, 34])] == [0, -1]
    assert sorted(found.landmarks.tolist()) == [-1, -1, 0, 0]


def test_a_landmark_that_loses_a_visit_closes_no_loop() -> None:
    empty: list[list[tuple[int, int]]] = [[] for _ in range(LONG_FRAMES)]
    found = gathered([[(7, 1)], [(7, 1)], *empty, [(8, 1)], [(8, 1)]])
    assert found.landmarks.tolist() == [0, 0]
    assert found.chosen(np.array([True, False])).landmarks.tolist() == [-1]


@pytest.mark.parametrize("count", [LONE_TRACKS - 1, LONE_TRACKS])
def test_lone_tracks_are_cut(count: int) -> None:
    before, after = ([(first + k, 0) for k in range(LONE_TRACKS)] for first in (20, 60))
    across = [(40 + k, 0) for k in range(count)]
    found = gather(flight([before, before + across, across + after, after]))
    went_on = [[1, 2]] * count if count == LONE_TRACKS else []
    assert points_of(found) == [[0, 1]] * LONE_TRACKS + went_on + [[2, 3]] * LONE_TRACKS


def test_a_long_track_becomes_several_points() -> None:
    found = gathered([[(7, 0)]] * (2 * MAX_SPAN + 2))
    assert [len(states) for states in points_of(found)] == [MAX_SPAN, MAX_SPAN, 2]
    assert found.longest == MAX_SPAN


def test_a_flight_without_features_has_no_points() -> None:
    found = gather(flight([[], [], []]))
    assert len(found.points) == len(found.landmarks) == 0
    assert found.longest == 1
    assert list(found.by_block(8)) == []


def test_a_point_shows_the_landmark_that_it_was_associated_with_most_often() -> None:
    found = gathered([[(7, 4), (8, 0)], [(7, 3), (8, 0)], [(7, 3), (8, 0)]])
    assert found.ids.tolist() == [3, 0]
    assert found.chosen(np.array([False, True])).ids.tolist() == [0]
