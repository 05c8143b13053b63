# SPDX-License-Identifier: Apache-2.0
"""A chain of pictures is of one size only where points are in three of them."""

import numpy as np

from uav_vslam.mapping.pictures.rigidity import FEWEST_SHARED, loose_pictures
from uav_vslam.mapping.pictures.tracks import Tracks


def tracks(*seen: tuple[int, ...], points: int = FEWEST_SHARED) -> Tracks:
    """Return so many points for each set of pictures that show them."""
    picture = np.array([k for pictures in seen for _ in range(points) for k in pictures], np.intp)
    lengths = [len(pictures) for pictures in seen for _ in range(points)]
    point = np.repeat(np.arange(len(lengths)), lengths)
    return Tracks(picture, point, np.zeros((len(picture), 2)), len(lengths))


def test_a_chain_with_points_in_three_pictures_is_rigid() -> None:
    assert loose_pictures(tracks((0, 1, 2), (1, 2, 3), (2, 3, 4))).tolist() == []


def test_beyond_a_joint_of_points_in_two_pictures_all_is_loose() -> None:
    seen = tracks((0, 1, 2), (1, 2, 3), (3, 4), (4, 5, 6))
    assert loose_pictures(seen).tolist() == [4, 5, 6]


def test_groups_that_share_one_picture_are_loose_too() -> None:
    """A common camera centre does not tell how long the ways from it are."""
    assert loose_pictures(tracks((0, 1, 2), (1, 2, 3), (3, 4, 5), (4, 5, 6))).tolist() == [4, 5, 6]


def test_a_group_that_joins_the_others_at_both_ends_is_tied() -> None:
    chain = (0, 1, 2), (1, 2, 3), (3, 4), (4, 5, 6)
    assert loose_pictures(tracks(*chain, (0, 6))).tolist() == []
    assert loose_pictures(tracks(*chain, (3, 6))).tolist() == [4, 5, 6], "one picture holds both ends"


def test_a_chain_without_points_in_three_pictures_is_loose_even_if_it_closes() -> None:
    seen = tracks((0, 1, 2), (1, 2, 3), (3, 4), (4, 5), (5, 6), (6, 7), (7, 0))
    assert loose_pictures(seen).tolist() == [4, 5, 6, 7]


def test_a_long_track_ties_all_its_pictures() -> None:
    assert loose_pictures(tracks((0, 1, 2, 3), (0, 1, 8, 9), (8, 9, 10))).tolist() == []


def test_few_points_tie_nothing_and_a_last_picture_is_not_told() -> None:
    few, joint = tracks((2, 3, 4), points=FEWEST_SHARED - 1), tracks((0, 1, 2), (3, 4, 5), (0, 1, 6))
    both = Tracks(
        np.concatenate([few.picture, joint.picture]),
        np.concatenate([few.point, joint.point + few.count]),
        np.concatenate([few.pixels, joint.pixels]),
        few.count + joint.count,
    )
    assert loose_pictures(both).tolist() == [3, 4, 5]
    assert loose_pictures(tracks((0, 1, 2), (2, 3))).tolist() == []


def test_two_pictures_are_of_no_size_anyhow() -> None:
    assert loose_pictures(tracks((0, 1))).tolist() == []
