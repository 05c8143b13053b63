# SPDX-License-Identifier: Apache-2.0
"""Over flights, the fused claim holds at every frame, not only at epochs, whatever the own filter does in between."""

import dataclasses
import functools

import numpy as np
import pytest
from position_nees import position_nees

from uav_vslam.config import VehicleConfig
from uav_vslam.cooperation.fused_pose import move, propagated
from uav_vslam.fleet import CooperativeTrack, cooperate
from uav_vslam.numerics import symmetrise
from uav_vslam.offline.track import track_vehicle
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.types import PoseEstimate

pytestmark = pytest.mark.slow

SEEDS = (1, 2)
FRAMES = 70  # 9.8 s
FIX_SIGMA_M = 0.02  # of a position, as closing a loop gives
LARGEST_MEAN = 1.6  # position NEES per axis: 99.9 % of chi-square over the 6 vehicles, 3 axes and 3 independent times


@functools.cache
def flown(seed: int) -> tuple[dict[str, SimulatedVehicle], dict[str, VehicleTrack], dict[str, CooperativeTrack]]:
    fleet = simulate_fleet(dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, seed=seed))
    landmarks = scatter_landmarks(fleet)
    config = VehicleConfig(imu=fleet[0].scenario.imu_config)
    tracks = {v.name: track_vehicle(SimulatedSource(v, landmarks), config) for v in fleet}
    return {v.name: v for v in fleet}, tracks, cooperate(tracks, dict.fromkeys(tracks, VehicleConfig()))


def fixed(own: PoseEstimate, vehicle: SimulatedVehicle, rng: np.random.Generator) -> PoseEstimate:
    """Return the own pose after a measurement of its position."""
    P, H = own.covariance, np.eye(3, 6)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + FIX_SIGMA_M**2 * np.eye(3))
    seen = vehicle.true_state(own.stamp_ns).T_map_body.t + rng.normal(0.0, FIX_SIGMA_M, 3)
    pose = move(own.T_map_body, np.zeros((0, 3)), K @ (seen - own.T_map_body.t))[0]
    return PoseEstimate(own.stamp_ns, pose, symmetrise(P - K @ H @ P))


@pytest.mark.parametrize("after_frames", [0, 2, 5])
def test_a_correction_of_the_own_filter_leaves_the_fused_claim_true(after_frames: int) -> None:
    """Each epoch of each flight once more, with a correction so many frames after it."""
    found, sigma_m = [], []
    for seed in SEEDS:
        vehicles, tracks, fleet = flown(seed)
        rng = np.random.default_rng(seed)
        for name, track in tracks.items():
            at = [k for k, output in enumerate(track.outputs) if output.joint is not None and k > FRAMES // 2]
            for k in (k + after_frames for k in at if k + after_frames < FRAMES):
                own = track.outputs[k].report.pose
                fused = propagated(own, fleet[name].poses[k], fixed(own, vehicles[name], rng))
                found.append(position_nees(fused, vehicles[name].true_state(fused.stamp_ns)))
                sigma_m.append(np.sqrt(np.trace(fused.covariance[:3, :3])))
    assert np.mean(found) <= LARGEST_MEAN
    assert max(sigma_m) <= 3 * np.sqrt(3) * FIX_SIGMA_M  # nor is it larger than what the correction leaves


def test_the_fused_claim_is_as_true_between_epochs_as_at_them() -> None:
    at, between = [], []
    for seed in SEEDS:
        vehicles, tracks, fleet = flown(seed)
        for name, track in tracks.items():
            for output, pose in zip(track.outputs, fleet[name].poses, strict=True):
                nees = position_nees(pose, vehicles[name].true_state(pose.stamp_ns))
                (at if output.joint is not None else between).append(nees)
    assert np.mean(between) <= 1.1 * np.mean(at)
    assert 0.3 <= np.mean(between) <= LARGEST_MEAN
