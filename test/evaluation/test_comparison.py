# SPDX-License-Identifier: Apache-2.0
"""Several runs against their truth: each figure is that of its own definition, and nothing pairs silently."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.errors import TrajectoryFileError
from uav_vslam.evaluation.alignment import ALIGNMENTS
from uav_vslam.evaluation.clock_offset import later
from uav_vslam.evaluation.comparison import Run, aligned_positions, compare, pair_run
from uav_vslam.evaluation.consistency import nees, summarise
from uav_vslam.evaluation.trajectory_error import absolute_error


def figures(estimate, truth, **settings):
    (found,) = compare([pair_run(Run("a", "", estimate, truth))], name="test", git=None, **settings)["runs"]
    return found


@pytest.mark.parametrize("alignment", ALIGNMENTS)
def test_each_error_is_named_by_its_alignment(truth, estimate, alignment):
    shifted = dataclasses.replace(estimate, positions=estimate.positions + np.array([3.0, -2.0, 1.0]))
    error = absolute_error(shifted, truth, alignment=alignment)
    found = figures(shifted, truth)
    assert found["ate_m"][alignment] == error.ate_m
    assert found["end_m"][alignment] == error.end_m
    positions = aligned_positions(pair_run(Run("a", "", shifted, truth)), alignment)
    assert np.sqrt(np.mean(np.sum((positions - truth.positions) ** 2, axis=1))) == pytest.approx(error.ate_m)


def test_more_freedom_never_leaves_a_larger_error(truth, estimate):
    ate_m = figures(estimate, truth)["ate_m"]
    assert ate_m["se3"] <= ate_m["yaw"] <= min(ate_m["none"], ate_m["start-yaw"], ate_m["start-pose"])
    assert ate_m["start-yaw"] <= ate_m["none"]


def test_nees_is_that_of_the_given_covariance_and_absent_without(truth, estimate):
    expected = nees(estimate, truth)
    found = figures(estimate, truth)
    assert found["nees_position"] == pytest.approx(summarise(expected.position).mean)
    assert found["nees_rotation"] == pytest.approx(summarise(expected.rotation).mean)
    assert figures(dataclasses.replace(estimate, covariance=None), truth)["nees_position"] is None


def test_the_distance_is_that_of_the_whole_truth_between_sparse_poses(truth, estimate):
    rows = np.arange(10, 120, 50)
    run = pair_run(Run("a", "", estimate.select(rows), truth))
    assert run.flown_m[-1] == pytest.approx(truth.select(np.arange(10, 111)).path_length_m)
    assert run.flown_m[-1] > run.truth.path_length_m  # a polygon through the three poses is shorter
    assert len(run.true_path) == 101


def test_the_shortest_path_chooses_the_segments_of_all_unless_they_are_given(truth, estimate):
    runs = [pair_run(Run("a", "", estimate.select(rows), truth)) for rows in (np.arange(120), np.arange(60))]
    tree = compare(runs, name="test", git=None)
    assert tree["segments_m"][-1] == pytest.approx(0.5 * runs[1].truth.path_length_m, rel=0.05)
    assert [len(run["rpe_by_segment"]) for run in tree["runs"]] == [5, 5]
    assert compare(runs, name="test", git=None, lengths_m=[30.0])["segments_m"] == [30.0]


def test_a_single_pose_has_an_error_but_no_drift(truth, estimate):
    found = figures(estimate.select(np.arange(1)), truth)
    assert found["ate_m"]["none"] > 0.0
    assert (found["rpe"]["translation_percent"], found["rpe_by_segment"]) == (None, [])


def test_an_alignment_that_one_pose_does_not_determine_is_no_success(truth, estimate):
    ate_m = figures(estimate.select(np.arange(1)), truth)["ate_m"]
    assert {name for name in ALIGNMENTS if ate_m[name] is None} == set(ALIGNMENTS) - {"none"}  # it was 0.000 m
    assert None not in figures(estimate.select(np.arange(2)), truth)["ate_m"].values()


def test_no_common_time_is_told_with_both_spans(truth, estimate):
    with pytest.raises(TrajectoryFileError, match=r"b: no pose has ground truth: its stamps are 17000\d+.* same clock"):
        pair_run(Run("b", "", later(estimate, 100.0), truth))


def test_nanoseconds_taken_for_seconds_are_suspected(truth, estimate):
    boot = later(truth, -1_700_000_000)
    in_wrong_unit = dataclasses.replace(estimate, stamps_ns=(estimate.stamps_ns - 1_700_000_000_000_000_000) * 10**6)
    with pytest.raises(TrajectoryFileError, match=r"is one of them in another unit\?"):
        pair_run(Run("b", "", in_wrong_unit.select(np.arange(50, 120)), boot))


def test_a_sparse_truth_is_told_and_can_be_allowed(truth, estimate):
    sparse, between = truth.select(np.arange(0, 120, 20)), estimate.select(np.arange(5, 115, 20))
    with pytest.raises(
        TrajectoryFileError, match=r"truth's poses are 2.00 s apart; allow it by --max-gap \(now 0.5 s\)"
    ):
        pair_run(Run("b", "", between, sparse))
    assert len(pair_run(Run("b", "", between, sparse), max_gap_s=2.0).estimate) == len(between) - 1
