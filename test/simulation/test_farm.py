# SPDX-License-Identifier: Apache-2.0
"""A farm is the same in every window and any order, and holds what it should in sensible density."""

import itertools

import cv2
import numpy as np
import pytest

from uav_vslam.simulation.farm import Farm
from uav_vslam.simulation.fields import FIELD_M, corner, is_track, outline, places
from uav_vslam.simulation.ridged import Ridged
from uav_vslam.simulation.solids import Label
from uav_vslam.simulation.terrain import Relief

SIDE_M = 540.0
HIGHEST_M = 10.0  # nothing stands higher above the ground
WINDOW = -0.5 * SIDE_M, -0.5 * SIDE_M, 0.5 * SIDE_M, 0.5 * SIDE_M


def new_farm(seed: int = 4) -> Farm:
    return Farm(seed, Relief(2.0, np.random.default_rng(1)).height)


@pytest.fixture(scope="module")
def farm() -> Farm:
    return new_farm()


@pytest.mark.slow
def test_a_small_window_holds_what_a_large_one_holds_there(farm: Farm) -> None:
    everything, other = farm.solids(WINDOW), new_farm()
    for west, south in itertools.product(np.arange(-200.0, 200.0, 77.0), repeat=2):
        box = west, south, west + 20.0, south + 35.0
        inside = [
            solid
            for solid in everything
            if solid.bounds[0] <= box[2] and solid.bounds[1] <= box[3] and solid.bounds[2] >= box[0]
            if solid.bounds[3] >= box[1]
        ]
        found = other.solids(box)
        assert sorted(map(repr, found)) == sorted(map(repr, inside))


def test_another_seed_is_another_farm() -> None:
    box = -50.0, -50.0, 50.0, 50.0
    assert repr(new_farm(4).solids(box)) == repr(new_farm(4).solids(box))
    assert repr(new_farm(4).solids(box)) != repr(new_farm(5).solids(box))


def test_solids_have_sensible_sizes_and_density(farm: Farm) -> None:
    solids = farm.solids(WINDOW)
    of = {label: [solid for solid in solids if solid.label == label] for label in Label}
    barns = [solid for solid in of[Label.BARN] if isinstance(solid, Ridged)]
    assert 0.01 < sum(b.length_m * b.width_m for b in barns) / SIDE_M**2 < 0.03
    for low, high, label in ((3.0, 7.0, Label.BARN), (1.5, 3.0, Label.HEDGE), (4.0, 6.0, Label.POST)):
        for solid in of[label]:
            assert isinstance(solid, Ridged)
            above = solid.ridge_z - float(farm.ground_z(np.array([solid.x]), np.array([solid.y]))[0])
            assert low - 0.1 <= above <= high + 0.1
    for solid in solids:
        middle = np.array([[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5]]) @ solid.bounds
        ground = float(farm.ground_z(middle[:1], middle[1:])[0])
        assert solid.foot_z < ground - 2.0
        assert solid.highest_z < ground + HIGHEST_M
    assert len(of[Label.TREE]) > 5 * 3 * (SIDE_M / FIELD_M) ** 2
    assert len(of[Label.POST]) > (SIDE_M / FIELD_M) ** 2


def test_barns_stand_free_of_each_other_and_of_hedges(farm: Farm) -> None:
    solids = [s for s in farm.solids(WINDOW) if isinstance(s, Ridged) and s.label in (Label.BARN, Label.HEDGE)]
    for one, other in itertools.combinations(solids, 2):
        if Label.BARN in (one.label, other.label) and np.hypot(one.x - other.x, one.y - other.y) < 30.0:
            common = cv2.intersectConvexConvex(one.footprint.astype(np.float32), other.footprint.astype(np.float32))[0]
            assert common == 0.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_place_is_in_exactly_the_field_that_contains_it(seed: int) -> None:
    x, y = np.random.default_rng(seed).uniform(-400.0, 400.0, (2, 400))
    found = places(x, y, seed).field
    for k in range(len(x)):
        polygon = outline(*found[k], seed).astype(np.float32)
        assert cv2.pointPolygonTest(polygon, (float(x[k]), float(y[k])), True) > -1e-3


def test_a_track_is_straight_from_corner_to_corner() -> None:
    start, end = corner(3, 2, 7), corner(4, 2, 7)
    assert is_track(2)
    assert not is_track(3)
    along = (end - start) / np.hypot(*(end - start))
    side = np.array([-along[1], along[0]])
    for off in (-5.0, -0.8, 0.8, 5.0):
        xy = start + np.linspace(0.2, 0.8, 50)[:, None] * (end - start) + off * side
        np.testing.assert_allclose(places(xy[:, 0], xy[:, 1], 7).track_m, abs(off), atol=1e-9)


def test_no_places_have_no_fields(farm: Farm) -> None:
    assert places(np.zeros(0), np.zeros(0), 1).field.shape == (0, 2)
    assert len(farm.solids((0.0, 0.0, 0.0, 0.0))) < 10
