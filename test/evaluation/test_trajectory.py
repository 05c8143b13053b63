# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.evaluation.trajectory import Trajectory, interpolate
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.types import PoseEstimate


def turning(count=5, period_ns=10**9):
    """Return constant velocity and constant turn rate: linear interpolation and slerp are exact for it."""
    stamps = np.arange(count, dtype=np.int64) * period_ns
    t = stamps * 1e-9
    poses = [Pose(so3_exp([0.1 * s, 0.5 * s, -0.3 * s]), np.array([2 * s, -s, 5.0])) for s in t]
    positions = np.array([pose.t for pose in poses]).reshape(-1, 3)
    return Trajectory(stamps, positions, np.array([pose.quaternion_wxyz for pose in poses]).reshape(-1, 4))


def test_constant_motion_is_interpolated_exactly():
    wanted = np.array([0, 250_000_000, 1_900_000_000, 4_000_000_000])
    found, rows = interpolate(turning(), wanted, max_gap_s=2.0)
    t = wanted * 1e-9
    assert rows.tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(found.positions, np.stack([2 * t, -t, np.full(4, 5.0)], axis=1), atol=1e-12)
    np.testing.assert_allclose(so3_log(found.rotations), np.outer(t, [0.1, 0.5, -0.3]), atol=1e-9)


def test_a_quaternion_of_the_other_sign_changes_nothing():
    flipped = turning()
    signs = np.where(np.arange(5) % 2, -1.0, 1.0)[:, None]
    flipped = Trajectory(flipped.stamps_ns, flipped.positions, signs * flipped.quaternions_wxyz)
    wanted = np.array([500_000_000, 1_500_000_000])
    np.testing.assert_allclose(
        interpolate(flipped, wanted, max_gap_s=2.0)[0].rotations,
        interpolate(turning(), wanted, max_gap_s=2.0)[0].rotations,
        atol=1e-12,
    )


def test_no_pose_is_returned_outside_or_within_a_gap():
    known = turning().select(np.array([0, 1, 3, 4]))
    wanted = np.array([-1, 500_000_000, 1_000_000_000, 2_000_000_000, 3_000_000_000, 4_000_000_001])
    _, rows = interpolate(known, wanted, max_gap_s=1.5)
    assert rows.tolist() == [1, 2, 4]


@pytest.mark.parametrize(("known", "wanted"), [(0, 3), (3, 0), (0, 0), (1, 1)])
def test_short_inputs_are_interpolated_too(known, wanted):
    found, rows = interpolate(turning().select(np.arange(known)), turning().stamps_ns[:wanted], max_gap_s=2.0)
    assert len(found) == len(rows) == min(known, wanted)


def test_estimates_are_sorted_and_the_last_of_a_stamp_counts():
    def at(stamp_ns, x):
        return PoseEstimate(stamp_ns, Pose(np.eye(3), np.array([x, 0.0, 0.0])), x * np.eye(6))

    trajectory = Trajectory.from_estimates([at(5, 1.0), at(3, 2.0), at(5, 3.0)])
    assert trajectory.stamps_ns.tolist() == [3, 5]
    assert trajectory.positions[:, 0].tolist() == [2.0, 3.0]
    assert trajectory.covariance[1, 0, 0] == 3.0
    assert len(Trajectory.from_estimates([])) == 0


def test_path_length_is_that_of_the_legs():
    assert turning().path_length_m == pytest.approx(4 * np.sqrt(5))
    assert turning().between(10**9, 2 * 10**9).path_length_m == pytest.approx(np.sqrt(5))
    assert turning(0).path_length_m == 0.0


def test_wrong_shapes_and_unordered_stamps_are_refused():
    good = turning(3)
    with pytest.raises(ValueError, match="positions"):
        Trajectory(good.stamps_ns, good.positions[:2], good.quaternions_wxyz)
    with pytest.raises(ValueError, match="strictly increase"):
        Trajectory(good.stamps_ns[::-1], good.positions, good.quaternions_wxyz)


@pytest.mark.parametrize("covariance", [None, np.arange(5)[:, None, None] * np.eye(6)])
def test_estimates_make_the_same_trajectory_again(covariance):
    whole = turning()
    again = Trajectory.from_estimates(
        Trajectory(whole.stamps_ns, whole.positions, whole.quaternions_wxyz, covariance).estimates()
    )
    np.testing.assert_array_equal(again.stamps_ns, whole.stamps_ns)
    np.testing.assert_array_equal(again.positions, whole.positions)
    np.testing.assert_allclose(again.rotations, whole.rotations, atol=1e-12)
    np.testing.assert_array_equal(again.covariance, np.zeros((5, 6, 6)) if covariance is None else covariance)


def test_a_pose_at_the_wanted_stamp_is_taken_as_it_is(truth):
    found, rows = interpolate(truth, truth.stamps_ns[1:], max_gap_s=10.0)
    np.testing.assert_array_equal(rows, np.arange(len(truth) - 1))
    np.testing.assert_array_equal(found.quaternions_wxyz, truth.quaternions_wxyz[1:])
    np.testing.assert_array_equal(found.positions, truth.positions[1:])
