# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from uav_vslam.evaluation.consistency import chi_square_band, nees, normalised, summarise
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, so3_exp


def test_errors_drawn_from_the_covariance_have_nees_one(truth, perturbed):
    rng = np.random.default_rng(0)
    runs = [nees(perturbed(truth, rng, 0.7, 0.03), truth) for _ in range(20)]
    low, high = chi_square_band(20 * len(truth), probability=0.999)
    assert low < np.mean([run.position for run in runs]) < high
    assert low < np.mean([run.rotation for run in runs]) < high


def test_half_the_covariance_doubles_the_nees(truth, estimate):
    bold = dataclasses.replace(estimate, covariance=0.5 * estimate.covariance)
    np.testing.assert_allclose(nees(bold, truth).position, 2 * nees(estimate, truth).position)
    np.testing.assert_allclose(nees(bold, truth).rotation, 2 * nees(estimate, truth).rotation)


def test_correlated_covariances_are_inverted_whole():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(5, 3, 3))
    P, e = A @ A.transpose(0, 2, 1) + 0.1 * np.eye(3), rng.normal(size=(5, 3))
    expected = [row @ np.linalg.inv(block) @ row / 3 for row, block in zip(e, P, strict=True)]
    np.testing.assert_allclose(normalised(e, P), expected)


def test_the_rotation_error_is_a_map_frame_vector(truth):
    xi = np.array([0.0, 0.0, 0.02])  # pure yaw error at any attitude
    R = so3_exp(-xi) @ truth.rotations
    covariance = np.tile(np.diag([1.0, 1, 1, 1e-6, 1e-6, 1e-4]), (len(truth), 1, 1))
    turned = Trajectory(truth.stamps_ns, truth.positions, quaternion_wxyz_from_rotation(R), covariance)
    np.testing.assert_allclose(nees(turned, truth).rotation, 0.02**2 / 1e-4 / 3, rtol=1e-6)


def test_the_first_twenty_keyframes_do_not_count():
    summary = summarise(np.r_[np.full(20, 100.0), 1.0, 2.0, 6.0])
    assert (summary.mean, summary.end, summary.invalid) == (3.0, 6.0, 0)


@pytest.mark.parametrize("count", [0, 20])
def test_a_short_run_has_no_mean(count):
    assert np.isnan(summarise(np.ones(count)).mean)


def test_an_indefinite_covariance_is_not_hidden_in_the_mean(truth, estimate):
    covariance = estimate.covariance.copy()
    covariance[50, 0, 0] = -1.0
    covariance[60, 1, 1] = np.nan
    summary = summarise(nees(dataclasses.replace(estimate, covariance=covariance), truth).position)
    assert np.isnan(summary.mean)
    assert summary.invalid == 2


def test_no_covariance_or_no_truth_gives_nothing(truth, estimate):
    assert nees(truth, truth) is None
    assert nees(estimate, truth.select(np.zeros(0, np.intp))) is None


@pytest.mark.parametrize("runs", [1, 20, 50])
def test_the_band_is_that_of_chi_square(runs):
    expected = chi2.ppf([0.025, 0.975], 3 * runs) / (3 * runs)
    np.testing.assert_allclose(chi_square_band(runs), expected, rtol=1e-9)
