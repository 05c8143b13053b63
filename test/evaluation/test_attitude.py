# SPDX-License-Identifier: Apache-2.0
"""Ground truth that never turns has no attitude if the estimate turns; then positions alone are scored."""

import numpy as np
import pytest

from uav_vslam.evaluation.attitude import LEAST_TURN_RAD, lacks_attitude, turn_between
from uav_vslam.evaluation.consistency import nees
from uav_vslam.evaluation.scores import RELATIVE_KEYS, track_scores
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import (
    quaternion_wxyz_from_rotation,
    rotation_from_quaternion_wxyz,
    rotation_from_rpy,
    so3_exp,
)

COUNT = 301


def flown(turn_rad: float) -> Trajectory:
    """Return 30 s straight on at 20 m/s, turning evenly."""
    positions = np.column_stack([2.0 * np.arange(COUNT), np.zeros(COUNT), np.full(COUNT, 70.0)])
    R = rotation_from_rpy(np.zeros(COUNT), np.zeros(COUNT), np.linspace(0.0, turn_rad, COUNT))
    covariance = np.broadcast_to(np.eye(6), (COUNT, 6, 6))
    return Trajectory(10**8 * np.arange(COUNT, dtype=np.int64), positions, quaternion_wxyz_from_rotation(R), covariance)


@pytest.mark.parametrize(
    ("true_rad", "turn_rad", "lacks"),
    [(0.0, 1.1 * LEAST_TURN_RAD, True), (0.0, 0.9 * LEAST_TURN_RAD, False), (1e-3, 2.0, False)],
)
def test_only_truth_that_never_turns_beside_an_estimate_that_does_lacks_an_attitude(
    true_rad: float, turn_rad: float, lacks: bool
) -> None:
    assert lacks_attitude(flown(true_rad), flown(turn_rad)) == lacks
    assert not lacks_attitude(flown(true_rad).between(1, 0), flown(turn_rad))
    assert not lacks_attitude(flown(true_rad), flown(turn_rad).between(1, 0))


def test_without_an_attitude_positions_alone_are_scored() -> None:
    truth, estimate = flown(0.0), flown(1.0)
    scores = track_scores(estimate, truth)
    values = nees(estimate, truth)
    assert scores["ate_m"] == scores["nees_position"] == 0.0
    for key in ("rpe_5s_m", "rpe_5s_deg", "nees_rotation", "nees_rotation_end", *RELATIVE_KEYS):
        assert scores[key] is None
    assert values is not None
    assert np.isnan(values.rotation).all()


def test_the_turn_of_the_truths_axes_is_found_whatever_the_heading_of_its_frame() -> None:
    flight, turn, R_world_map = flown(1.0), np.array([0.3, -1.1, 2.0]), rotation_from_rpy(0.0, 0.0, 2.0)
    R_truth = R_world_map @ rotation_from_quaternion_wxyz(flight.quaternions_wxyz) @ so3_exp(turn)
    positions = flight.positions @ R_world_map.T + [100.0, 0.0, 3.0]
    truth = Trajectory(flight.stamps_ns, positions, quaternion_wxyz_from_rotation(R_truth))
    assert turn_between(flight, truth) == pytest.approx((np.linalg.norm(turn), 0.0), abs=1e-6)
    assert turn_between(flight, flown(0.0))[1] > 0.2  # of an estimate that has turned by mistake
    wandering = np.array([[0.0, 0.0, 0.0], [1.0, -1.0, 0.0]])[np.arange(len(flight)) % 2] * np.ptp(positions)
    lost = Trajectory(flight.stamps_ns, flight.positions + wandering, flight.quaternions_wxyz)
    assert turn_between(lost, flight)[1] > 0.2  # its heading, fitted to such positions, means nothing
