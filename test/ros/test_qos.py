# SPDX-License-Identifier: Apache-2.0
"""A vehicle hears its peers whatever mode they are in: it asks for no more than they offer."""

import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.duration import Duration
from rclpy.qos import (
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)

from uav_vslam.ros.qos import RADIO, asking_no_more

MODES = sorted(RADIO)
NARROW = RADIO["narrowband"]


@pytest.mark.parametrize("own", MODES)
@pytest.mark.parametrize("peer", MODES)
def test_whatever_two_vehicles_modes_are_a_packet_passes(own: str, peer: str) -> None:
    asked = asking_no_more(RADIO[own], [RADIO[peer]])
    found, reason = qos_check_compatible(RADIO[peer], asked)
    assert found != QoSCompatibility.ERROR, reason
    assert qos_check_compatible(RADIO[peer], RADIO[own])[0] == QoSCompatibility.ERROR or own == peer


@pytest.mark.parametrize("mode", MODES)
def test_a_peer_in_the_same_mode_is_asked_for_all_that_the_mode_has(mode: str) -> None:
    assert asking_no_more(RADIO[mode], [RADIO[mode]]) == RADIO[mode]
    assert asking_no_more(RADIO[mode], []) == RADIO[mode]


def test_an_unlimited_deadline_meets_no_wish_for_one() -> None:
    infinite = QoSProfile(depth=1, deadline=Duration(seconds=9223372036, nanoseconds=854775807))
    for offer in (infinite, QoSProfile(depth=1), QoSProfile(depth=1, deadline=Duration(seconds=4))):
        assert asking_no_more(NARROW, [offer]).deadline == Duration()
    assert asking_no_more(NARROW, [QoSProfile(depth=1, deadline=Duration(seconds=2))]).deadline == NARROW.deadline


def test_the_modes_are_those_of_the_design() -> None:
    wide = RADIO["wideband"]
    assert (wide.reliability, wide.history, wide.depth) == (ReliabilityPolicy.RELIABLE, HistoryPolicy.KEEP_LAST, 10)
    assert (NARROW.reliability, NARROW.history, NARROW.depth) == (
        ReliabilityPolicy.BEST_EFFORT,
        HistoryPolicy.KEEP_LAST,
        1,
    )
    assert NARROW.lifespan == Duration(seconds=2)
