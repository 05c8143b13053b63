# SPDX-License-Identifier: Apache-2.0
"""Reference: `evo`, an independent implementation of the same definitions."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("evo", reason="evo is a development requirement")
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D

from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error, relative_error
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, rotation_from_rpy, so3_exp

FRAME_S = 0.1  # of the flight
TOLERANCE = 1e-9  # two implementations in double precision


def as_evo(trajectory):
    stamps_s = (trajectory.stamps_ns - trajectory.stamps_ns[0]) * 1e-9
    return PoseTrajectory3D(trajectory.positions, trajectory.quaternions_wxyz, stamps_s)


def moved(trajectory, R, t):
    """Return the same trajectory in another frame."""
    rotations = quaternion_wxyz_from_rotation(R @ trajectory.rotations)
    return Trajectory(trajectory.stamps_ns, trajectory.positions @ R.T + t, rotations, trajectory.covariance)


def evo_rms(metric, truth, estimate):
    metric.process_data((truth, estimate))
    return metric.get_statistic(metrics.StatisticsType.rmse)


@pytest.mark.parametrize("alignment", ["none", "se3"])
def test_absolute_errors_are_those_of_evo(truth, estimate, alignment):
    estimate = moved(estimate, so3_exp([0.02, -0.05, 0.3]), [3.0, -2.0, 1.0])
    ours = absolute_error(estimate, truth, alignment=alignment)
    theirs, reference = as_evo(estimate), as_evo(truth)
    if alignment == "se3":
        theirs.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    assert ours.ate_m == pytest.approx(evo_rms(ape, reference, theirs), abs=TOLERANCE)
    assert ours.end_m == pytest.approx(ape.error[-1], abs=TOLERANCE)
    assert ours.max_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.max), abs=TOLERANCE)
    angle = evo_rms(metrics.APE(metrics.PoseRelation.rotation_angle_rad), reference, theirs)
    assert ours.rotation_rms_rad == pytest.approx(angle, abs=TOLERANCE)
    assert ours.pairs == 120


@pytest.mark.parametrize("frames", [1, 7, 20])
def test_relative_errors_are_those_of_evo(truth, estimate, frames):
    ours = relative_error(estimate, truth, delta_s=frames * FRAME_S)
    theirs, reference = as_evo(estimate), as_evo(truth)
    settings = {"delta": frames, "delta_unit": metrics.Unit.frames, "all_pairs": True}
    translation = metrics.RPE(metrics.PoseRelation.translation_part, **settings)
    rotation = metrics.RPE(metrics.PoseRelation.rotation_angle_rad, **settings)
    assert ours.translation_rms_m == pytest.approx(evo_rms(translation, reference, theirs), abs=TOLERANCE)
    assert ours.rotation_rms_rad == pytest.approx(evo_rms(rotation, reference, theirs), abs=TOLERANCE)
    assert ours.pairs == len(truth) - frames


def test_seconds_span_frames_that_are_missing(truth, estimate):
    keep = np.r_[0:30, 80:120]
    error = relative_error(estimate.select(keep), truth, delta_s=2.0)
    assert error.pairs == (30 - 20) + 2 + (40 - 20)  # two more reach the gap within a tenth of the delta


def test_end_error_is_the_last_pair_with_a_truth(truth, estimate):
    shorter = truth.select(np.arange(100))
    error = absolute_error(estimate, shorter)
    assert error.pairs == 100
    assert error.end_m == pytest.approx(np.linalg.norm(estimate.positions[99] - truth.positions[99]))


def test_yaw_alignment_removes_yaw_and_translation_but_no_tilt(truth):
    turned = moved(truth, rotation_from_rpy(0.0, 0.0, 0.7), [5.0, -9.0, 2.0])
    assert absolute_error(turned, truth, alignment="yaw").ate_m < 1e-9
    tilted = moved(turned, so3_exp([0.05, 0.0, 0.0]), [0.0, 0.0, 0.0])
    assert absolute_error(tilted, truth, alignment="yaw").ate_m > 0.1
    assert absolute_error(tilted, truth, alignment="se3").ate_m < 1e-9


def test_the_truth_is_interpolated_to_the_stamp_of_the_estimate(truth):
    later = dataclasses.replace(truth, stamps_ns=truth.stamps_ns + 20_000_000)
    assert absolute_error(later, truth).ate_m == pytest.approx(0.4, rel=0.01)  # 20 m/s for 0.02 s


def test_without_common_time_there_is_no_error(truth, estimate):
    elsewhere = dataclasses.replace(truth, stamps_ns=truth.stamps_ns + 10**15)
    empty = truth.select(np.zeros(0, np.intp))
    for other in (elsewhere, empty):
        assert absolute_error(estimate, other) is None
        assert relative_error(estimate, other, delta_s=1.0) is None


def test_an_unknown_alignment_is_refused_with_the_known_ones(truth):
    with pytest.raises(ValueError, match="use one of none, start-yaw"):
        absolute_error(truth, truth, alignment="wrong")


def test_a_delta_must_be_positive(truth):
    with pytest.raises(ValueError, match="positive"):
        relative_error(truth, truth, delta_s=0)
