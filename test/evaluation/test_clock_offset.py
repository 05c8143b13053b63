# SPDX-License-Identifier: Apache-2.0
"""A truth whose clock is off is told from an estimate that is wrong."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.evaluation.clock_offset import clock_offset, later
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error

NOISE_M = 0.1


@pytest.fixture
def survey(truth: Trajectory) -> Trajectory:
    """Two lines of a survey, there and back at up to 15 m/s, with the attitudes of the climbing turn."""
    t = (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9
    positions = np.column_stack([50.0 * (1.0 - np.cos(0.3 * t)), 20.0 / (1.0 + np.exp(6.0 - t)), np.full(len(t), 30.0)])
    return dataclasses.replace(truth, positions=positions)


@pytest.mark.parametrize("offset_s", [-1.3, -0.12, 0.05, 0.7])
def test_an_offset_of_the_clock_is_found(survey, perturbed, offset_s):
    estimate = perturbed(survey, np.random.default_rng(1), NOISE_M, 0.01)
    found = clock_offset(estimate, later(survey, -offset_s))
    assert found is not None
    assert found.offset_s == pytest.approx(offset_s, abs=0.01)
    right = absolute_error(estimate, survey, alignment="se3")
    assert found.moved_ate_m == pytest.approx(right.ate_m, rel=0.02)
    assert f"--truth-offset {found.offset_s:.3f}" in found.text()
    assert "--truth-offset 0.000" in found.text(-found.offset_s - 1e-4)


def test_an_estimate_that_drifts_is_not_excused(survey, perturbed):
    estimate = perturbed(survey, np.random.default_rng(2), NOISE_M, 0.01)
    assert clock_offset(estimate, survey) is None
    walk = np.cumsum(np.random.default_rng(3).normal(0.0, 0.3, survey.positions.shape), axis=0)
    drifting = dataclasses.replace(estimate, positions=estimate.positions + walk)
    assert clock_offset(drifting, survey) is None


def test_an_offset_that_looks_like_a_shift_is_not_found(truth, perturbed):
    estimate = perturbed(truth, np.random.default_rng(4), NOISE_M, 0.01)
    assert clock_offset(estimate, later(truth, 0.5)) is None  # a circle of constant speed


def test_few_poses_say_nothing(survey):
    moved = later(survey, 0.5)
    assert clock_offset(survey.select(np.arange(20, 28)), moved) is None
    assert clock_offset(survey, later(survey, 100.0)) is None


def test_a_flight_as_short_as_the_offsets_tried_is_no_warning_of_numpy(truth, perturbed):
    short = truth.select(np.arange(20))
    assert clock_offset(perturbed(short, np.random.default_rng(4), 1.0, 0.0), short) is None
