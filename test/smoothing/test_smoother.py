# SPDX-License-Identifier: Apache-2.0
"""The smoother is the optimum of the measurements, with an honest covariance."""

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest

from uav_vslam.config import EXACT_RIG, RigConfig, VehicleConfig, load_vehicle
from uav_vslam.evaluation.consistency import chi_square_band, nees
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.ins.propagation import propagate, transition
from uav_vslam.offline.track import track_vehicle
from uav_vslam.simulation.landmarks import LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.smoothing.flight import FilteredFlight, FilteredFrame
from uav_vslam.smoothing.smoother import SETTLED, Smoothed, smooth
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.engine.own_only import dead_reckon
from uav_vslam.studies.engine.smoothers import batch_optimum
from uav_vslam.types import StereoFeatures

FRAMES = 25
PER_FRAME = 20
SAME_SIGMA = 0.01  # GTSAM integrates the noise of the motion otherwise
SIGMA_TOLERANCE = 0.08  # three times that of a median over some 500 observations
Seen = list[tuple[StereoFeatures, np.ndarray]]


@functools.cache
def simulated(seed: int) -> tuple[SimulatedVehicle, Seen]:
    vehicle = simulate_vehicle(Scenario(vehicles=1, frames=FRAMES, seed=seed), 0)
    return vehicle, list(observe(vehicle, scatter_landmarks([vehicle], per_frame=PER_FRAME), noise=LandmarkNoise()))


def config_of(vehicle: SimulatedVehicle) -> VehicleConfig:
    """Return settings with the true noise and a rig that is known exactly, as GTSAM takes it."""
    return dataclasses.replace(load_vehicle(None), imu=vehicle.scenario.imu_config, rig=EXACT_RIG)


def dead_reckoned(vehicle: SimulatedVehicle, seen: Seen) -> FilteredFlight:
    """Return a flight whose landmarks are the simulated ones, to be smoothed from dead reckoning."""
    imu, state = vehicle.scenario.imu_config, vehicle.initial.state
    increments, _ = dead_reckon(vehicle.initial, imu, vehicle.imu.samples(), vehicle.frame_stamps_ns.tolist())
    frames = []
    for (features, identities), increment in zip(seen, increments, strict=True):
        state = state if increment is None else propagate(state, increment, gravity=imu.gravity)
        known = np.flatnonzero(identities >= 0)
        frames.append(FilteredFrame(state, increment, features, np.column_stack([identities[known] + 1, known])))
    return FilteredFlight.of(vehicle.initial, frames)


def smoothed(vehicle: SimulatedVehicle, seen: Seen) -> Smoothed:
    return smooth(dead_reckoned(vehicle, seen), vehicle.rig, config_of(vehicle))


def trajectory(result: Smoothed) -> Trajectory:
    return Trajectory.from_estimates([estimate.pose for estimate in result.estimates])


def test_it_equals_the_batch_optimum_of_gtsam() -> None:
    vehicle, seen = simulated(1)
    found = smoothed(vehicle, seen)
    optimum = batch_optimum(
        vehicle.initial,
        seen,
        vehicle.imu.samples(),
        rig=vehicle.rig,
        imu=vehicle.scenario.imu_config,
        sigma_px=found.noise.white_px,
    )
    assert found.dropped == 0
    ours = trajectory(found)
    sigma = np.sqrt(np.diagonal(optimum.covariance, axis1=1, axis2=2))
    apart = np.hstack(
        [ours.positions - optimum.positions, so3_log(ours.rotations @ optimum.rotations.transpose(0, 2, 1))]
    )
    ratio = np.sqrt(np.diagonal(ours.covariance, axis1=1, axis2=2)) / sigma
    assert np.abs(apart / sigma).max() < SETTLED
    assert np.abs(ratio - 1.0).max() < SAME_SIGMA
    assert found.noise.white_px == pytest.approx(1.0, abs=SIGMA_TOLERANCE)  # the simulation's


def test_the_first_frame_counts_although_its_landmarks_had_to_wait_for_the_clocks_offset() -> None:
    """A gap after the first frame would be crossed by the INS alone: of 7 s, in one recording, 0.3 m."""
    vehicle, seen = simulated(1)
    source = SimulatedSource(vehicle, features=tuple(features for features, _ in seen[:6]))
    flights = []
    for sigma_s in (0.0, 1e-6):
        rig = dataclasses.replace(EXACT_RIG, time_offset_sigma_s=sigma_s)
        track = track_vehicle(source, dataclasses.replace(config_of(vehicle), rig=rig))
        by_stamp = {features.stamp_ns: features for features, _ in seen}
        flights.append(FilteredFlight.of_outputs(vehicle.initial, track.outputs, by_stamp))
    plain, waiting = (flight.frames[0].sightings[:, 1] for flight in flights)
    assert len(plain) > 10
    np.testing.assert_array_equal(waiting, plain)


def test_a_track_that_jumps_does_not_move_the_flight() -> None:
    vehicle, seen = simulated(1)
    clean = trajectory(smoothed(vehicle, seen))
    jumping = int(np.bincount(seen[3][1]).argmax())
    spoiled = [(_moved(features, ids == jumping, 15.0 * (k > 4)), ids) for k, (features, ids) in enumerate(seen)]
    found = smoothed(vehicle, spoiled)
    sigma = np.sqrt(np.diagonal(clean.covariance, axis1=1, axis2=2))
    assert (np.abs(trajectory(found).positions - clean.positions) < 0.5 * sigma[:, :3]).all()


def test_a_fifth_of_wrong_observations_costs_little() -> None:
    vehicle, seen = simulated(1)
    rng = np.random.default_rng(3)
    spoiled = [
        (_moved(features, rng.random(len(features)) < 0.2, rng.choice([-30.0, 30.0])), ids) for features, ids in seen
    ]
    clean, found = smoothed(vehicle, seen), smoothed(vehicle, spoiled)
    scores = nees(trajectory(found), true_trajectory(vehicle))
    assert scores.position[-1] < chi_square_band(1, probability=0.999)[1]
    assert found.points > 0.6 * clean.points  # a point loses its wrong observations, not all
    sigma, without = (result.estimates[-1].covariance[:3, :3].trace() ** 0.5 for result in (found, clean))
    assert sigma < 1.3 * without


def _moved(features: StereoFeatures, rows: np.ndarray, shift_px: float) -> StereoFeatures:
    pixels = features.pixels + np.float32(shift_px) * rows[:, None] * np.array([1.0, 0.3, 1.0, 0.3], np.float32)
    return dataclasses.replace(features, pixels=pixels)


@pytest.mark.slow
def test_a_landmark_seen_again_ties_the_end_to_the_start() -> None:
    vehicle, seen = simulated_circuit()
    closed = smoothed(vehicle, seen)
    half = len(seen) // 2
    again = [(features, ids if k < half else ids + 100_000) for k, (features, ids) in enumerate(seen)]
    opened = smoothed(vehicle, again)
    assert opened.landmarks == 0 < closed.landmarks
    truth = true_trajectory(vehicle)
    end_open, end_closed = (abs_end(trajectory(result), truth) for result in (opened, closed))
    claimed_open, claimed_closed = (result.estimates[-1].covariance[:3, :3].trace() for result in (opened, closed))
    assert end_closed < 0.5 * end_open
    assert claimed_closed < 0.25 * claimed_open
    scores = nees(trajectory(closed), truth)
    assert scores.position[-1] < chi_square_band(1, probability=0.999)[1]


@pytest.mark.slow
def test_some_landmarks_recognised_wrongly_do_not_bend_the_loop() -> None:
    vehicle, seen = simulated_circuit()
    half, shared = len(seen) // 2, {int(identity) for _, ids in seen[:20] for identity in ids[ids >= 0]}
    swapped = sorted(shared)[::10]
    other = dict(zip(swapped, np.roll(swapped, 1).tolist(), strict=True))
    wrong = [
        (features, ids if k < half else np.array([other.get(int(identity), int(identity)) for identity in ids]))
        for k, (features, ids) in enumerate(seen)
    ]
    found = trajectory(smoothed(vehicle, wrong))
    assert found.covariance is not None
    scores = nees(found, true_trajectory(vehicle))
    assert scores.position[-1] < chi_square_band(1, probability=0.999)[1]


@functools.cache
def simulated_circuit() -> tuple[SimulatedVehicle, Seen]:
    """Return a circuit flown twice, seen so rarely that half of it is soon smoothed."""
    vehicle = simulate_vehicle(Scenario(vehicles=1, frames=164, frame_rate_hz=1.5, pattern="circuit", seed=3), 0)
    return vehicle, list(observe(vehicle, scatter_landmarks([vehicle], per_frame=PER_FRAME), noise=LandmarkNoise()))


def abs_end(found: Trajectory, truth: Trajectory) -> float:
    return float(np.linalg.norm(found.positions[-1] - truth.positions[-1]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "known"),
    [
        ({"extrinsic_bias_deg": (0.05, 0.0, 0.0)}, RigConfig(rigid_sigma_deg=0.05)),
        ({"disparity_bias_px": 0.3}, RigConfig()),
        ({"extrinsic_bias_deg": (0.02, 0.0, 0.0), "vibration_deg": 0.05}, RigConfig(flexing=True)),
    ],
)
def test_a_wrong_rig_is_estimated_and_its_uncertainty_counts(wrong: dict[str, Any], known: RigConfig) -> None:
    """NEES of the last pose over ten flights; a rig that is trusted is off by far."""
    scores, trusting = [], []
    for seed in range(301, 311):
        vehicle = simulate_vehicle(Scenario(vehicles=1, frames=FRAMES, seed=seed, **wrong), 0)
        seen = list(observe(vehicle, scatter_landmarks([vehicle], per_frame=PER_FRAME), noise=LandmarkNoise()))
        flight, config, truth = dead_reckoned(vehicle, seen), config_of(vehicle), true_trajectory(vehicle)
        estimated = smooth(flight, vehicle.rig, dataclasses.replace(config, rig=known))
        scores.append(nees(trajectory(estimated), truth).position[-1])
        trusting.append(nees(trajectory(smooth(flight, vehicle.rig, config)), truth).position[-1])
    low, high = chi_square_band(len(scores), probability=0.999)
    assert low < np.mean(scores) < high < np.mean(trusting)


@pytest.mark.slow
def test_an_error_of_the_disparity_too_small_to_be_found_is_claimed() -> None:
    """NEES of the last pose over ten flights with precise points; the other calibration counts as right."""
    claiming, trusting = [], []
    for seed in range(301, 311):
        vehicle = simulate_vehicle(Scenario(vehicles=1, frames=2 * FRAMES, seed=seed, disparity_bias_px=0.08), 0)
        field, noise = scatter_landmarks([vehicle], per_frame=PER_FRAME), LandmarkNoise(sigma_px=0.1)
        flight, truth = dead_reckoned(vehicle, list(observe(vehicle, field, noise=noise))), true_trajectory(vehicle)
        for scores, rig in ((claiming, RigConfig()), (trusting, RigConfig(miscalibrated_probability=0.0))):
            config = dataclasses.replace(config_of(vehicle), rig=rig)
            scores.append(nees(trajectory(smooth(flight, vehicle.rig, config)), truth).position[-1])
    assert np.mean(claiming) < 3.0 < 9.0 < np.mean(trusting)


def test_a_rig_that_was_found_to_flex_is_smoothed_as_one_that_does() -> None:
    vehicle = simulate_vehicle(Scenario(vehicles=1, frames=FRAMES, seed=301, vibration_deg=0.05), 0)
    seen = list(observe(vehicle, scatter_landmarks([vehicle], per_frame=PER_FRAME), noise=LandmarkNoise()))
    flight, config = dead_reckoned(vehicle, seen), config_of(vehicle)
    ends = []
    for found, rig in ((False, RigConfig()), (True, RigConfig()), (False, RigConfig(flexing=True))):
        settings = dataclasses.replace(config, rig=rig)
        ends.append(smooth(dataclasses.replace(flight, flexing=found), vehicle.rig, settings).estimates[-1].pose)
    np.testing.assert_array_equal(ends[1].T_map_body.t, ends[2].T_map_body.t)
    assert not np.array_equal(ends[0].T_map_body.t, ends[1].T_map_body.t)


def test_equal_flights_give_equal_bytes() -> None:
    vehicle, seen = simulated(2)
    first, second = trajectory(smoothed(vehicle, seen)), trajectory(smoothed(vehicle, seen))
    assert first.positions.tobytes() == second.positions.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()


def test_without_features_it_is_dead_reckoning_with_its_covariance() -> None:
    vehicle, seen = simulated(1)
    flight = dead_reckoned(vehicle, [(StereoFeatures.empty(features.stamp_ns), ids[:0]) for features, ids in seen])
    found = smooth(flight, vehicle.rig, config_of(vehicle))
    P, imu, state = vehicle.initial.covariance, vehicle.scenario.imu_config, vehicle.initial.state
    for frame, estimate in zip(flight.frames, found.estimates, strict=True):
        if frame.increment is not None:
            F, Q = transition(state, frame.increment, imu)
            P = F @ P @ F.T + Q
        state = frame.state
        assert np.allclose(estimate.state.T_map_body.t, state.T_map_body.t, rtol=0, atol=1e-6)
        scale = np.sqrt(np.outer(np.diagonal(P), np.diagonal(P)))
        assert np.abs((estimate.covariance - P) / scale).max() < 1e-6


@pytest.mark.slow
def test_the_flight_is_consistent_over_seeds() -> None:
    seeds = range(201, 221)
    first, last = [], []
    for seed in seeds:
        vehicle, seen = simulated(seed)
        scores = nees(trajectory(smoothed(vehicle, seen)), true_trajectory(vehicle))
        first.append([scores.position[10], scores.rotation[10]])
        last.append([scores.position[-1], scores.rotation[-1]])
    low, high = chi_square_band(len(seeds), probability=0.999)
    for values in (*np.transpose(first), *np.transpose(last)):
        assert low < np.mean(values) < high
