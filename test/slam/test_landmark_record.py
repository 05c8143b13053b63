# SPDX-License-Identifier: Apache-2.0
"""Every landmark of a flight once, as it was last estimated."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.slam.landmark_record import LandmarkRecord
from uav_vslam.types import JointInformation, MappedLandmarks


def joint(epoch: int, ids: list[int]) -> JointInformation:
    """Return a belief over a pose and landmarks with random correlations."""
    rng = np.random.default_rng(epoch)
    root = rng.normal(size=(6 + 3 * len(ids), 6 + 3 * len(ids))) + 5.0 * np.eye(6 + 3 * len(ids))
    return JointInformation(
        stamp_ns=10**18 + epoch,
        vehicle="uav1",
        session=1,
        T_map_body=Pose(np.eye(3), np.zeros(3)),
        ids=np.array(ids, np.uint32),
        positions=rng.normal(size=(len(ids), 3)),
        information=root @ root.T,
        descriptors=np.zeros((len(ids), 4), np.uint8),
    )


def recorded(joints: list[JointInformation]) -> MappedLandmarks:
    record = LandmarkRecord()
    for one in joints:
        record.add(one)
    return record.landmarks()


def test_each_landmark_is_that_of_the_last_epoch_that_held_it() -> None:
    joints = [joint(0, [1, 2, 3]), joint(1, [2, 3, 4]), joint(2, [4, 2])]
    last = {1: (0, 0), 3: (1, 1), 4: (2, 0), 2: (2, 1)}  # epoch and row
    found = recorded(joints)
    assert found.ids.tolist() == sorted(last)
    for identifier, position, covariance in zip(found.ids.tolist(), found.positions, found.covariances, strict=True):
        epoch, row = last[identifier]
        np.testing.assert_array_equal(position, joints[epoch].positions[row])
        own = slice(6 + 3 * row, 9 + 3 * row)
        np.testing.assert_allclose(covariance, np.linalg.inv(joints[epoch].information)[own, own], rtol=1e-9)


@pytest.mark.parametrize("joints", [[], [joint(0, [])]])
def test_a_flight_without_landmarks_has_an_empty_map(joints: list[JointInformation]) -> None:
    found = recorded(joints)
    assert (found.ids.shape, found.positions.shape, found.covariances.shape) == ((0,), (0, 3), (0, 3, 3))


def test_an_epoch_that_is_not_positive_definite_is_passed_over() -> None:
    lost = dataclasses.replace(joint(1, [1, 9]), information=-np.eye(12))
    assert recorded([joint(0, [1]), lost]).ids.tolist() == [1]
