# SPDX-License-Identifier: Apache-2.0
"""Which features become one point, and which points become one landmark."""

import numpy as np

from uav_vslam.geometry.pose import Pose
from uav_vslam.slam.landmark_map import LONG_FRAMES
from uav_vslam.smoothing.flight import FilteredFlight, FilteredFrame
from uav_vslam.smoothing.sightings import MAX_SPAN, Sightings, gather
from uav_vslam.types import ImuIncrement, NavEstimate, NavState, StereoFeatures

ZERO = np.zeros(3)


def flight(frames: list[list[tuple[int, int]]]) -> FilteredFlight:
    """Return a flight of features (track, landmark identifier), each 0 for none; u_left counts the features."""
    made, count = [], 0
    for k, seen in enumerate(frames):
        pixels = np.zeros((len(seen), 4), np.float32)
        pixels[:, 0] = count + np.arange(len(seen))
        count += len(seen)
        tracks, ids = (np.array([pair[side] for pair in seen], np.uint32) for side in (0, 1))
        features = StereoFeatures(k, pixels, np.zeros((len(seen), 0), np.uint8), tracks)
        known = np.flatnonzero(ids)
        made.append(FilteredFrame(state(k), increment(k), features, np.column_stack([ids[known], known]).astype(int)))
    return FilteredFlight.of(NavEstimate(state(0), np.eye(15)), made)


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
    found = gather(flight([[(7, 0), (9, 0)], [(7, 0)], [(5, 0), (7, 0)], [(5, 0)]]))
    assert points_of(found) == [[0, 1, 2], [2, 3]]
    assert found.pixels[:, 0].tolist() == [0, 2, 4, 3, 5]
    assert found.landmarks.tolist() == [-1, -1]
    assert found.tracked


def test_without_tracks_the_associated_landmark_is_the_point() -> None:
    found = gather(flight([[(0, 3)], [(0, 3), (0, 0)], [(0, 0)]]))
    assert points_of(found) == [[0, 1]]
    assert not found.tracked


def test_a_new_detection_of_a_landmark_is_another_point() -> None:
    found = gather(flight([[(7, 1)], [(7, 1)], [(8, 1)], [(8, 1)]]))
    assert points_of(found) == [[0, 1], [2, 3]]
    assert found.landmarks.tolist() == [-1, -1]


def test_a_landmark_seen_again_after_long_ties_its_visits() -> None:
    empty: list[list[tuple[int, int]]] = [[] for _ in range(LONG_FRAMES)]
    found = gather(flight([[(7, 1), (6, 2)], [(7, 1), (6, 2)], *empty, [(8, 1)], [(8, 1), (9, 0)], [(9, 0)]]))
    assert [found.landmarks[points_of(found).index(states)] for states in ([32, 33], [33, 34])] == [0, -1]
    assert sorted(found.landmarks.tolist()) == [-1, -1, 0, 0]


def test_a_landmark_that_loses_a_visit_closes_no_loop() -> None:
    empty: list[list[tuple[int, int]]] = [[] for _ in range(LONG_FRAMES)]
    found = gather(flight([[(7, 1)], [(7, 1)], *empty, [(8, 1)], [(8, 1)]]))
    assert found.landmarks.tolist() == [0, 0]
    assert found.chosen(np.array([True, False])).landmarks.tolist() == [-1]


def test_a_long_track_becomes_several_points() -> None:
    found = gather(flight([[(7, 0)]] * (2 * MAX_SPAN + 2)))
    assert [len(states) for states in points_of(found)] == [MAX_SPAN, MAX_SPAN, 2]
    assert found.longest == MAX_SPAN


def test_a_flight_without_features_has_no_points() -> None:
    found = gather(flight([[], [], []]))
    assert len(found.points) == len(found.landmarks) == 0
    assert found.longest == 1
    assert list(found.by_block(8)) == []


def test_a_point_shows_the_landmark_that_it_was_associated_with_most_often() -> None:
    found = gather(flight([[(7, 4), (8, 0)], [(7, 3), (8, 0)], [(7, 3), (8, 0)]]))
    assert found.ids.tolist() == [3, 0]
    assert found.chosen(np.array([False, True])).ids.tolist() == [0]
