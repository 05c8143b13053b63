# SPDX-License-Identifier: Apache-2.0
"""Maps are moved without changing what they know, and landmarks are mistaken the same way all flight long."""

import numpy as np
import pytest

from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.separate_frames import (
    SHIFT_M,
    OwnOnlyTracks,
    draw_offset,
    fly_own_only,
    identities,
    in_other_frame,
    mistaken,
)

FRAMES = 24


@pytest.fixture(scope="module")
def flown() -> OwnOnlyTracks:
    return fly_own_only(Scenario(seed=3, frames=FRAMES))


def joints(flown: OwnOnlyTracks, vehicle: str):
    return [output.joint for output in flown.tracks[vehicle].outputs if output.joint is not None]


def ate(flown: OwnOnlyTracks, vehicle: str) -> float:
    estimate = Trajectory.from_estimates(flown.tracks[vehicle].poses)
    error = absolute_error(estimate, flown.truths[vehicle])
    assert error is not None
    return error.ate_m


def test_offsets_are_level_and_as_far_as_they_should_be() -> None:
    offsets = [draw_offset(seed) for seed in range(50)]
    lengths = [np.linalg.norm(T.t) for T in offsets]
    assert SHIFT_M[0] <= min(lengths) < 10.0
    assert 40.0 < max(lengths) <= SHIFT_M[1]
    yaws = [np.arctan2(T.R[1, 0], T.R[0, 0]) for T in offsets]
    assert min(yaws) < -2.5
    assert max(yaws) > 2.5
    assert all(T.R[2, 2] == 1.0 for T in offsets)
    np.testing.assert_array_equal(draw_offset(7).matrix, offsets[7].matrix)


def test_a_map_in_another_frame_has_the_same_information(flown: OwnOnlyTracks) -> None:
    T = draw_offset(1)
    apart = in_other_frame(flown, "uav2", T)
    assert apart.tracks["uav1"] is flown.tracks["uav1"]
    for before, after in zip(joints(flown, "uav2"), joints(apart, "uav2"), strict=True):
        in_body = before.T_map_body.inverse().apply(before.positions)
        np.testing.assert_allclose(after.T_map_body.inverse().apply(after.positions), in_body, atol=1e-9)
        np.testing.assert_allclose(after.positions, T.apply(before.positions))
        np.testing.assert_allclose(
            np.linalg.eigvalsh(after.information), np.linalg.eigvalsh(before.information), rtol=1e-6, atol=1e-6
        )
        np.testing.assert_allclose(after.information[:3, 6:9], T.R @ before.information[:3, 6:9] @ T.R.T, atol=1e-6)
    assert ate(apart, "uav2") == pytest.approx(ate(flown, "uav2"), rel=1e-9)
    pose, moved = (f.tracks["uav2"].outputs[-1].report.pose for f in (flown, apart))
    np.testing.assert_allclose(moved.covariance[3:, 3:], T.R @ pose.covariance[3:, 3:] @ T.R.T, atol=1e-12)


def test_identities_are_where_the_landmarks_are(flown: OwnOnlyTracks) -> None:
    """They are found by looks; that their places agree shows that they are right."""
    names = identities(flown, "uav1")
    last = joints(flown, "uav1")[-1]
    assert set(last.ids.tolist()) <= set(names)
    true = flown.landmarks.points_world[[names[k] for k in last.ids.tolist()]]
    assert np.median(np.linalg.norm(last.positions - true, axis=1)) < 2.0
    assert np.linalg.norm((last.positions - true)[:, :2], axis=1).max() < 15.0


def test_mistaken_landmarks_look_like_others_and_stay_where_they_are(flown: OwnOnlyTracks) -> None:
    names = identities(flown, "uav2")
    among = sorted(names)[::2]
    modified, wrong = mistaken(flown, "uav2", 0.5, 4, among=among)
    assert wrong < set(among)
    assert 0.3 * len(among) < len(wrong) < 0.7 * len(among)
    for before, after in zip(joints(flown, "uav2"), joints(modified, "uav2"), strict=True):
        np.testing.assert_array_equal(after.positions, before.positions)
        changed = (after.descriptors != before.descriptors).any(axis=1)
        expected = np.array([k in wrong for k in before.ids.tolist()])
        np.testing.assert_array_equal(changed, expected if expected.sum() > 1 else np.zeros_like(expected))
        assert sorted(map(bytes, after.descriptors)) == sorted(map(bytes, before.descriptors))
    again, same = mistaken(flown, "uav2", 0.5, 4, among=among)
    assert same == wrong
    np.testing.assert_array_equal(joints(again, "uav2")[-1].descriptors, joints(modified, "uav2")[-1].descriptors)


def test_no_share_mistakes_nothing(flown: OwnOnlyTracks) -> None:
    modified, wrong = mistaken(flown, "uav2", 0.0, 4, among=identities(flown, "uav2"))
    assert wrong == set()
    np.testing.assert_array_equal(joints(modified, "uav2")[-1].descriptors, joints(flown, "uav2")[-1].descriptors)
