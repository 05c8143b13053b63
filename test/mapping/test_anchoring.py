# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest

from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew, so3_exp, so3_log
from uav_vslam.mapping.anchoring import anchored
from uav_vslam.types import PoseEstimate

FRAMES, PERIOD_NS = 120, 140_000_000
DRIFT = np.array([0.02, 0.02, 0.01, 1e-5, 1e-5, 1e-4])  # of the smoothed poses, from frame to frame
TRUTH = [Pose(so3_exp([0.0, 0.0, 0.01 * k]), np.array([2.8 * k, 0.02 * k**2, 70.0])) for k in range(FRAMES)]


def wrong(pose: Pose, error: np.ndarray) -> Pose:
    """Return the estimate with an error (6,): the truth is it, moved by the error."""
    return Pose(so3_exp(-error[3:]) @ pose.R, pose.t - error[:3])


def error_of(estimate: Pose, truth: Pose) -> np.ndarray:
    return np.concatenate([truth.t - estimate.t, so3_log(truth.R @ estimate.R.T)])


def flight(rng: np.random.Generator, memory: float = 0.97) -> tuple[list[PoseEstimate], list[PoseEstimate]]:
    """Return smoothed poses that drift rigidly, and fused ones whose error is bounded and forgets slowly."""
    smoothed, fused = [], []
    error, P = np.zeros(6), np.diag(np.repeat([0.05, 0.002], 3) ** 2)
    start = rng.multivariate_normal(np.zeros(6), P)
    error = start
    R = np.diag(np.array([0.2, 0.2, 0.1, 1e-3, 1e-3, 2e-3]) ** 2)
    place = rng.multivariate_normal(np.zeros(6), R)
    for k, truth in enumerate(TRUTH):
        if k > 0:
            F = np.eye(6)
            F[:3, 3:] = -skew(truth.t - TRUTH[k - 1].t)
            error = F @ error + rng.normal(0.0, DRIFT)
            P = F @ P @ F.T + np.diag(DRIFT**2)
            place = memory * place + np.sqrt(1.0 - memory**2) * rng.multivariate_normal(np.zeros(6), R)
        stamp = 10**9 + k * PERIOD_NS
        smoothed.append(PoseEstimate(stamp, wrong(truth, error), P))
        fused.append(PoseEstimate(stamp, wrong(truth, place), R))
    return smoothed, fused


MEMORY_S = -0.14 / np.log(0.97)


def rms(poses: list[PoseEstimate]) -> float:
    errors = [error_of(p.T_map_body, truth)[:3] for p, truth in zip(poses, TRUTH, strict=True)]
    return float(np.sqrt(np.mean(np.square(errors))))


def relative_rms(poses: list[PoseEstimate], step: int = 5) -> float:
    moved = [
        (a.T_map_body.inverse() @ b.T_map_body).t - (ta.inverse() @ tb).t
        for a, b, ta, tb in zip(poses, poses[step:], TRUTH, TRUTH[step:], strict=False)
    ]
    return float(np.sqrt(np.mean(np.square(moved))))


def test_the_place_is_better_than_either_and_the_shape_that_of_the_smoothed() -> None:
    found, parts = [], []
    for seed in range(12):
        smoothed, fused = flight(np.random.default_rng(seed))
        poses = anchored(smoothed, fused, memory_s=MEMORY_S)
        found.append(rms(poses))
        parts.append([rms(smoothed), rms(fused), relative_rms(poses), relative_rms(smoothed), relative_rms(fused)])
    own, fleet, shape, own_shape, fleet_shape = np.mean(parts, axis=0)
    assert np.mean(found) < 0.9 * min(own, fleet)
    assert shape < 1.05 * own_shape < 0.5 * fleet_shape


def test_the_claimed_covariance_is_honest() -> None:
    normalised = []
    for seed in range(20):
        poses = anchored(*flight(np.random.default_rng(100 + seed)), memory_s=MEMORY_S)
        for k in range(0, FRAMES, 20):
            error = error_of(poses[k].T_map_body, TRUTH[k])
            normalised.append(error @ np.linalg.solve(poses[k].covariance, error) / 6.0)
    assert 0.5 < np.mean(normalised) < 1.6


def test_twice_as_many_fused_poses_of_the_same_process_tell_no_more() -> None:
    smoothed, fused = flight(np.random.default_rng(1))
    every, second = (anchored(smoothed, fused[::step], memory_s=2.0)[60].covariance for step in (1, 2))
    assert np.sqrt(np.trace(every[:3, :3]) / np.trace(second[:3, :3])) == pytest.approx(1.0, abs=0.05)
    naive = anchored(smoothed, fused, memory_s=1e-9)[60].covariance
    assert np.trace(naive[:3, :3]) < 0.5 * np.trace(every[:3, :3])


def test_a_fused_track_that_is_the_smoothed_one_moved_rigidly_is_reproduced() -> None:
    smoothed, _ = flight(np.random.default_rng(2))
    turn = Pose(so3_exp([0.0, 0.0, 0.01]), np.array([1.0, -2.0, 0.5]))
    fused = [dataclasses.replace(p, T_map_body=turn @ p.T_map_body) for p in smoothed]
    for found, wanted in zip(anchored(smoothed, fused), fused, strict=True):
        assert found.T_map_body.t == pytest.approx(wanted.T_map_body.t, abs=0.02)
        assert np.abs(found.T_map_body.R - wanted.T_map_body.R).max() < 1e-4


def test_a_step_of_the_fused_poses_leaves_no_step() -> None:
    smoothed, fused = flight(np.random.default_rng(3))
    step = Pose(np.eye(3), np.array([0.0, 0.5, 0.0]))
    later = [dataclasses.replace(p, T_map_body=step @ p.T_map_body) for p in fused[60:]]
    fused = [*fused[:60], *later]
    poses = anchored(smoothed, fused)
    steps = [
        (b.T_map_body.t - a.T_map_body.t) - (d.T_map_body.t - c.T_map_body.t)
        for a, b, c, d in zip(poses, poses[1:], smoothed, smoothed[1:], strict=False)
    ]
    assert np.abs(steps).max() < 0.05


def test_fused_poses_of_few_frames_suffice() -> None:
    smoothed, fused = flight(np.random.default_rng(4))
    assert len(anchored(smoothed, fused[10:11])) == FRAMES
    assert len(anchored(smoothed[:1], fused[:1])) == 1
    assert anchored([], fused) == []


def test_poses_of_another_time_are_refused() -> None:
    smoothed, fused = flight(np.random.default_rng(5))
    other = [dataclasses.replace(p, stamp_ns=p.stamp_ns + 1) for p in fused]
    with pytest.raises(UavVslamError, match="no stamp in common"):
        anchored(smoothed, other)
