# SPDX-License-Identifier: Apache-2.0
"""The reference smoothers are consistent, agree with each other, and hold the right landmarks."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.consistency import chi_square_band, nees
from uav_vslam.evaluation.trajectory_error import absolute_error
from uav_vslam.simulation.landmarks import LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.studies.engine import smoothers
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.engine.smoothers import FixedLagSmoother, batch_optimum, cholesky_motion, gtsam_batch

FRAMES = 25
SIGMA_PX = 1.0
FRAME_S = 0.14


@pytest.fixture(scope="module")
def vehicle() -> SimulatedVehicle:
    return simulate_vehicle(Scenario(frames=FRAMES), 0)


@pytest.fixture(scope="module")
def frames(vehicle: SimulatedVehicle):
    return list(observe(vehicle, scatter_landmarks([vehicle], per_frame=20)))


def optimum(vehicle: SimulatedVehicle, frames):
    return batch_optimum(
        vehicle.initial,
        frames,
        vehicle.imu.samples(),
        rig=vehicle.rig,
        imu=vehicle.scenario.imu_config,
        sigma_px=SIGMA_PX,
    )


def smooth(vehicle: SimulatedVehicle, frames, lag_s: float):
    """Return the smoother after all frames, the newest pose of each frame, and the landmarks in the state after it."""
    smoother = FixedLagSmoother(vehicle.initial, rig=vehicle.rig, sigma_px=SIGMA_PX, lag_s=lag_s)
    motion = cholesky_motion(vehicle.imu.samples(), vehicle.scenario.imu_config, vehicle.initial.state)
    poses, held = [], []
    for k, (features, identities) in enumerate(frames):
        measured = motion.between(frames[k - 1][0].stamp_ns, features.stamp_ns) if k else None
        poses.append(smoother.process(features, identities, measured))
        held.append(smoother.landmarks)
    return smoother, poses, held


def without(frame, identity: int):
    features, identities = frame
    keep = identities != identity
    return dataclasses.replace(
        features, pixels=features.pixels[keep], descriptors=features.descriptors[keep]
    ), identities[keep]


@pytest.mark.slow
def test_the_batch_optimum_errs_as_much_as_it_says() -> None:
    seeds = 12
    position, rotation = [], []
    for seed in range(seeds):
        vehicle = simulate_vehicle(Scenario(seed=seed, frames=FRAMES), 0)
        landmarks = scatter_landmarks([vehicle], per_frame=20)
        estimate = gtsam_batch(vehicle, landmarks, LandmarkNoise(sigma_px=SIGMA_PX), SIGMA_PX)
        scored = nees(estimate, true_trajectory(vehicle))
        assert scored is not None
        position.append(scored.position[-1])
        rotation.append(scored.rotation[-1])
    low, high = chi_square_band(seeds, probability=0.999)
    assert low < np.mean(position) < high
    assert low < np.mean(rotation) < high


def test_wrong_matches_are_left_out(vehicle, frames) -> None:
    corrupted = [(features, np.where(np.arange(len(ids)) == 3, -1, ids)) for features, ids in frames]
    cleaned = [without(frame, -1) for frame in corrupted]
    np.testing.assert_array_equal(optimum(vehicle, corrupted).positions, optimum(vehicle, cleaned).positions)


def test_what_is_not_the_optimum_is_not_given_out(vehicle, frames, monkeypatch) -> None:
    monkeypatch.setattr(smoothers, "MAX_STEPS", 1)
    with pytest.raises(UavVslamError, match="did not reach the optimum of 25 frames within 1 steps"):
        optimum(vehicle, frames)


def test_a_lag_beyond_the_flight_comes_to_the_batch_optimum(vehicle, frames) -> None:
    best = optimum(vehicle, frames)
    _, poses, _ = smooth(vehicle, frames, 1.1 * FRAMES * FRAME_S)
    assert best.covariance is not None
    sigma_m = np.sqrt(np.trace(best.covariance[-1, :3, :3]))
    assert np.linalg.norm(poses[-1].t - best.positions[-1]) < 0.1 * sigma_m  # thresholds and noise for Cholesky


def test_a_lag_of_one_frame_is_little_worse(vehicle, frames) -> None:
    truth = true_trajectory(vehicle)
    best = absolute_error(optimum(vehicle, frames), truth)
    _, poses, _ = smooth(vehicle, frames, 0.2)
    assert best is not None
    assert np.linalg.norm(poses[-1].t - truth.positions[-1]) < best.end_m + 0.1


def test_a_landmark_lives_for_the_lag_after_it_was_seen_last(vehicle, frames) -> None:
    back = 3
    _, _, held = smooth(vehicle, frames, (back + 0.5) * FRAME_S)
    for k in range(FRAMES):
        recent = np.concatenate([identities for _, identities in frames[max(0, k - back) : k + 1]])
        assert held[k] == len(np.unique(recent))


def test_a_landmark_that_comes_back_after_the_lag_is_a_new_one(vehicle, frames) -> None:
    (identity, *_) = set(frames[0][1].tolist()) & set(frames[7][1].tolist())
    hidden = [without(frame, identity) if 2 <= k < 6 else frame for k, frame in enumerate(frames)]
    short, _, _ = smooth(vehicle, hidden, 2.5 * FRAME_S)
    whole, _, _ = smooth(vehicle, frames, 2.5 * FRAME_S)
    assert short.landmarks_made == whole.landmarks_made + 1


def test_the_first_frame_has_no_motion_and_all_others_have_one(vehicle, frames) -> None:
    smoother, _, _ = smooth(vehicle, frames[:2], 1.0)
    with pytest.raises(ValueError, match="frame 2 needs the motion"):
        smoother.process(*frames[2], None)


def test_a_frame_without_features_coasts(vehicle, frames) -> None:
    nothing = without((dataclasses.replace(frames[1][0]), np.zeros_like(frames[1][1])), 0)
    _, poses, _ = smooth(vehicle, [frames[0], nothing, frames[2]], 1.0)
    assert np.linalg.norm(poses[1].t - true_trajectory(vehicle).positions[1]) < 1.0
