# SPDX-License-Identifier: Apache-2.0
"""The engine of the fusion studies: its monitor detects over-confident packets."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import FusionConfig, VehicleConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.slam.packet import PacketPolicy, make_packet
from uav_vslam.studies.engine.cooperation import Setting, _fused, _PacketMonitor
from uav_vslam.studies.engine.separate_frames import fly_own_only, with_joints
from uav_vslam.types import JointInformation, LandmarkPacket

POINTS = [[-10.0, 0.0, 0.0], [20.0, 5.0, 1.0], [0.0, 30.0, -1.0]]
VARIANCES = [0.04, 1.0, 9.0]  # of the landmarks [m^2]: a packet compared with the wrong ones would be far off


@pytest.fixture
def joint(make_joint) -> JointInformation:
    return make_joint(POINTS, np.diag(np.r_[np.full(6, 0.01), np.repeat(VARIANCES, 3)]))


def monitored(joint: JointInformation, packet: LandmarkPacket) -> _PacketMonitor:
    fusion, monitor = Fusion(joint.vehicle, FusionConfig()), _PacketMonitor()
    fusion.fuse(joint)
    monitor.on_packet(fusion, packet, 100)
    return monitor


def in_other_order(joint: JointInformation) -> LandmarkPacket:
    P = np.linalg.inv(joint.information)
    order, rows = [2, 0, 1], [*range(6), 12, 13, 14, 6, 7, 8, 9, 10, 11]
    turned = dataclasses.replace(
        joint,
        ids=joint.ids[order],
        positions=joint.positions[order],
        information=np.linalg.inv(P[np.ix_(rows, rows)]),
        descriptors=joint.descriptors[order],
    )
    return make_packet(turned, sequence=1, policy=PacketPolicy(max_landmarks=3))


def test_an_honest_packet_rings_no_alarm(joint: JointInformation) -> None:
    packet = in_other_order(joint)
    assert packet.ids.tolist() != joint.ids.tolist()
    assert 0.9 < monitored(joint, packet).largest <= 1.0


@pytest.mark.parametrize("landmark", range(3))
def test_a_packet_that_claims_more_than_is_known_of_one_landmark_rings(joint: JointInformation, landmark: int) -> None:
    """With a third of the variance, the largest eigenvalue of R^-1 P is 3, less what the coding rounds up."""
    P = joint.covariance.copy()
    P[6 + 3 * landmark : 9 + 3 * landmark] /= 3.0
    packet = in_other_order(dataclasses.replace(joint, information=np.linalg.inv(P)))
    assert 2.7 < monitored(joint, packet).largest <= 3.0


def test_the_alarm_keeps_ringing_after_honest_packets(joint: JointInformation) -> None:
    fusion, monitor = Fusion(joint.vehicle, FusionConfig()), _PacketMonitor()
    fusion.fuse(joint)
    doubled = dataclasses.replace(joint, information=2.0 * joint.information)
    for sent in (doubled, joint):
        monitor.on_packet(fusion, in_other_order(sent), 100)
    assert monitor.largest > 1.8


def test_a_fusion_that_breaks_down_is_a_failure_of_its_setting_alone() -> None:
    scenario = Scenario(frames=16)
    flown = fly_own_only(scenario)
    nothing_known = {
        name: with_joints(track, lambda joint: dataclasses.replace(joint, information=0.0 * joint.information))
        for name, track in flown.tracks.items()
    }
    broken = dataclasses.replace(flown, tracks=nothing_known)
    outcomes = _fused(scenario, Setting("split_ci"), VehicleConfig(imu=scenario.imu_config), broken)
    assert [outcome.failure for outcome in outcomes] == ["Singular matrix"] * 2
