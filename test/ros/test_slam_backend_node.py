# SPDX-License-Identifier: Apache-2.0
"""The back end's node begins a session in flight even where its number can't be stored, and names impossible inputs."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from lone_node import deliver, lone_node  # noqa: E402
from sensor_msgs.msg import CameraInfo  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from uav_vslam.config import ImuConfig  # noqa: E402
from uav_vslam.geometry.pose import Pose  # noqa: E402
from uav_vslam.ins.increments import unknown_motion  # noqa: E402
from uav_vslam.ros.convert import features_to_msg, increment_to_msg, navigation_to_msg, transform_to_msg  # noqa: E402
from uav_vslam.ros.slam_backend_node import SlamBackendNode  # noqa: E402
from uav_vslam.slam.frame_output import FrameOutput  # noqa: E402
from uav_vslam.slam.frame_queue import MAX_WAITING  # noqa: E402
from uav_vslam.slam.frame_report import FrameReport  # noqa: E402
from uav_vslam.slam.stage import SlamStage  # noqa: E402
from uav_vslam.types import NS_PER_S, NavEstimate, NavState, StereoFeatures  # noqa: E402

pytestmark = pytest.mark.ros

SESSION = 5
FRAME_NS = NS_PER_S // 5


@pytest.fixture
def node(domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SlamBackendNode]:
    """A back end with a session number of its own, and no place to store others."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with lone_node(SlamBackendNode, domain_id) as made:
        yield made(f"session:={SESSION}")


def fly(node: SlamBackendNode, start_ns: int, frames: int) -> None:
    """Deliver frames without features, and the unknown motion to each."""
    still = {"gyro_bias": np.zeros(3), "accel_bias": np.zeros(3), "imu": ImuConfig()}
    for stamp_ns in range(start_ns, start_ns + frames * FRAME_NS, FRAME_NS):
        increment = unknown_motion(stamp_ns - FRAME_NS, stamp_ns, **still)
        deliver(node, "ins/increment", increment_to_msg(increment, frame_id=node.base_frame))
        features = features_to_msg(StereoFeatures.empty(stamp_ns), frame_id="left_optical", size=(64, 48))
        deliver(node, "stereo_features", features)


def lost_frame(stamp_ns: int) -> FrameOutput:
    """Return what a frame brings at which the filter was re-initialised."""
    state = NavState(stamp_ns, Pose.identity(), np.zeros(3), np.zeros(3), np.zeros(3))
    nav = NavEstimate(state, np.eye(15))
    return FrameOutput(FrameReport(nav.pose, nav, 50, 0, False, None, 0, recovery="lost"), nav, None, None)


def test_a_clock_that_is_set_back_begins_a_session_that_can_not_be_stored(node: SlamBackendNode) -> None:
    fly(node, 1000 * NS_PER_S, 20)
    fly(node, 500 * NS_PER_S, 100)
    assert node._stage.session == SESSION + 1
    assert "may be used again" in node.alarms["session"]
    assert node.counts["dropped/refused"] == 0


def test_a_reset_begins_a_session_that_can_not_be_stored(node: SlamBackendNode) -> None:
    response = node._on_reset(Trigger.Request(), Trigger.Response())
    assert response.success, response.message
    assert node._stage.session == SESSION + 1
    assert node.alarms["start"].startswith("no estimate before a new initial_state")


def test_a_back_end_that_dies_after_a_reset_does_not_resume_the_flight_before(
    domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with lone_node(SlamBackendNode, domain_id) as made:
        reset = made()
        reset._save(1000 * NS_PER_S)
        reset.reset()
    with lone_node(SlamBackendNode, domain_id) as made:
        resumed = made("resume:=true")
        assert resumed._stage.session == reset._stage.session
        assert resumed._stage.initial is None


def test_a_reset_vehicle_that_waits_for_its_start_has_no_alarms_of_its_last_flight(node: SlamBackendNode) -> None:
    node._status.report(lost_frame(1000 * NS_PER_S))
    assert "re-initialised 1x" in node.alarms["recovery"]
    node.reset()
    assert node.alarms.keys() == {"session", "start", "checkpoint"}  # the fixture's folder can't be written


@pytest.mark.parametrize(
    ("reason", "subject", "text"),
    [
        ("unpaired", "unpaired", "most frames are dropped"),
        ("imu_fault", "imu", "the IMU measures (0.0, 0.0, -9.8) m/s^2"),
    ],
)
def test_inputs_that_can_not_be_right_are_failures(
    node: SlamBackendNode, monkeypatch: pytest.MonkeyPatch, reason: str, subject: str, text: str
) -> None:
    monkeypatch.setattr(SlamStage, reason, text)
    fly(node, 1000 * NS_PER_S, 1)
    assert node.failures[subject].startswith(text)
    monkeypatch.setattr(SlamStage, reason, "")
    fly(node, 1001 * NS_PER_S, 1)
    assert subject not in node.failures


def test_no_frame_uses_a_start_state_of_another_frame_than_the_body(node: SlamBackendNode) -> None:
    """Nor does the INS, which names it: it would go on from the estimate of a frame at the start's stamp."""
    begin_ns = 1000 * NS_PER_S
    cameras = {"left": Pose.identity(), "right": Pose(np.eye(3), np.array([1.0, 0.0, 0.0]))}
    for side in cameras:
        info = CameraInfo(width=64, height=48, k=[50.0, 0.0, 32.0, 0.0, 50.0, 24.0, 0.0, 0.0, 1.0])
        info.header.frame_id = f"uav1/{side}_optical"
        deliver(node, f"{side}/camera_info", info)
    edges = [
        transform_to_msg(place, stamp_ns=0, parent="uav1/base_link", child=f"uav1/{side}_optical")
        for side, place in cameras.items()
    ]
    deliver(node, "/tf_static", TFMessage(transforms=edges))
    start = NavEstimate(NavState(begin_ns, Pose.identity(), np.zeros(3), np.zeros(3), np.zeros(3)), np.eye(15))
    given = navigation_to_msg(start, frame_id="uav1/map", child_frame_id="uav1/right_optical")
    deliver(node, "initial_state", given)
    fly(node, begin_ns, 1)
    assert node._stage.nav is None
    assert "uav1/right_optical, which /tf_static places elsewhere than the body" in node.alarms["start_frame"]
    given.child_frame_id = node.base_frame
    deliver(node, "initial_state", given)
    assert node._stage.nav is not None
    assert "start_frame" not in node.alarms
    given.child_frame_id = "uav1/right_optical"
    deliver(node, "initial_state", given)  # of another flight: the present one goes on
    assert "start_frame" not in node.alarms


def test_features_before_the_calibration_are_a_warning_that_says_what_is_missing(node: SlamBackendNode) -> None:
    fly(node, 1000 * NS_PER_S, MAX_WAITING + 1)
    assert node.counts["dropped/before_rig"] > 0
    said = "features arrive, but there is no valid camera_info of the left and the right camera"
    assert node.alarms["calibration"] == said
