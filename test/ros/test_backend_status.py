# SPDX-License-Identifier: Apache-2.0
"""Alarms of the back end last while what they warn of is recent; the estimated calibration is among its notes."""

import dataclasses
import logging
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")

from uav_vslam.estimation.rig_belief import DisparityEstimate, TimeOffset  # noqa: E402
from uav_vslam.geometry.pose import Pose  # noqa: E402
from uav_vslam.ros.backend_status import MANY_BLIND, MANY_COASTED, BackendStatus  # noqa: E402
from uav_vslam.ros.vehicle_node import VehicleNode  # noqa: E402
from uav_vslam.slam.frame_output import FrameOutput  # noqa: E402
from uav_vslam.slam.frame_report import FrameReport  # noqa: E402
from uav_vslam.types import NS_PER_S, NavEstimate, NavState, PoseEstimate  # noqa: E402

pytestmark = pytest.mark.ros
FRAME_NS = NS_PER_S // 5
RECENT_FRAMES = 50  # 10 s


class StandIn:
    """What of a node the status needs."""

    report_alarm = VehicleNode.report_alarm

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.notes: dict[str, str] = {}
        self.alarms: dict[str, str] = {}

    get_logger = staticmethod(logging.getLogger)


@pytest.fixture
def node() -> StandIn:
    return StandIn()


@pytest.fixture
def report(node: StandIn) -> Callable[[FrameOutput], None]:
    return BackendStatus(node).report


def frame(
    number: int, *, features: int = 50, coasted: bool = False, recovery: str = "", warnings: tuple[str, ...] = ()
) -> FrameOutput:
    state = NavState(1000 * NS_PER_S + number * FRAME_NS, Pose.identity(), np.zeros(3), np.zeros(3), np.zeros(3))
    pose, nav = PoseEstimate(state.stamp_ns, state.T_map_body, np.eye(6)), NavEstimate(state, np.eye(15))
    made = FrameReport(pose, nav, features, 0, False, None, 0, coasted=coasted, recovery=recovery)
    return FrameOutput(made, nav, None, None, warnings)


def test_frames_that_coast_with_features_are_an_alarm(node, report) -> None:
    for k in range(MANY_COASTED):
        assert "coasted" not in node.alarms
        report(frame(k, coasted=True))
    assert f"{MANY_COASTED} frames of the last 10 s had features" in node.alarms["coasted"]
    report(frame(100))
    assert "coasted" not in node.alarms
    assert (node.counts["frames"], node.counts["frames_coasted"]) == (MANY_COASTED + 1, MANY_COASTED)


def test_a_session_begins_without_the_alarms_of_the_one_before(node) -> None:
    status = BackendStatus(node)
    for k in range(MANY_COASTED):
        status.report(frame(k, coasted=True, recovery="lost", warnings=("look",)))
    assert node.alarms.keys() == {"coasted", "recovery", "warning"}
    node.alarms["checkpoint"] = "the disk is full"
    status.restart()
    assert node.alarms.keys() == {"checkpoint"}  # no matter of a flight
    status.report(frame(MANY_COASTED, coasted=True))
    assert node.alarms.keys() == {"checkpoint"}


def test_frames_that_coast_without_features_are_an_alarm(node, report) -> None:
    for k in range(MANY_BLIND):
        assert "coasted" not in node.alarms
        report(frame(k, features=3, coasted=True))
    assert f"{MANY_BLIND} frames of the last 10 s had fewer than 20 features" in node.alarms["coasted"]


def test_a_recovery_is_an_alarm_with_its_reason_while_it_is_recent(node, report) -> None:
    report(frame(0, recovery="lost"))
    report(frame(RECENT_FRAMES - 1))
    assert node.alarms["recovery"] == "the filter was re-initialised 1x in the last 10 s, the last time: lost"
    report(frame(RECENT_FRAMES))
    assert "recovery" not in node.alarms
    assert node.counts["recoveries"] == 1


def test_a_warning_is_an_alarm_while_it_is_recent_and_stays_in_the_notes(node, report) -> None:
    report(frame(0, warnings=("the first", "the second")))
    report(frame(RECENT_FRAMES - 1))
    assert node.alarms["warning"] == "the second"
    report(frame(RECENT_FRAMES))
    assert "warning" not in node.alarms
    assert node.notes["warning"] == "the second"


def test_the_estimated_calibration_is_in_the_notes(node, report) -> None:
    output, offset, disparity = frame(0), TimeOffset(-0.0155, 0.0002), DisparityEstimate(0.25, 0.01, 0.9)
    report(output)
    assert not node.notes.keys() & {"time_offset", "disparity_error"}
    found = dataclasses.replace(output.report, time_offset=offset, disparity=disparity)
    report(dataclasses.replace(output, report=found))
    assert node.notes["time_offset"] == "-15.50 ± 0.20 ms"
    assert node.notes["disparity_error"] == "+0.250 ± 0.010 px"
