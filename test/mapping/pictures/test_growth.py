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
    assert not any("torn" in text for text in found.warnings)


def test_it_begins_with_pictures_that_share_most(flown: Orbit) -> None:
    seed = seed_of(len(flown.pictures), flown.pairs)
    assert len(seed) == SEED_PICTURES
    spread = np.linalg.norm(flown.centres[seed] - flown.centres[seed].mean(axis=0), axis=1)
    assert spread.max() < 45.0


def test_pictures_that_one_neighbour_alone_holds_are_placed_by_the_ground(flown: Orbit) -> None:
    """Their points are seen by one picture placed before, and have no position yet."""
    middle = len(flown.pictures) // 2
    pairs = [
        pair
        for pair in flown.pairs
        if pair.second - pair.first <= 2 and not (pair.first < middle <= pair.second and pair.second - pair.first > 1)
    ]
    found = reconstruct(flown.pictures, flown.features, pairs, height_m=HEIGHT_M)
    assert found.adjusted.used.tolist() == list(range(len(flown.pictures)))
    assert similarity_errors(found.adjusted.scene.centres, flown.centres).max() < 1.0


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
