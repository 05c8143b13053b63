# SPDX-License-Identifier: Apache-2.0
"""Two vehicles find each other's maps, and their errors are those of the maps, not of the yardstick."""

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.apart import Flown, fly_own_only
from uav_vslam.studies.association_stages import STAGES, UNKNOWN_FRAME, Identities
from uav_vslam.studies.frames import OWN, PEER, TRACKS, alignment_error, map_to_map, run_together

FRAMES = 36  # five seconds


@pytest.fixture(scope="module")
def flown() -> Flown:
    return fly_own_only(Scenario(seed=1, frames=FRAMES))


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_vehicles_find_each_others_maps(flown: Flown, share: float) -> None:
    run = run_together(flown, 1, share)
    assert run.first is not None
    assert run.first.after_s < 5.0
    assert run.first.used.wrong == 0
    assert run.first.used.left >= 8
    assert run.errors[0, 0] < 1.5
    assert run.errors[0, 1] < 1.0
    assert run.first.nees < 5.0
    assert (run.first.matches.wrong > 0) == (share > 0)


def test_a_run_is_judged_in_every_respect(flown: Flown) -> None:
    run = run_together(flown, 1, 0.3)
    assert run.share == 0.3
    assert set(run.stages) == {*STAGES, UNKNOWN_FRAME}
    assert run.stages["ratio"].left > 0
    for figures in (run.ate_m, run.pose_nees):
        assert set(figures) == {OWN, PEER}
        assert all(set(by_track) == set(TRACKS) for by_track in figures.values())
    assert run.ate_m[PEER]["unknown"] < 2.0  # in any other frame it would be tens of metres
    assert run.ate_m[OWN]["unknown"] != run.ate_m[OWN]["alone"]


def test_vehicles_that_share_too_little_stay_apart(flown: Flown) -> None:
    run = run_together(flown, 1, 1.0)  # all that they share looks wrong
    assert run.first is None
    assert run.errors.shape == (0, 2)
    assert run.ate_m[OWN]["unknown"] == pytest.approx(run.ate_m[OWN]["alone"], rel=1e-12)


def test_the_yardstick_is_the_transform_between_equal_shapes(make_joint) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-30, 30, (6, 3))
    T = Pose(rotation_from_rpy(0.0, 0.0, -2.0), np.array([9.0, -40.0, 3.0]))
    own = make_joint(points[:5], np.eye(21))
    peer = make_joint(T.inverse().apply(points[[5, 3, 1, 0]]), np.eye(18), vehicle="uav2")
    truth = Identities({k + 1: k for k in range(5)}, {1: 5, 2: 3, 3: 1, 4: 0})
    found, centre = map_to_map(own, peer, truth)
    np.testing.assert_allclose(found.matrix, T.matrix, atol=1e-9)
    np.testing.assert_allclose(T.apply(centre), points[[3, 1, 0]].mean(axis=0))


def test_errors_are_at_the_centre_and_in_degrees() -> None:
    centre = np.array([100.0, 0.0, 0.0])
    T = Pose(np.eye(3), np.array([1.0, 2.0, 3.0]))
    turned = Pose(rotation_from_rpy(0.0, 0.0, np.deg2rad(-2.0)), T.t)
    metres, degrees = alignment_error(turned, T, centre)
    assert metres == pytest.approx(200.0 * np.sin(np.deg2rad(1.0)))
    assert degrees == pytest.approx(2.0)
