# SPDX-License-Identifier: Apache-2.0
"""Remembered landmarks match a filter that keeps all landmarks."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.slam.landmark_memory import OWN_SIGMA_M, LandmarkMemory
from uav_vslam.types import JointInformation

Array = NDArray[np.float64]

COUNT = 7
LEAVING = (2, 5)
ROUNDING = 1e-6
SIGMA_M = 0.1  # of a measurement


class Kept:
    """A linear filter over the pose and all landmarks; its published belief omits some."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        n = POSE_DIM + 3 * COUNT
        self.truth = self._rng.normal(0.0, 20.0, n)
        self.Y = 0.01 * np.eye(n)
        self.mean = self.truth + self._rng.normal(0.0, 10.0, n)

    def measure(self, landmarks: list[int], sigma: float = SIGMA_M) -> None:
        """Measure landmarks relative to the position."""
        for landmark in landmarks:
            H = np.zeros((3, len(self.mean)))
            H[:, landmark_rows(POSE_DIM, np.array([landmark]))] = np.eye(3)
            H[:, :3] = -np.eye(3)
            z = H @ self.truth + self._rng.normal(0.0, sigma, 3)
            self.Y += H.T @ H / sigma**2
            self.mean += np.linalg.solve(self.Y, H.T @ (z - H @ self.mean) / sigma**2)

    def locate(self, landmark: int, sigma: float = SIGMA_M) -> None:
        """Measure where a landmark is in the map: the drift that it shares with all others goes."""
        rows = landmark_rows(POSE_DIM, np.array([landmark]))
        self.Y[rows, rows] += 1.0 / sigma**2
        residual = np.zeros(len(self.mean))
        residual[rows] = (self.truth - self.mean)[rows] / sigma**2
        self.mean += np.linalg.solve(self.Y, residual)

    def move(self, step: Array, sigma: float = 0.5) -> None:
        """Move the pose by a step that is known to a sigma."""
        P = np.linalg.inv(self.Y)
        P[:POSE_DIM, :POSE_DIM] += sigma**2 * np.eye(POSE_DIM)
        self.Y = np.linalg.inv(P)
        self.truth[:POSE_DIM] += step + self._rng.normal(0.0, sigma, POSE_DIM)
        self.mean[:POSE_DIM] += step

    def joint(self, make_joint, landmarks: list[int], session: int = 1) -> JointInformation:
        rows = np.concatenate([np.arange(POSE_DIM), landmark_rows(POSE_DIM, np.array(landmarks))])
        joint = make_joint(
            self.mean[POSE_DIM:].reshape(-1, 3)[landmarks], np.linalg.inv(self.Y)[np.ix_(rows, rows)], session=session
        )
        return dataclasses.replace(joint, ids=np.array(landmarks, np.uint32) + 100)


def covariance_of(joint: JointInformation, ids: list[int]) -> Array:
    places = [joint.ids.tolist().index(i) for i in ids]
    rows = landmark_rows(POSE_DIM, np.array(places))
    return np.asarray(np.linalg.inv(joint.information)[np.ix_(rows, rows)])


@pytest.mark.parametrize("seed", range(5))
def test_removed_landmarks_match_a_filter_that_keeps_everything(make_joint, seed: int) -> None:
    """The pose moves and others are measured again: the remembered ones are updated, with the right covariance.

    The neglected correlation with the poses is a fraction of a measurement's error.
    """
    filter_ = Kept(seed)
    everything, staying = list(range(COUNT)), [k for k in range(COUNT) if k not in LEAVING]
    filter_.measure(everything)
    memory = LandmarkMemory(capacity=10)
    memory.extended(filter_.joint(make_joint, everything), shared=[100 + k for k in LEAVING])
    for _ in range(3):
        filter_.move(np.array([5.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
        filter_.measure(staying)
        extended = memory.extended(filter_.joint(make_joint, staying), shared=[100 + k for k in LEAVING])
    ids = [100 + k for k in LEAVING]
    assert extended.ids.tolist() == [100 + k for k in staying] + ids
    wanted = np.linalg.inv(filter_.Y)[np.ix_(*[landmark_rows(POSE_DIM, np.array(LEAVING))] * 2)]
    np.testing.assert_allclose(covariance_of(extended, ids), wanted, rtol=0, atol=ROUNDING + 2 * OWN_SIGMA_M**2)
    mean = filter_.mean[POSE_DIM:].reshape(-1, 3)[list(LEAVING)]
    np.testing.assert_allclose(extended.positions[-len(LEAVING) :], mean, rtol=0, atol=0.2 * SIGMA_M)


def test_what_left_follows_a_correction_of_what_stayed(make_joint) -> None:
    filter_ = Kept(1)
    everything, staying = list(range(COUNT)), [k for k in range(COUNT) if k not in LEAVING]
    filter_.measure(everything)
    memory = LandmarkMemory(capacity=10)
    memory.extended(filter_.joint(make_joint, everything), shared=[100 + k for k in LEAVING])
    ids = [100 + k for k in LEAVING]
    before = memory.extended(filter_.joint(make_joint, staying), shared=ids).positions[-len(LEAVING) :]
    filter_.locate(staying[0])
    after = memory.extended(filter_.joint(make_joint, staying), shared=ids).positions[-len(LEAVING) :]
    mean = filter_.mean[POSE_DIM:].reshape(-1, 3)[list(LEAVING)]
    np.testing.assert_allclose(after, mean, rtol=0, atol=0.2 * SIGMA_M)
    assert np.linalg.norm(after - before, axis=1).min() > 10 * SIGMA_M


def test_a_landmark_that_comes_back_is_no_longer_remembered(make_joint) -> None:
    """As a tracked point does that was in one belief, and not in the next: a packet with it twice would be refused."""
    filter_ = Kept(3)
    everything, staying = list(range(COUNT)), [k for k in range(COUNT) if k not in LEAVING]
    filter_.measure(everything)
    memory, shared = LandmarkMemory(capacity=10), [100 + k for k in LEAVING]
    memory.extended(filter_.joint(make_joint, everything), shared)
    memory.extended(filter_.joint(make_joint, staying), shared)
    back, gone = LEAVING
    filter_.measure([*staying, back])
    extended = memory.extended(filter_.joint(make_joint, [*staying, back]), shared)
    assert extended.ids.tolist() == [100 + k for k in [*staying, back, gone]]
    both = landmark_rows(POSE_DIM, np.array(LEAVING))
    wanted = np.linalg.inv(filter_.Y)[np.ix_(both, both)]
    np.testing.assert_allclose(covariance_of(extended, shared), wanted, rtol=0, atol=0.1 * SIGMA_M**2)
    again = memory.extended(filter_.joint(make_joint, staying), shared)
    assert sorted(again.ids.tolist()) == [100 + k for k in everything]


def test_remembering_adds_no_information_on_the_state(make_joint) -> None:
    filter_ = Kept(0)
    filter_.measure(list(range(COUNT)))
    memory = LandmarkMemory(capacity=10)
    memory.extended(filter_.joint(make_joint, list(range(COUNT))), shared=[102, 105])
    joint = filter_.joint(make_joint, [0, 1, 3, 4, 6])
    extended = memory.extended(joint, shared=[102, 105])
    n = len(joint.information)
    np.testing.assert_allclose(
        np.linalg.inv(extended.information)[:n, :n], np.linalg.inv(joint.information), rtol=1e-6, atol=1e-9
    )


def test_only_shared_landmarks_are_remembered_and_at_most_the_capacity(make_joint) -> None:
    filter_ = Kept(1)
    filter_.measure(list(range(COUNT)))
    before, after = filter_.joint(make_joint, list(range(COUNT))), filter_.joint(make_joint, [0, 1])
    for shared, capacity, expected in (([102], 10, 1), ([], 10, 0), ([102, 103, 104, 105], 3, 3), ([102], 0, 0)):
        memory = LandmarkMemory(capacity)
        memory.extended(before, shared)
        assert len(memory.extended(after, shared).ids) == 2 + expected


@pytest.mark.parametrize(("shared", "offered"), [([], [102, 104]), ([103], [102, 104, 105])])
def test_offered_landmarks_fill_the_remaining_capacity(make_joint, shared: list[int], offered: list[int]) -> None:
    filter_ = Kept(4)
    filter_.measure(list(range(COUNT)))
    memory = LandmarkMemory(capacity=2)
    memory.extended(filter_.joint(make_joint, list(range(COUNT))), shared, offered)
    remembered = set(memory.extended(filter_.joint(make_joint, [0, 1, 6]), shared, offered).ids[3:].tolist())
    assert len(remembered) == 2
    assert set(shared) <= remembered <= {*shared, *offered}


def test_remembered_landmarks_survive_the_removal_of_those_they_are_conditioned_on(make_joint) -> None:
    filter_ = Kept(2)
    filter_.measure(list(range(COUNT)))
    memory, shared = LandmarkMemory(10), [102, 105]
    memory.extended(filter_.joint(make_joint, list(range(COUNT))), shared)
    memory.extended(filter_.joint(make_joint, [0, 1, 3, 4, 6]), shared)
    extended = memory.extended(filter_.joint(make_joint, [0, 6]), shared)
    assert extended.ids.tolist() == [100, 106, 102, 105]
    wanted = np.linalg.inv(filter_.Y)[np.ix_(*[landmark_rows(POSE_DIM, np.array(LEAVING))] * 2)]
    np.testing.assert_allclose(covariance_of(extended, shared), wanted, rtol=0, atol=ROUNDING + 4 * OWN_SIGMA_M**2)


def test_a_new_session_and_a_reinitialised_filter_clear_the_memory(make_joint) -> None:
    filter_ = Kept(3)
    filter_.measure(list(range(COUNT)))
    for later in (filter_.joint(make_joint, [0, 1], session=2), filter_.joint(make_joint, [])):
        memory = LandmarkMemory(10)
        memory.extended(filter_.joint(make_joint, list(range(COUNT))), [102])
        assert len(memory.extended(later, [102]).ids) == len(later.ids)
