# SPDX-License-Identifier: Apache-2.0
"""Scores of one trajectory: known errors appear under their own key alone, and no other frame of the world matters."""

import dataclasses

import numpy as np
import pytest
from evo.core import metrics

from uav_vslam.evaluation.files.reading import read_trajectory
from uav_vslam.evaluation.files.writing import write_csv
from uav_vslam.evaluation.scores import (
    DIRECTIONS,
    ERROR_KEYS,
    NEES_KEYS,
    RELATIVE_KEYS,
    RELATIVE_LENGTHS_M,
    relative_key,
    track_scores,
)
from uav_vslam.evaluation.segments import distances_m, motion_error
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, rotation_from_rpy, so3_exp

EXACT = 1e-9
SHORTER = 1e-3  # the last segments of a path may be a tenth shorter than wanted


def straight(count=301, step_m=2.0, heading=0.3):
    """Return level poses that fly straight on, at START."""
    x = step_m * np.arange(count)
    positions = np.column_stack([np.cos(heading) * x, np.sin(heading) * x, np.full(count, 70.0)])
    R = rotation_from_rpy(np.zeros(count), np.zeros(count), np.full(count, heading))
    return Trajectory(10**8 * np.arange(count, dtype=np.int64), positions, quaternion_wxyz_from_rotation(R))


def moved(trajectory, R, t=(0.0, 0.0, 0.0)):
    """Return a trajectory in another frame of the world."""
    quaternions = quaternion_wxyz_from_rotation(R @ trajectory.rotations)
    return dataclasses.replace(trajectory, positions=trajectory.positions @ R.T + t, quaternions_wxyz=quaternions)


def turned_about_start(trajectory, R):
    return moved(trajectory, R, trajectory.positions[0] - R @ trajectory.positions[0])


def relative(scores, length_m):
    return {what: scores[relative_key(length_m, what)] for what in DIRECTIONS}


@pytest.mark.parametrize("length_m", RELATIVE_LENGTHS_M)
def test_a_scale_error_is_along_the_track_alone(length_m):
    truth = straight()
    longer = dataclasses.replace(truth, positions=truth.positions[0] + 1.02 * (truth.positions - truth.positions[0]))
    found = relative(track_scores(longer, truth), length_m)
    assert found["along_m"] == pytest.approx(0.02 * length_m, rel=SHORTER)
    assert max(found[what] for what in DIRECTIONS[1:]) < EXACT * 1e3


def test_a_step_of_the_height_is_in_the_segments_that_contain_it():
    truth = straight()
    positions = truth.positions.copy()
    positions[150:, 2] += 0.2
    found = relative(track_scores(dataclasses.replace(truth, positions=positions), truth), 14.0)
    assert found["height_m"] == pytest.approx(0.2 * np.sqrt(7 / (301 - 7)))  # 7 steps a segment, one from each pose
    assert max(found[what] for what in ("along_m", "across_m")) < EXACT
    assert track_scores(dataclasses.replace(truth, positions=positions), truth)["height_step_m"] == pytest.approx(0.2)


def test_what_drifts_to_the_left_is_across_and_what_turns_is_attitude():
    truth = straight()
    left = np.array([-np.sin(0.3), np.cos(0.3), 0.0])
    drifting = dataclasses.replace(truth, positions=truth.positions + 0.01 * distances_m(truth)[:, None] * left)
    found = relative(track_scores(drifting, truth), 100.0)
    assert found["across_m"] == pytest.approx(1.0, rel=SHORTER)
    assert found["along_m"] < EXACT
    roll = 1e-5 * distances_m(truth)
    rolling = rotation_from_rpy(roll, np.zeros(301), np.full(301, 0.3))
    rolled = dataclasses.replace(truth, quaternions_wxyz=quaternion_wxyz_from_rotation(rolling))
    assert relative(track_scores(rolled, truth), 100.0)["attitude_mrad"] == pytest.approx(1.0, rel=SHORTER)


@pytest.mark.parametrize("length_m", [14.0, 25.0, 111.0])
def test_the_length_of_the_relative_errors_is_that_of_evo(truth, estimate, length_m):
    from evo.core.trajectory import PoseTrajectory3D

    def evo_rms(relation):
        rpe = metrics.RPE(relation, delta=length_m, delta_unit=metrics.Unit.meters, all_pairs=True,
                          pairs_from_reference=True)  # fmt: skip
        rpe.process_data(
            tuple(PoseTrajectory3D(t.positions, t.quaternions_wxyz, t.stamps_ns * 1e-9) for t in (truth, estimate))
        )
        return rpe.get_statistic(metrics.StatisticsType.rmse)

    error = motion_error(estimate, truth, length_m)
    length = np.sqrt(error.along_m**2 + error.across_m**2 + error.height_m**2)
    assert length == pytest.approx(evo_rms(metrics.PoseRelation.translation_part), rel=EXACT)
    assert error.attitude_rad == pytest.approx(evo_rms(metrics.PoseRelation.rotation_angle_rad), rel=1e-7)


def test_each_alignment_forgives_what_it_is_named_after(truth, estimate):
    heading, tilted = so3_exp([0.0, 0.0, 0.05]), so3_exp([0.03, -0.02, 0.05])
    turned = track_scores(turned_about_start(truth, heading), truth)
    assert turned["ate_m"] > 1.0
    assert turned["ate_start_yaw_m"] < EXACT * 1e3
    lifted = dataclasses.replace(truth, positions=truth.positions + np.array([0.0, 0.0, 0.7]))
    found = track_scores(lifted, truth)
    assert (found["height_rms_m"], found["ate_m"]) == pytest.approx((0.7, 0.7))
    assert found["ate_start_yaw_m"] == pytest.approx(0.7)  # the start is not moved
    anywhere = track_scores(moved(estimate, tilted, (5.0, 6.0, 7.0)), truth)
    assert anywhere["ate_start_yaw_m"] > 1.0
    assert anywhere["ate_se3_m"] == pytest.approx(track_scores(estimate, truth)["ate_se3_m"])


def test_relative_errors_do_not_depend_on_the_frame_of_the_estimate(truth, estimate):
    anywhere = moved(estimate, so3_exp([0.5, -1.0, 2.0]), (100.0, -50.0, 3.0))
    here, there = (track_scores(track, truth) for track in (estimate, anywhere))
    np.testing.assert_allclose([there[key] for key in RELATIVE_KEYS], [here[key] for key in RELATIVE_KEYS], rtol=1e-6)


def test_an_aligned_estimate_keeps_no_consistency(truth, estimate):
    scores = track_scores(estimate, truth, alignment="se3")
    assert scores["ate_m"] == scores["ate_se3_m"]
    assert [scores[key] for key in NEES_KEYS] == [None, None]


def test_a_trajectory_from_a_file_scores_as_the_estimate_that_was_written(truth, estimate, tmp_path):
    read = read_trajectory(write_csv(estimate, tmp_path / "smoothed.csv"))
    here, there = track_scores(estimate, truth), track_scores(read, truth)
    keys = [*ERROR_KEYS, *NEES_KEYS]
    np.testing.assert_allclose([there[key] for key in keys], [here[key] for key in keys], rtol=1e-5)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_poses_or_no_truth_have_no_score_instead_of_a_wrong_one(truth, estimate, count):
    few = track_scores(estimate.select(np.arange(count)), truth)
    assert [few[key] for key in RELATIVE_KEYS] == [None] * len(RELATIVE_KEYS)
    assert (few["ate_m"] is None) == (count == 0)
    blind = track_scores(estimate, None)
    assert {key: value for key, value in blind.items() if value is not None} == {"poses": len(estimate)}
