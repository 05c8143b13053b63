# SPDX-License-Identifier: Apache-2.0
"""The contract of every associator."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.association import ASSOCIATORS
from uav_vslam.association.nearest import FINE_MATCHES
from uav_vslam.config import ASSOCIATIONS, BackendConfig

CONFIG = BackendConfig()


@pytest.fixture(params=sorted(ASSOCIATORS))
def name(request):
    return request.param


def test_the_configuration_has_all_names():
    assert set(ASSOCIATIONS) == set(ASSOCIATORS)


def test_landmarks_are_reobserved(scene, name):
    in_view, seen = scene(80)
    pairs = ASSOCIATORS[name](in_view, seen, CONFIG)
    np.testing.assert_array_equal(pairs[:, 0], pairs[:, 1])
    least = {"cds": 8, "coarse_fine": FINE_MATCHES, "gtm": 60, "gated_gtm": 60}.get(name, 80)
    assert len(pairs) >= least


@pytest.mark.parametrize(("landmarks", "features"), [(0, 0), (0, 9), (9, 0)])
def test_empty_input_gives_no_pairs(scene, name, landmarks, features):
    in_view, seen = scene(landmarks)[0], scene(features)[1]
    pairs = ASSOCIATORS[name](in_view, seen, CONFIG)
    assert pairs.shape == (0, 2)
    assert np.issubdtype(pairs.dtype, np.integer)


@pytest.mark.parametrize(("landmarks", "features"), [(1, 1), (1, 9), (9, 1), (2, 2), (3, 3)])
def test_few_points_are_handled(scene, name, landmarks, features):
    pairs = ASSOCIATORS[name](scene(landmarks)[0], scene(features, seed=2)[1], CONFIG)
    assert pairs.shape[1] == 2
    assert len(pairs) <= min(landmarks, features)


def test_equal_descriptors_at_one_place_are_rejected_or_resolved(scene, name):
    """All features have landmark 0's descriptor; a reduced frame may keep only one of them."""
    in_view, seen = scene(30)
    in_view = dataclasses.replace(in_view, expected=np.tile(in_view.expected[:1], (30, 1)))
    same = dataclasses.replace(
        seen, pixels=np.tile(seen.pixels[:1], (30, 1)), descriptors=np.tile(seen.descriptors[:1], (30, 1))
    )
    assert ASSOCIATORS[name](in_view, same, CONFIG)[:, 0].tolist() in ([], [0])


def test_nothing_is_used_twice(scene, name):
    """Many landmarks with similar descriptors: uniqueness is ensured by the associator."""
    in_view, seen = scene(200, noise=60.0)[0], scene(150, seed=1, noise=60.0)[1]
    pairs = ASSOCIATORS[name](in_view, seen, CONFIG)
    assert (np.diff(pairs[:, 0]) > 0).all()
    assert len(np.unique(pairs[:, 1])) == len(pairs)


def test_association_is_deterministic_and_does_not_modify_its_input(scene, name):
    in_view, seen = scene(60, noise=40.0)
    kept = [
        in_view.expected,
        in_view.S,
        in_view.descriptors,
        in_view.statistics.mean,
        in_view.statistics.scatter,
        seen.pixels,
    ]
    copies = [array.copy() for array in kept]
    first, second = (ASSOCIATORS[name](in_view, seen, CONFIG) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    for array, copy in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("strict", ["gated", "gated_classification", "ransac", "gtm", "hgtm", "gated_hgtm"])
def test_a_swapped_descriptor_elsewhere_is_rejected(scene, strict):
    """Ten features swap their descriptors, so each matches where another landmark is predicted."""
    in_view, seen = scene(80)
    swapped = np.arange(80)
    swapped[:10] = np.roll(swapped[:10], 1)
    misled = dataclasses.replace(seen, descriptors=seen.descriptors[swapped])
    pairs = ASSOCIATORS[strict](in_view, misled, CONFIG)
    assert (pairs[:, 0] == pairs[:, 1]).all()
    assert len(pairs) > 40
    assert (ASSOCIATORS["nn"](in_view, misled, CONFIG)[:10] != ASSOCIATORS["nn"](in_view, seen, CONFIG)[:10]).any()
