# SPDX-License-Identifier: Apache-2.0
"""Matches join into one track per ground point; what contradicts itself is no track."""

import numpy as np

from uav_vslam.mapping.pictures.features import PictureFeatures
from uav_vslam.mapping.pictures.pairs import MatchedPair
from uav_vslam.mapping.pictures.tracks import join, strongest

PIXELS = np.arange(8.0).reshape(4, 2)
FEATURES = [PictureFeatures(PIXELS + 100.0 * k, np.zeros((4, 128), np.uint8)) for k in range(3)]


def pair(first: int, second: int, *rows: tuple[int, int]) -> MatchedPair:
    return MatchedPair(first, second, np.array(rows, np.intp), np.eye(2))


def test_a_point_of_three_pictures_is_one_track() -> None:
    tracks = join(FEATURES, [pair(0, 1, (0, 1)), pair(1, 2, (1, 3), (2, 2))])
    assert tracks.count == 2
    assert tracks.picture.tolist() == [0, 1, 2, 1, 2]
    assert tracks.point.tolist() == [0, 0, 0, 1, 1]
    np.testing.assert_array_equal(tracks.pixels[2], FEATURES[2].pixels[3])


def test_a_track_with_two_points_of_one_picture_is_dropped() -> None:
    tracks = join(FEATURES, [pair(0, 1, (0, 1), (2, 2)), pair(1, 2, (1, 3)), pair(0, 2, (1, 3))])
    assert tracks.count == 1
    assert tracks.picture.tolist() == [0, 1]


def test_points_left_with_one_observation_go_too() -> None:
    tracks = join(FEATURES, [pair(0, 1, (0, 1)), pair(1, 2, (1, 3), (2, 2))])
    keep = np.array([True, True, True, True, False])
    assert tracks.chosen(keep).point.tolist() == [0, 0, 0]
    assert tracks.of(keep).tolist() == [0]


def test_the_longest_tracks_of_each_picture_are_chosen() -> None:
    tracks = join(FEATURES, [pair(0, 1, (0, 1), (3, 3)), pair(1, 2, (1, 3))])
    chosen = strongest(tracks, 3, 1, [(300, 300)] * 3)
    assert tracks.chosen(chosen).picture.tolist() == [0, 1, 2]
