# SPDX-License-Identifier: Apache-2.0
"""Simulated flights with a miscalibrated rig: accuracy and consistency of the estimated rig errors."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from uav_vslam.config import EXACT_RIG, RigConfig
from uav_vslam.estimation.filter import Filter
from uav_vslam.simulation.imu import simulate_imu
from uav_vslam.simulation.scenario import Purpose, Scenario, SimulatedVehicle, initial_estimate, simulate_vehicle
from uav_vslam.simulation.trajectory import Trajectory

Array = NDArray[np.float64]

FRAMES = 60
TRUSTED = RigConfig(rigid_sigma_deg=0.002, disparity_sigma_px=0.0, epipolar_sigma_deg=0.0)
FLEXING = RigConfig(flexing=True, attitude_sigma_deg=0.05, vibration_sigma_deg=0.02)
SHIFTED = RigConfig(rigid_sigma_deg=0.0, disparity_sigma_px=0.2, miscalibrated_probability=0.0)
LATE = dataclasses.replace(EXACT_RIG, time_offset_sigma_s=0.02)


def simulated(seed: int, **truth) -> SimulatedVehicle:
    return simulate_vehicle(Scenario(seed=seed, frames=FRAMES, vehicles=1, **truth), 0)


def nees(error: Array, P: Array) -> float:
    return float(error @ np.linalg.solve(P, error)) / len(error)


def rig_covariance(f: Filter) -> Array:
    return f.belief.covariance(np.zeros(0, np.int64))[15:, 15:]


@pytest.mark.parametrize("axis", range(3))
def test_a_flexing_rigs_bias_is_estimated(fly, axis: int) -> None:
    """0.05 degrees about any axis of the right camera, and 0.02 degrees of vibration."""
    bias = tuple(0.05 * np.eye(3)[axis])
    f = fly(simulated(3, extrinsic_bias_deg=bias, vibration_deg=0.02), FLEXING).filter
    sigma = np.rad2deg(np.sqrt(np.diag(rig_covariance(f))[:3]))
    off = np.rad2deg(f.rig_state.attitude) - bias
    assert (sigma < 0.015).all()  # from 0.05
    assert (np.abs(off) < 2.5 * sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eif", "ukf"])
def test_position_and_bias_of_a_flexing_rig_are_consistent(fly, name: str) -> None:
    """NEES with three degrees of freedom a flight; NIS too, but it is not sufficient, see below."""
    outcomes, attitude = [], []
    bias = np.array([0.03, -0.03, 0.04])
    for seed in range(1, 9 if name == "eif" else 4):
        outcome = fly(simulated(seed, extrinsic_bias_deg=tuple(bias), vibration_deg=0.02), FLEXING, name=name)
        error = outcome.filter.rig_state.attitude - np.deg2rad(bias)
        outcomes.append(outcome)
        attitude.append(nees(error, rig_covariance(outcome.filter)[:3, :3]))
    band = chi2.ppf([0.001, 0.999], 3 * len(outcomes)) / (3 * len(outcomes))
    position = np.mean([o.position_nees for o in outcomes])
    nis = np.mean([o.nis_per_dof for o in outcomes])
    assert band[0] < position < band[1]
    assert np.mean(attitude) < band[1]
    assert nis == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eif", "ukf"])
def test_position_and_disparity_error_are_consistent(fly, name: str) -> None:
    """Errors drawn from the prior: of 0.2 px a half to a fifth is left."""
    position, disparity = [], []
    for seed in range(1, 13 if name == "eif" else 4):
        shift_px = float(np.random.default_rng(seed).normal(0.0, 0.2))
        outcome = fly(simulated(seed, disparity_bias_px=shift_px), SHIFTED, name=name)
        variance = rig_covariance(outcome.filter)[0, 0]
        assert 0.2**2 < variance / 0.2**2 < 0.5**2
        position.append(outcome.position_nees)
        disparity.append((outcome.filter.rig_state.disparity_px - shift_px) ** 2 / variance)
    runs = len(position)
    assert chi2.ppf(0.001, 3 * runs) < 3 * np.sum(position) < chi2.ppf(0.999, 3 * runs)
    assert chi2.ppf(0.001, runs) < np.sum(disparity) < chi2.ppf(0.999, runs)


def test_an_unmodelled_disparity_error_ruins_the_estimate_but_not_the_residuals(fly) -> None:
    outcomes = [fly(simulated(3, disparity_bias_px=0.3), config) for config in (EXACT_RIG, SHIFTED)]
    assert outcomes[0].position_nees > 10.0
    assert outcomes[0].nis_per_dof == pytest.approx(1.0, abs=0.1)
    assert outcomes[1].position_nees < 4.0


def test_an_unmodelled_bias_about_the_disparity_axis_ruins_the_estimate_but_not_the_residuals(fly) -> None:
    vehicle = simulated(3, extrinsic_bias_deg=(0.05, 0.0, 0.0))
    rigid, flexing = fly(vehicle, EXACT_RIG), fly(vehicle, FLEXING)
    assert rigid.position_nees > 50.0
    assert rigid.nis_per_dof == pytest.approx(1.0, abs=0.1)
    assert flexing.position_nees < 4.0


@pytest.mark.slow
def test_the_statistic_against_a_rigid_rig_grows_only_if_it_is_wrong(fly) -> None:
    """With a sigma of 0.002 degrees, ten sigmas about either axis that moves pixels exceed the limit."""
    limit = chi2.ppf(0.99, 3)
    for seed in (1, 2):
        right = fly(simulated(seed), TRUSTED).filter.rig_evidence()
        assert right < limit
        for bias in ((0.02, 0.0, 0.0), (0.0, 0.02, 0.0)):
            assert fly(simulated(seed, extrinsic_bias_deg=bias), TRUSTED).filter.rig_evidence() > limit
    assert fly(simulated(1), EXACT_RIG).filter.rig_evidence() == 0.0


@pytest.mark.parametrize("axis", [1, 2], ids=["across the disparity", "optical"])
def test_a_rigid_rig_that_is_turned_off_the_epipolar_lines_is_estimated(fly, axis: int) -> None:
    bias_deg = [0.0, 0.0, 0.0]
    bias_deg[axis] = 0.02
    turned = fly(simulated(3, extrinsic_bias_deg=tuple(bias_deg)), RigConfig())
    found, sigma = turned.filter.rig_state.attitude[axis], np.sqrt(rig_covariance(turned.filter)[axis, axis])
    assert sigma < np.deg2rad(0.01)
    assert abs(found - np.deg2rad(0.02)) < 3.0 * sigma
    assert turned.position_nees < 4.0


@pytest.mark.parametrize("bias", [1e-3, -1e-3])
def test_the_ratio_of_the_focal_lengths_is_estimated(fly, bias: float) -> None:
    f = fly(simulated(3, focal_ratio_bias=bias), dataclasses.replace(EXACT_RIG, focal_ratio_sigma=1e-3)).filter
    sigma = np.sqrt(rig_covariance(f)[0, 0])
    assert sigma < 2e-4
    assert abs(f.rig_state.focal_ratio - bias) < 3.0 * sigma


def swaying(seed: int) -> SimulatedVehicle:
    """Return a flight to the north-west that rolls, pitches and yaws by 10 degrees, slowly: in 3 to 6 seconds."""
    vehicle = simulated(seed)
    t = np.arange(-1.0, vehicle.scenario.duration_s + 1.0, 0.1)
    place = np.column_stack([20.0 * np.cos(2.3) * t, 20.0 * np.sin(2.3) * t, np.full_like(t, 70.0)])
    rpy = np.column_stack([0.12 * np.sin(2.0 * t), 0.08 * np.sin(1.5 * t + 1.0), 2.3 + 0.2 * np.sin(t + 2.0)])
    truth = Trajectory(int(vehicle.frame_stamps_ns[0]), t, place, rpy)
    scenario = vehicle.scenario
    return dataclasses.replace(
        vehicle,
        truth=truth,
        imu=simulate_imu(truth, vehicle.imu.stamps_ns, scenario.imu_config, rng=scenario.rng(0, Purpose.IMU)),
        initial=initial_estimate(scenario, truth, rng=scenario.rng(0, Purpose.INITIAL)),
    )


@pytest.mark.parametrize("offset_s", [0.01, -0.01])
@pytest.mark.parametrize("motion", [swaying, simulated])
def test_a_time_offset_is_estimated_for_swaying_and_shaking_airframes(fly, motion, offset_s: float) -> None:
    """Camera stamps 10 ms early or late; a filter that ignores the offset is far worse."""
    vehicle = motion(3)
    estimating, ignoring = fly(vehicle, LATE, offset_s=offset_s), fly(vehicle, EXACT_RIG, offset_s=offset_s)
    sigma = np.sqrt(rig_covariance(estimating.filter)[0, 0])
    assert sigma < (0.2e-3 if offset_s < 0.0 else 0.25e-3)  # [s], from 20 ms; after the stamp it is extrapolated
    assert estimating.filter.rig_state.time_offset_s == pytest.approx(offset_s, abs=4 * sigma)
    assert estimating.position_nees < chi2.ppf(0.999, 3) / 3
    assert estimating.position_nees < 0.05 * ignoring.position_nees
