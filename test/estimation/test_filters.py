# SPDX-License-Identifier: Apache-2.0
"""The filters by name, built as configured."""

import dataclasses

import numpy as np
import pytest

from uav_vslam import config
from uav_vslam.config import EXACT_RIG, BackendConfig, RigConfig, VehicleConfig
from uav_vslam.estimation.filters import BOUNDED, FILTERS, make_filter

OWN = [name for name in FILTERS if not name.startswith("thesis")]


def test_the_configuration_has_the_same_names() -> None:
    assert set(config.FILTERS) == set(FILTERS)
    assert set(BOUNDED) < set(FILTERS)


def made(course, name: str, **backend):
    settings = VehicleConfig(imu=course.imu, rig=EXACT_RIG, backend=BackendConfig(filter=name, **backend))
    return make_filter(course.initial, rig=course.rig, config=settings)


@pytest.mark.parametrize("name", sorted(FILTERS))
@pytest.mark.parametrize("model", config.STATE_MODELS)
def test_a_configured_filter_is_the_one_of_that_name(course, name: str, model: str) -> None:
    """To the last bit, over an increment and an update."""
    found = made(course, name, model=model, sigma_px=0.7, depth_sigma_ratio=0.03, gamma=50.0)
    gamma = {"gamma": 50.0} if name in BOUNDED else {}
    expected = course.filter(model, name, sigma_px=0.7, depth_sigma_ratio=0.03, **gamma)
    for f in (found, expected):
        f.add_landmarks(course.pixels(0, np.arange(4)))
        f.predict(course.increments[0])
        f.update(np.arange(4), course.pixels(1, np.arange(4)))
    np.testing.assert_array_equal(found.nav.T_map_body.matrix, expected.nav.T_map_body.matrix)
    np.testing.assert_array_equal(found.covariance(), expected.covariance())
    assert found.feasibility == expected.feasibility


@pytest.mark.parametrize(("name", "model"), [("thesis_ukf", "ri15"), ("thesis_uhf", "ri15"), ("eif", "euler9")])
def test_the_thesis_knows_no_error_of_disparity_or_clock(course, name: str, model: str) -> None:
    backend = BackendConfig(filter=name, model=model)
    f = make_filter(course.initial, rig=course.rig, config=VehicleConfig(imu=course.imu, backend=backend))
    assert f.disparity is None
    assert f.can_add_landmarks  # whatever the angular rate
    f.judge_disparity()  # nothing to do


def test_a_vehicle_without_attitude_has_no_offset_of_the_clock(course) -> None:
    """Linearised, it would tell the heading, which nothing does."""
    settings = VehicleConfig(imu=course.imu)
    for sigma, has_offset in ((0.2, True), (0.4, False)):
        P = course.initial.covariance.copy()
        P[8, 8] = sigma**2
        f = make_filter(dataclasses.replace(course.initial, covariance=P), rig=course.rig, config=settings)
        assert f.can_add_landmarks is not has_offset  # before an angular rate is known


@pytest.mark.parametrize("name", OWN)
def test_robust_kernel_and_rig_uncertainty_are_passed_on(course, name: str) -> None:
    settings = VehicleConfig(imu=course.imu, rig=RigConfig(flexing=True, time_offset_sigma_s=0.01))
    for robust in (True, False):
        backend = BackendConfig(filter=name, robust=robust)
        f = make_filter(course.initial, rig=course.rig, config=dataclasses.replace(settings, backend=backend))
        assert f.vehicle == 15 + 9
        f.add_landmarks(course.pixels(0, np.arange(12)))
        f.predict(course.increments[0])
        wrong = course.pixels(1, np.arange(12))
        wrong[4] += 100.0
        assert (f.update(np.arange(12), wrong).downweighted > 0) is robust


@pytest.mark.parametrize("name", OWN)
def test_a_quarter_of_the_weight_adds_a_quarter_of_the_information(course, name: str) -> None:
    information = []
    for weight in (0.0, 0.25, 1.0):
        f = made(course, name, robust=True)
        f.add_landmarks(course.pixels(0, np.arange(6)))
        expected = f.predict_observations(np.arange(6)).expected
        if weight:
            f.update(np.arange(6), expected, weights=np.full(6, weight))
        information.append(np.linalg.inv(f.covariance()))
    before, quarter, whole = information
    scale = np.sqrt(np.outer(np.diag(whole), np.diag(whole)))
    np.testing.assert_allclose((quarter - before) / scale, 0.25 * (whole - before) / scale, atol=1e-6)
