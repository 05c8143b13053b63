# SPDX-License-Identifier: Apache-2.0
"""Identifiers are never reused, and rows stay consistent."""

import numpy as np

from uav_vslam.slam.landmark_map import LONG_FRAMES, LandmarkMap


def descriptors(*values: int) -> np.ndarray:
    return np.array([[v] * 128 for v in values], np.uint8).reshape(-1, 128)


def untracked(count: int) -> np.ndarray:
    return np.zeros(count, np.uint32)


def test_new_landmarks_get_new_identifiers_even_after_a_removal() -> None:
    landmark_map = LandmarkMap()
    landmark_map.append(descriptors(1, 2, 3), 0, untracked(3))
    landmark_map.remove(np.array([1, 2]))
    landmark_map.append(descriptors(4), 5, untracked(1))
    assert landmark_map.ids.tolist() == [1, 4]
    assert landmark_map.born.tolist() == [0, 5]
    assert landmark_map.descriptors[:, 0].tolist() == [1, 4]
    assert len(landmark_map) == 2


def test_an_observation_replaces_the_descriptor_and_counts() -> None:
    landmark_map = LandmarkMap()
    landmark_map.append(descriptors(1, 2, 3), 0, untracked(3))
    landmark_map.observe(np.array([2, 0]), descriptors(9, 8), 7, untracked(2))
    assert landmark_map.descriptors[:, 0].tolist() == [8, 2, 9]
    assert landmark_map.seen.tolist() == [7, 0, 7]
    assert landmark_map.born.tolist() == [0, 0, 0]
    assert landmark_map.observations.tolist() == [2, 1, 2]


def test_a_continued_track_adds_no_view() -> None:
    landmark_map = LandmarkMap()
    landmark_map.append(descriptors(1, 2), 0, untracked(2))
    for frame in range(1, 9):
        landmark_map.observe(np.array([0, 1]), descriptors(1, 2 + frame), frame, untracked(2))
    assert landmark_map.statistics.count.tolist() == [1, 9]
    assert landmark_map.observations.tolist() == [9, 9]


def test_a_landmark_is_long_unseen_until_it_is_observed_again() -> None:
    landmark_map = LandmarkMap()
    landmark_map.append(descriptors(1, 2, 3), 0, untracked(3))
    landmark_map.observe(np.array([1]), descriptors(9), 1, untracked(1))
    assert landmark_map.long_unseen(LONG_FRAMES - 1).tolist() == [False, False, False]
    assert landmark_map.long_unseen(LONG_FRAMES).tolist() == [True, False, True]
    landmark_map.observe(np.array([2]), descriptors(9), LONG_FRAMES, untracked(1))
    assert landmark_map.long_unseen(LONG_FRAMES).tolist() == [True, False, False]


def test_nothing_appended_seen_or_removed_changes_nothing() -> None:
    landmark_map = LandmarkMap()
    none = np.zeros(0, np.intp)
    for size in (0, 2):
        landmark_map.append(descriptors(*range(size)), 0, untracked(size))
        landmark_map.append(descriptors(), 1, untracked(0))
        landmark_map.observe(none, descriptors(), 1, untracked(0))
        landmark_map.remove(none)
        assert len(landmark_map) == len(landmark_map.descriptors) == len(landmark_map.seen) == size


def test_the_first_landmarks_decide_the_descriptors_length() -> None:
    landmark_map = LandmarkMap()
    landmark_map.append(np.ones((2, 64), np.uint8), 0, untracked(2))
    assert landmark_map.descriptors.shape == (2, 64)


def test_identifiers_stay_32_bit() -> None:
    landmark_map = LandmarkMap()
    landmark_map.append(descriptors(1, 2), 0, untracked(2))
    assert landmark_map.ids.dtype == np.uint32


def test_a_track_observes_one_landmark_only():
    landmark_map = LandmarkMap()
    landmark_map.append(np.zeros((3, 128), np.uint8), 0, np.array([5, 6, 7], np.uint32))
    landmark_map.observe(np.array([0]), np.ones((1, 128), np.uint8), 1, np.array([7], np.uint32))
    assert landmark_map.tracks.tolist() == [7, 6, 0]
    landmark_map.remove(np.array([1]))
    assert landmark_map.tracks.tolist() == [7, 0]
    landmark_map.observe(np.array([0]), np.ones((1, 128), np.uint8), 2, untracked(1))
    assert landmark_map.tracks.tolist() == [0, 0]
