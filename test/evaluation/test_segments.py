# SPDX-License-Identifier: Apache-2.0
"""Drift per distance; reference: `evo`, which pairs poses by path in the same way."""

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D

from uav_vslam.evaluation.segments import default_lengths_m, distances_m, pooled, segment_errors
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, rotation_from_rpy

TOLERANCE = 1e-9  # two implementations in double precision


def straight(count=501, step_m=2.0, scale=1.0, yaw_per_m=0.0):
    """Return poses along x with a scale error and a heading that is wrong by `yaw_per_m` a metre."""
    x = step_m * np.arange(count)
    positions = np.stack([scale * x, np.zeros(count), np.zeros(count)], axis=1)
    R = rotation_from_rpy(np.zeros(count), np.zeros(count), yaw_per_m * x)
    return Trajectory(10**8 * np.arange(count, dtype=np.int64), positions, quaternion_wxyz_from_rotation(R))


def as_evo(trajectory):
    return PoseTrajectory3D(trajectory.positions, trajectory.quaternions_wxyz, trajectory.stamps_ns * 1e-9)


def evo_errors(truth, estimate, relation, length_m):
    """Return the errors of all pairs, and the true path length of each [m]."""
    rpe = metrics.RPE(
        relation, delta=length_m, delta_unit=metrics.Unit.meters, all_pairs=True, pairs_from_reference=True
    )
    rpe.process_data((as_evo(truth), as_evo(estimate)))
    ends = np.array(rpe.delta_ids)
    return np.array(rpe.error), ends


@pytest.mark.parametrize("length_m", [10.0, 25.0, 111.0])
def test_errors_are_those_of_evo_per_path(truth, estimate, length_m):
    (ours,) = segment_errors(estimate, truth, [length_m])
    distance_m = distances_m(truth)
    moved_m, ends = evo_errors(truth, estimate, metrics.PoseRelation.translation_part, length_m)
    travelled_m = distance_m[ends] - distance_m[: len(ends)]  # a path without a halt: the first rows are 0, 1, ...
    turned, _ = evo_errors(truth, estimate, metrics.PoseRelation.rotation_angle_rad, length_m)
    assert ours.segments == len(ends)
    assert ours.translation == pytest.approx(np.mean(moved_m / travelled_m), abs=TOLERANCE)
    assert ours.rotation == pytest.approx(np.mean(turned / travelled_m), abs=TOLERANCE)


def test_a_scale_error_is_the_drift_at_every_length():
    for error in segment_errors(straight(scale=1.02), straight(), [100.0, 400.0]):
        assert error.translation == pytest.approx(0.02)
        assert error.rotation == pytest.approx(0.0, abs=1e-9)


def test_a_turning_heading_is_the_rotation_drift():
    (error,) = segment_errors(straight(yaw_per_m=1e-4), straight(), [100.0])
    assert error.rotation == pytest.approx(1e-4)
    assert error.segments == 501 - 50 + 5  # the last may miss the length by a tenth, which are 5 steps


def test_where_the_vehicle_stands_still_there_is_no_segment():
    rows = np.r_[np.zeros(50, int), np.arange(100), np.full(50, 99)]
    stamps_ns = 10**8 * np.arange(len(rows), dtype=np.int64)
    moving = straight()
    truth = Trajectory(stamps_ns, moving.positions[rows], moving.quaternions_wxyz[rows])
    (error,) = segment_errors(truth, truth, [50.0])
    assert error.translation == 0.0
    hovering = truth.select(np.arange(40))
    assert segment_errors(hovering, hovering, [50.0])[0].segments == 0


def test_a_segment_ends_where_the_vehicle_arrives_not_after_its_halt():
    """As in evo; what the estimate drifts during the halt is no drift per distance."""
    rows = np.r_[np.arange(51), np.full(20, 50), np.arange(51, 60)]
    stamps_ns = 10**8 * np.arange(len(rows), dtype=np.int64)
    moving = straight()
    truth = Trajectory(stamps_ns, moving.positions[rows], moving.quaternions_wxyz[rows])
    drift = np.zeros((len(rows), 3))
    drift[51:, 1] = 0.1 * np.minimum(np.arange(len(rows) - 51), 20)
    estimate = Trajectory(stamps_ns, truth.positions + drift, truth.quaternions_wxyz)
    (error,) = segment_errors(estimate, truth, [100.5])
    moved_m, ends = evo_errors(truth, estimate, metrics.PoseRelation.translation_part, 100.5)
    distance_m = distances_m(truth)
    assert error.segments == len(ends)
    assert error.translation == pytest.approx(np.mean(moved_m / (distance_m[ends] - distance_m[: len(ends)])))


def test_a_gap_longer_than_the_tolerance_gives_no_segment():
    sparse = straight().select(np.arange(0, 501, 50))  # every 100 m
    short, fitting = segment_errors(sparse, sparse, [50.0, 100.0])
    assert (short.segments, fitting.segments) == (0, 10)
    assert np.isnan(short.translation)


def test_the_mean_counts_every_segment_once():
    errors = segment_errors(straight(scale=1.02), straight(), [100.0, 900.0, 5000.0])
    both = pooled(errors)
    assert both.segments == errors[0].segments + errors[1].segments
    assert both.translation == pytest.approx(0.02)
    assert 100.0 < both.length_m < 500.0
    assert np.isnan(pooled(errors[2:]).translation)


def test_lengths_are_those_of_kitti_where_two_fit_else_shares():
    assert default_lengths_m(448.0) == (100.0, 200.0, 300.0, 400.0)
    assert default_lengths_m(3724.0) == (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
    assert default_lengths_m(176.3) == (18.0, 35.0, 53.0, 71.0, 88.0)
    assert default_lengths_m(0.0) == ()


@pytest.mark.parametrize("count", [0, 1])
def test_without_two_poses_there_is_no_drift(count):
    few = straight().select(np.arange(count))
    assert segment_errors(few, few, [10.0])[0].segments == 0
    assert len(distances_m(few)) == count
