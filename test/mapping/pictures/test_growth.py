# SPDX-License-Identifier: Apache-2.0
"""Pictures of a banked turn, which no flat layout fits, are placed one after the other; a torn mosaic says so."""

from dataclasses import replace

import numpy as np
import pytest
from orbit_pictures import Orbit, orbit
from picture_folder import HEIGHT_M
from similarity_errors import similarity_errors

from uav_vslam.mapping.pictures.agreement import agreeing, torn
from uav_vslam.mapping.pictures.growth import SEED_PICTURES, seed_of
from uav_vslam.mapping.pictures.pairs import MatchedPair
from uav_vslam.mapping.pictures.reconstruction import Reconstruction, reconstruct


@pytest.fixture(scope="module")
def flown() -> Orbit:
    """A circle that closes."""
    return orbit()


@pytest.fixture(scope="module")
def found(flown: Orbit) -> Reconstruction:
    """What its pictures tell."""
    return reconstruct(flown.pictures, flown.features, flown.pairs, height_m=HEIGHT_M)


def test_a_banked_circle_closes(flown: Orbit, found: Reconstruction) -> None:
    assert found.adjusted.used.tolist() == list(range(len(flown.pictures)))
    assert similarity_errors(found.adjusted.scene.centres, flown.centres).max() < 0.05
    assert found.pairs == len(flown.pairs)
    assert not any("torn" in text or "uncertain: where they join" in text for text in found.warnings)


def test_it_begins_with_pictures_that_share_most(flown: Orbit) -> None:
    seed = seed_of(len(flown.pictures), flown.pairs)
    assert len(seed) == SEED_PICTURES
    spread = np.linalg.norm(flown.centres[seed] - flown.centres[seed].mean(axis=0), axis=1)
    assert spread.max() < 45.0


def joined_by_two(flown: Orbit, middle: int) -> list[MatchedPair]:
    """Return pairs of two halves that are joined by points of pictures `middle` - 1 and `middle` alone."""
    (joint,) = [pair for pair in flown.pairs if (pair.first, pair.second) == (middle - 1, middle)]
    joint = replace(joint, rows=joint.rows[::2])
    of_joint = dict(zip((joint.first, joint.second), joint.rows.T, strict=True))
    pairs = [joint]
    for pair in flown.pairs:
        if pair.second - pair.first > 2 or pair.first < middle <= pair.second:
            continue
        taken = [np.isin(pair.rows[:, end], of_joint.get(k, [])) for end, k in enumerate((pair.first, pair.second))]
        pairs.append(replace(pair, rows=pair.rows[~(taken[0] | taken[1])]))
    return pairs


def test_pictures_that_one_neighbour_alone_holds_are_placed_by_the_ground(flown: Orbit) -> None:
    """Their points are seen by one picture placed before, and have no position yet; nothing else tells their size."""
    middle = len(flown.pictures) // 2
    found = reconstruct(flown.pictures, flown.features, joined_by_two(flown, middle), height_m=HEIGHT_M)
    assert found.adjusted.used.tolist() == list(range(len(flown.pictures)))
    assert similarity_errors(found.adjusted.scene.centres, flown.centres).max() < 0.5
    assert any(f"the place and size of {middle} pictures are uncertain" in text for text in found.warnings)


def test_a_torn_result_is_told(flown: Orbit, found: Reconstruction) -> None:
    scene, count = found.adjusted.scene, len(flown.pictures)
    later = np.arange(count) >= 25
    moved = replace(scene, centres=scene.centres + np.where(later, 100.0, 0.0)[:, None] * np.array([1.0, 0.0, 0.0]))
    adjusted = replace(found.adjusted, scene=moved)
    agree = agreeing(adjusted, flown.pairs, flown.features, flown.pictures)
    expected = [later[pair.first] == later[pair.second] for pair in flown.pairs]
    assert agree.tolist() == expected
    apart = torn(flown.pairs, agree, adjusted.used)
    assert (24, 25) in {(pair.first, pair.second) for pair in apart}
    assert all(later[pair.first] != later[pair.second] for pair in apart)
