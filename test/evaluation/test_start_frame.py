# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.evaluation.start_frame import in_start_frame
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import (
    quaternion_wxyz_from_rotation,
    rotation_from_rpy,
    rpy_from_rotation,
    so3_exp,
    so3_log,
)

Array = NDArray[np.float64]

STEP_NS = 100_000_000


def circling(count: int = 30) -> Trajectory:
    k = np.arange(count)
    rpy = np.stack([0.1 + 0.01 * k, np.full(count, -0.2), 0.5 + 0.1 * k])
    positions = np.stack([100.0 + 3.0 * k, 50.0 + 0.1 * k**2, 70.0 + 0.2 * k], axis=1)
    return Trajectory(k * STEP_NS, positions, quaternion_wxyz_from_rotation(rotation_from_rpy(*rpy)))


def started(R_map_body: Array, stamp_ns: int = 7 * STEP_NS) -> Trajectory:
    """Return an estimate that has only begun."""
    return Trajectory(np.array([stamp_ns]), np.zeros((1, 3)), quaternion_wxyz_from_rotation(R_map_body[None]))


def test_the_start_is_the_origin_with_the_estimated_heading_and_its_own_tilt() -> None:
    moved = in_start_frame(circling(), started(rotation_from_rpy(0.17, -0.2, -1.3)))
    assert moved is not None
    np.testing.assert_allclose(moved.positions[7], np.zeros(3), atol=1e-12)
    np.testing.assert_allclose(rpy_from_rotation(moved.rotations[7]), [0.17, -0.2, -1.3], atol=1e-12)


@pytest.mark.parametrize("pitch", [0.0, -np.pi / 2])
def test_an_error_of_the_estimated_tilt_is_none_of_the_heading(pitch: float) -> None:
    """With the x axis up, the yaw angle of a start that is 0.01 rad wrong is any."""
    truth = dataclasses.replace(
        circling(1), quaternions_wxyz=quaternion_wxyz_from_rotation(rotation_from_rpy(0.3, pitch, 0.7)[None])
    )
    estimated = so3_exp([0.01, -0.01, 0.0]) @ rotation_from_rpy(0.0, 0.0, 2.0) @ truth.rotations[0]
    moved = in_start_frame(truth, started(estimated, 0))
    assert moved is not None
    np.testing.assert_allclose(so3_log(estimated @ moved.rotations[0].T), [0.01, -0.01, 0.0], atol=1e-4)


def test_heights_and_body_frame_motions_are_preserved() -> None:
    truth = circling()
    moved = in_start_frame(truth, started(np.eye(3)))
    assert moved is not None
    np.testing.assert_allclose(np.diff(moved.positions[:, 2]), np.diff(truth.positions[:, 2]), atol=1e-12)
    in_body = [np.einsum("nji,nj->ni", t.rotations[:-1], np.diff(t.positions, axis=0)) for t in (truth, moved)]
    np.testing.assert_allclose(in_body[0], in_body[1], atol=1e-12)


def test_a_start_between_two_truths_is_interpolated() -> None:
    moved = in_start_frame(circling(), started(np.eye(3), 7 * STEP_NS + STEP_NS // 2))
    assert moved is not None
    np.testing.assert_allclose(moved.positions[7] + moved.positions[8], np.zeros(3), atol=1e-12)


def test_positions_alone_are_turned_to_the_estimate() -> None:
    truth = circling()
    flown = in_start_frame(truth, started(np.eye(3), 0))
    assert flown is not None
    identity = np.tile([1.0, 0.0, 0.0, 0.0], (len(truth), 1))
    moved = in_start_frame(dataclasses.replace(truth, quaternions_wxyz=identity), flown)
    assert moved is not None
    np.testing.assert_allclose(moved.positions, flown.positions, atol=1e-9)


def test_without_ground_truth_at_the_start_there_is_no_reference() -> None:
    assert in_start_frame(circling(), started(np.eye(3), 1000 * STEP_NS)) is None
