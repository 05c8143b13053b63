# SPDX-License-Identifier: Apache-2.0
"""Without a common origin only the shape of a peer's map gives information, and its frame is estimated too."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.slam.packet import PacketPolicy, make_packet

COUNT = 20
T_PEER_OWN = Pose(so3_exp(np.array([0.0, 0.0, 2.0])), np.array([30.0, -10.0, 4.0]))


def covariance() -> np.ndarray:
    """Return (6+3N, 6+3N): 5 m of common error, 0.1 m of each landmark's own."""
    common = np.vstack([np.eye(3), np.zeros((3, 3)), np.tile(np.eye(3), (COUNT, 1))])
    return 25.0 * common @ common.T + np.diag([1e-3] * POSE_DIM + [0.01] * (3 * COUNT))


@pytest.fixture
def joints(make_joint):
    rng = np.random.default_rng(3)
    truth = np.column_stack([rng.uniform(-40, 40, (COUNT, 2)), rng.uniform(-3, 3, COUNT)])
    seen = truth + rng.normal(0.0, 0.1, truth.shape)
    own = make_joint(truth, covariance(), stamp_ns=10_000_000_000)
    return own, make_joint(T_PEER_OWN.apply(seen), covariance(), vehicle="uav2", stamp_ns=9_000_000_000)


def test_the_frame_is_found_and_the_position_gains_no_information(joints) -> None:
    own, peer = joints
    fusion = Fusion("uav1", FusionConfig(common_origin=False))
    assert fusion.frame("uav2").reason != ""
    fusion.inbox.add(make_packet(peer, sequence=1, policy=PacketPolicy()))
    epoch = fusion.fuse(own)
    assert fusion.frame("uav2").reason == ""
    error = epoch.frames["uav2"].T_own_peer @ T_PEER_OWN
    assert np.linalg.norm(error.apply(own.positions.mean(axis=0)) - own.positions.mean(axis=0)) < 0.2
    assert np.rad2deg(np.linalg.norm(so3_log(error.R))) < 0.5
    ratio = np.trace(epoch.pose.covariance[:3, :3]) / np.trace(epoch.own.covariance[:3, :3])
    assert 0.98 < ratio <= 1.0


def test_with_a_common_origin_no_frame_is_sought(joints) -> None:
    own, peer = joints
    fusion = Fusion("uav1", FusionConfig())
    here = dataclasses.replace(peer, positions=own.positions)
    fusion.inbox.add(make_packet(here, sequence=1, policy=PacketPolicy()))
    epoch = fusion.fuse(own)
    assert epoch.frames == {}
    assert np.trace(epoch.pose.covariance[:3, :3]) < 0.6 * np.trace(epoch.own.covariance[:3, :3])


def test_feedback_from_a_peer_in_an_unknown_frame_is_ignored(joints) -> None:
    own, peer = joints
    there, here = (Fusion(name, FusionConfig(common_origin=False)) for name in ("uav2", "uav1"))
    there.inbox.add(make_packet(dataclasses.replace(own, stamp_ns=8_000_000_000), sequence=1, policy=PacketPolicy()))
    there.fuse(peer)
    feedback = there.feedback("uav1")
    assert feedback is not None
    here.returned.add(feedback)
    epoch = here.fuse(own)
    np.testing.assert_array_equal(epoch.pose.covariance, epoch.own.covariance)


def test_feedback_in_a_frame_that_was_found_is_used_until_the_frame_is_forgotten(joints) -> None:
    own, peer = joints
    there, here = (Fusion(name, FusionConfig(common_origin=False)) for name in ("uav2", "uav1"))
    there.inbox.add(make_packet(dataclasses.replace(own, stamp_ns=8_000_000_000), sequence=1, policy=PacketPolicy()))
    there.fuse(peer)
    here.inbox.add(make_packet(peer, sequence=1, policy=PacketPolicy()))
    here.fuse(own)
    here.inbox.peers["uav2"].packets.clear()
    assert here.fuse(own).sources == set(own.sources)
    here.returned.add(there.feedback("uav1"))
    assert here.fuse(own).sources > set(own.sources)
    assert here.returned.peers["uav2"].common_landmarks > 10
    here.frame("uav2")._link._reset("contradicted")
    assert here.fuse(own).sources == set(own.sources)
    assert here.returned.peers["uav2"].common_landmarks == 0
