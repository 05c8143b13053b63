# SPDX-License-Identifier: Apache-2.0
"""Increments start at a start state near the IMU samples, given or estimated at rest."""

import itertools
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from geometry_msgs.msg import TransformStamped, Vector3  # noqa: E402
from lone_node import deliver, lone_node  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from node_processes import Witness, running  # noqa: E402
from sensor_msgs.msg import CameraInfo, Imu  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from uav_vslam.geometry.pose import Pose  # noqa: E402
from uav_vslam.ins.startup_buffer import MAX_APART_S  # noqa: E402
from uav_vslam.ros import calibration  # noqa: E402
from uav_vslam.ros.batches import Batches, take_waiting  # noqa: E402
from uav_vslam.ros.convert import header, navigation_to_msg, transform_to_msg  # noqa: E402
from uav_vslam.ros.fleet_commands import NodeSpec  # noqa: E402
from uav_vslam.ros.ins_propagator_node import InsPropagatorNode  # noqa: E402
from uav_vslam.ros.qos import LATCHED, LATCHED_BY_MANY, SENSOR, STAMPS, STATE  # noqa: E402
from uav_vslam.types import NS_PER_S, NavEstimate, NavState  # noqa: E402
from uav_vslam_msgs.msg import NavigationState  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros
NOW_NS = 1_700_000_000 * NS_PER_S
STEP_NS = 5_000_000
Make = Callable[..., InsPropagatorNode]


@pytest.fixture
def make(domain_id: int) -> Iterator[Make]:
    """Return a factory of a node with parameters."""
    with lone_node(InsPropagatorNode, domain_id) as made:
        yield made


def rest(node: InsPropagatorNode, start_ns: int, seconds: float, *, turn: float = 0.0) -> None:
    """Feed IMU samples at rest, or that turn to and fro [rad/s], and an image at every seventh of them."""
    for k in range(round(seconds * NS_PER_S) // STEP_NS + 1):
        stamp_ns = start_ns + k * STEP_NS
        reading = Imu(header=header(stamp_ns, node.base_frame), linear_acceleration=Vector3(z=node.config.imu.gravity))
        reading.angular_velocity.x = turn * (-1) ** k
        deliver(node, "imu/data_raw", reading)
        if k % 7 == 6:
            deliver(node, "left/camera_info", CameraInfo(header=header(stamp_ns - 1_000_000, "left_optical")))


def start_at(stamp_ns: int) -> NavigationState:
    state = NavState(stamp_ns, Pose.identity(), np.zeros(3), np.zeros(3), np.zeros(3))
    return navigation_to_msg(NavEstimate(state, np.eye(15)), frame_id="uav1/map", child_frame_id="uav1/base_link")


@pytest.mark.parametrize("first", ["start", "readings"])
def test_a_start_without_a_stamp_is_refused_and_the_next_one_used(
    make: Make, first: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make()
    monkeypatch.setattr(node._startup, "lasts", lambda: False)
    if first == "start":
        deliver(node, "initial_state", start_at(0))
        rest(node, NOW_NS, 0.1)
    else:
        rest(node, NOW_NS, 0.1)
        deliver(node, "initial_state", start_at(0))
    assert node.counts["dropped/start_stamp"] == 1
    assert node.counts["increments"] == 0
    level, text = node._health()
    assert level == DiagnosticStatus.WARN
    assert text.startswith("no start: initial_state is stamped 0 ns")  # before what waits for it
    assert "; waiting for " in text
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS + 105_000_000, 1.0)
    assert node.counts["increments"] > 25
    assert node.counts["imu_gaps"] == 0
    assert node.counts["dropped/start_stamp"] == 1
    assert "start" not in node.alarms


def test_a_single_reading_that_is_no_motion_is_left_out_and_counted(make: Make) -> None:
    node = make()
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 0.5)
    wild = Imu(header=header(NOW_NS + 505_000_000, node.base_frame), linear_acceleration=Vector3(z=500.0))
    deliver(node, "imu/data_raw", wild)
    rest(node, NOW_NS + 510_000_000, 0.5)
    assert node.counts["dropped/imu_outlier"] == 1
    assert node._live is not None
    assert np.linalg.norm(node._live.estimate.state.v_map) < 1e-3


def test_a_start_long_after_the_first_imu_samples_is_waited_for(make: Make) -> None:
    node, wait_s = make(), MAX_APART_S + 1.0
    deliver(node, "initial_state", start_at(NOW_NS + round(wait_s * NS_PER_S)))
    rest(node, NOW_NS, 0.1)
    assert node.notes["start"].startswith("given +30.9")
    assert node.alarms["start_ahead"] == "no start yet: initial_state is stamped 30.9 s after the newest IMU sample"
    assert node._live is None
    rest(node, NOW_NS + 105_000_000, wait_s)
    assert node._live is not None
    assert not node.alarms
    assert node.counts["increments"] == 3  # to the images in the last 0.1 s


@pytest.mark.parametrize("rest_s", [0.5, 12.0])
def test_rest_is_averaged_over_the_configured_time(make: Make, rest_s: float) -> None:
    """Longer than the capacity of the buffer at 200 Hz."""
    node = make("start.method:=static", f"start.rest_s:={rest_s}")
    rest(node, NOW_NS, rest_s - 0.01)
    assert node._live is None
    rest(node, NOW_NS + round((rest_s - 0.005) * NS_PER_S), 0.2)
    assert node._live is not None
    assert node._preintegrator.start_ns == NOW_NS + round(rest_s * NS_PER_S)
    assert node.counts["increments"] > 3


def test_the_status_says_why_a_vehicle_that_moves_has_no_static_start(make: Make) -> None:
    """Diagnostics and monitor had only that the node waits for the back end."""
    node = make("start.method:=static")
    rest(node, NOW_NS, 1.5, turn=0.2)
    assert node.alarms["start"].startswith("no start: the vehicle moves (gyro 0.200 rad/s")
    rest(node, NOW_NS + round(1.505 * NS_PER_S), 1.5)
    assert node._live is not None
    assert not node.alarms


def test_a_static_start_waits_for_the_cameras(make: Make) -> None:
    node, first_ns = make("start.method:=static"), NOW_NS + 60 * NS_PER_S
    for k in range(60 * NS_PER_S // STEP_NS):
        force = Vector3(z=node.config.imu.gravity)
        reading = Imu(header=header(NOW_NS + k * STEP_NS, node.base_frame), linear_acceleration=force)
        deliver(node, "imu/data_raw", reading)
    assert node._live is None
    rest(node, first_ns, 0.2)
    assert abs(node._preintegrator.start_ns - first_ns) < 0.1 * NS_PER_S


@pytest.mark.parametrize("method", ["given", "static"])
def test_one_sample_from_the_future_costs_one_sample(make: Make, method: str) -> None:
    node = make(f"start.method:={method}", "start.rest_s:=0.5", "odometry_rate_hz:=0.0")
    if method == "given":
        deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 0.2)
    rest(node, NOW_NS + 3600 * NS_PER_S, 0.0)
    rest(node, NOW_NS + 205_000_000, 1.0)
    assert node.counts["dropped/stamp_jump"] == 1
    assert node.counts["dropped/stamp"] == 0
    assert node._live is not None
    assert node._live.estimate.state.stamp_ns == NOW_NS + 1_205_000_000
    assert node.counts["imu_gaps"] == 0


def test_readings_stamped_when_a_batch_of_them_arrives_are_an_alarm(make: Make) -> None:
    """As a USB driver stamps them: their motion counts up to 0.1 s late."""
    node = make()
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 1.0)
    assert "imu_stamps" not in node.alarms
    for k in range(400):
        stamp_ns = NOW_NS + (11 + k // 20) * 100_000_000 + k % 20 * 50_000
        reading = Imu(header=header(stamp_ns, node.base_frame), linear_acceleration=Vector3(z=node.config.imu.gravity))
        deliver(node, "imu/data_raw", reading)
        if k % 20 == 0:
            deliver(node, "left/camera_info", CameraInfo(header=header(stamp_ns - 1_000_000, "left_optical")))
    assert "stamped in bursts, 20000 Hz" in node.alarms["imu_stamps"]
    assert "imu" not in node.alarms  # nothing is missing between bursts
    node.reset()
    assert "imu_stamps" not in node.alarms


def test_readings_that_come_too_seldom_are_an_alarm(make: Make) -> None:
    node = make()
    deliver(node, "initial_state", start_at(NOW_NS))
    for k in range(120):
        stamp_ns = NOW_NS + k * 100_000_000
        reading = Imu(header=header(stamp_ns, node.base_frame), linear_acceleration=Vector3(z=node.config.imu.gravity))
        deliver(node, "imu/data_raw", reading)
        deliver(node, "left/camera_info", CameraInfo(header=header(stamp_ns - 1_000_000, "left_optical")))
    assert "IMU readings come at 10 Hz" in node.alarms["imu_stamps"]


def test_readings_in_a_frame_of_their_own_wait_for_its_transform_but_not_for_ever(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibration, "MAX_WAITING", 5)
    node = make("odometry_rate_hz:=0.0")
    deliver(node, "initial_state", start_at(NOW_NS))
    upside_down = Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    gravity = node.config.imu.gravity

    def feed(first: int, last: int) -> None:
        for k in range(first, last):
            stamp_ns = NOW_NS + k * STEP_NS
            reading = Imu(header=header(stamp_ns, "imu_link"), linear_acceleration=Vector3(z=-gravity))
            deliver(node, "imu/data_raw", reading)

    feed(0, 5)
    assert node.notes["transform"] == "/tf_static has no uav1/base_link -> imu_link"
    assert node.counts["dropped/imu_frame"] == 0
    feed(5, 8)
    assert node.counts["dropped/imu_frame"] == 3
    assert "imu_link" in node.failures["transform"]
    edge = transform_to_msg(upside_down, stamp_ns=0, parent="uav1/base_link", child="imu_link")
    deliver(node, "/tf_static", TFMessage(transforms=[edge]))
    assert node._live is not None
    assert node._live.estimate.state.stamp_ns == NOW_NS + 7 * STEP_NS  # those that waited are used
    feed(8, 100)
    assert node.counts["dropped/imu_frame"] == 3
    assert "transform" not in node.notes | node.failures
    np.testing.assert_allclose(
        node._live.estimate.state.T_map_body.t, np.zeros(3), atol=1e-9
    )  # it hovers, and knows it


def test_a_place_of_the_imu_that_is_missing_is_a_failure_long_before_readings_are_dropped(make: Make) -> None:
    node = make("odometry_rate_hz:=0.0")
    deliver(node, "initial_state", start_at(NOW_NS))
    for k in range(4):
        assert not node.failures
        deliver(node, "imu/data_raw", Imu(header=header(NOW_NS + k * NS_PER_S, "imu_link")))
    assert "no uav1/base_link -> imu_link, the IMU's frame; publish it" in node.failures["transform"]
    assert node.counts["dropped/imu_frame"] == 0
    edge = transform_to_msg(Pose.identity(), stamp_ns=0, parent="uav1/base_link", child="imu_link")
    deliver(node, "/tf_static", TFMessage(transforms=[edge]))
    assert not node.failures


def test_a_place_of_the_imu_that_changes_in_flight_is_named_and_used_after_a_reset(make: Make) -> None:
    node = make("odometry_rate_hz:=0.0")

    def place(pose: Pose) -> None:
        edge = transform_to_msg(pose, stamp_ns=0, parent="uav1/base_link", child="imu_link")
        deliver(node, "/tf_static", TFMessage(transforms=[edge]))

    def hover(start_ns: int, gravity: float) -> None:
        deliver(node, "initial_state", start_at(start_ns))
        for k in range(100):
            reading = Imu(header=header(start_ns + k * STEP_NS, "imu_link"), linear_acceleration=Vector3(z=gravity))
            deliver(node, "imu/data_raw", reading)
        assert node._live is not None
        assert np.linalg.norm(node._live.estimate.state.v_map) < 1e-9

    upright, upside_down = Pose.identity(), Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.1]))
    place(upright)
    hover(NOW_NS, node.config.imu.gravity)
    for pose, failing in ((upright, False), (upside_down, True), (upright, False), (upside_down, True)):
        place(pose)
        assert ("calibration" in node.failures) == failing
    assert "moved by 0.100 m, turned by 180.00 deg" in node.failures["calibration"]
    node.reset()
    assert "calibration" not in node.failures
    hover(NOW_NS + 10 * NS_PER_S, -node.config.imu.gravity)


@pytest.mark.parametrize("away_s", [0, 6])
@pytest.mark.parametrize("take_off_first", [True, False])
def test_a_node_restarted_in_flight_starts_at_the_correction(make: Make, take_off_first: bool, away_s: int) -> None:
    """The latched start state is the take-off's, and comes before or after the back end's correction.

    Without increments the back end makes no newer correction, however long the node was away.
    """
    node = make()
    messages = [("initial_state", start_at(NOW_NS - 60 * NS_PER_S)), ("slam/correction", start_at(NOW_NS))]
    for topic, message in messages if take_off_first else reversed(messages):
        deliver(node, topic, message)
    rest(node, NOW_NS + away_s * NS_PER_S, 0.1)
    assert node.counts["increments"] > 0
    assert node._live is not None
    sigma_m = np.sqrt(node._live.estimate.covariance[0, 0])
    assert (sigma_m > 10.0) == (away_s > 0)  # the motion meanwhile is unknown
    assert node._preintegrator is not None
    first_ns = node._preintegrator.start_ns
    assert first_ns is not None
    assert (first_ns - NOW_NS) // NS_PER_S == away_s  # what nothing was measured of is left to the images


def test_image_stamps_that_do_not_go_on_are_told_while_they_do_not(make: Make) -> None:
    node = make()
    deliver(node, "initial_state", start_at(NOW_NS))
    deliver(node, "left/camera_info", CameraInfo(header=header(NOW_NS, "left_optical")))  # once, latched
    for k in range(500):
        stamp = header(NOW_NS + k * STEP_NS, node.base_frame)
        deliver(node, "imu/data_raw", Imu(header=stamp, linear_acceleration=Vector3(z=node.config.imu.gravity)))
    assert "left/camera_info has brought no new stamp for 2 s" in node.alarms["images"]
    assert node.alarms["images"].endswith("a file with the calibration can replace it (input.calibration)")
    rest(node, NOW_NS + 500 * STEP_NS, 0.5)
    assert "images" not in node.alarms


def test_a_single_reading_stamped_ahead_blames_neither_images_nor_back_end(make: Make) -> None:
    node = make()
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 1.0)
    deliver(node, "imu/data_raw", Imu(header=header(NOW_NS + 100 * NS_PER_S, node.base_frame)))
    deliver(node, "slam/correction", start_at(NOW_NS + NS_PER_S))
    assert not node.alarms


@pytest.mark.parametrize(("apart_s", "said"), [(3, "3.0 s ahead of"), (-3, "3.0 s behind"), (1, ""), (-1, "")])
def test_clocks_of_images_and_imu_that_are_seconds_apart_are_told(make: Make, apart_s: int, said: str) -> None:
    node = make()
    for k in range(800):
        stamp_ns = NOW_NS + k * STEP_NS
        if k % 28 == 0:  # the first one before any reading
            deliver(node, "left/camera_info", CameraInfo(header=header(stamp_ns + apart_s * NS_PER_S, "left_optical")))
        deliver(node, "imu/data_raw", Imu(header=header(stamp_ns, node.base_frame)))
        assert "images" not in node.alarms  # they bring new stamps
    assert said in node.alarms.get("clocks", "")
    assert bool(said) == ("clocks" in node.alarms)
    rest(node, NOW_NS + 800 * STEP_NS, 0.5)
    assert "clocks" not in node.alarms


def test_an_input_that_never_comes_does_not_hide_one_that_has_stopped(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make()
    monkeypatch.setattr(node._startup, "lasts", lambda: False)
    (imu,) = (one for one in node._inputs if one.topic == "imu/data_raw")
    now_s = time.monotonic()
    imu.received, imu.first_s, imu.last_s = 1000, now_s - 20.0, now_s - 10.2
    level, text = node._health()
    assert level == DiagnosticStatus.WARN
    assert "waiting for initial_state" in text
    assert text.endswith("; no more messages from imu/data_raw for 10 s")
    node.report_failure("clock", "do their clocks agree?")
    assert node._health() == (
        DiagnosticStatus.ERROR,
        "do their clocks agree?; no more messages from imu/data_raw for 10 s",
    )


def test_images_that_go_on_while_the_imu_is_silent_do_not_blame_the_clocks(make: Make) -> None:
    node = make()
    rest(node, NOW_NS, 1.0)
    for k in range(40):
        deliver(node, "left/camera_info", CameraInfo(header=header(NOW_NS + (7 + k) * NS_PER_S // 7, "left_optical")))
        assert "clocks" not in node.alarms
    rest(node, NOW_NS + 47 * NS_PER_S // 7, 1.0)
    assert not {"clocks", "images"} & node.alarms.keys()


@pytest.mark.parametrize("method", ["given", "in_flight"])
def test_a_node_that_is_reset_alone_goes_on_from_the_next_correction(make: Make, method: str) -> None:
    node = make(f"start.method:={method}")
    rest(node, NOW_NS, 1.0)
    deliver(node, "initial_state", start_at(NOW_NS + NS_PER_S))
    rest(node, NOW_NS + NS_PER_S + STEP_NS, 1.0)
    assert node._live is not None
    node.reset()
    rest(node, NOW_NS + 3 * NS_PER_S, 1.0)
    assert node._live is None
    deliver(node, "slam/correction", start_at(NOW_NS + 4 * NS_PER_S))
    before = node.counts["increments"]
    rest(node, NOW_NS + 4 * NS_PER_S + STEP_NS, 1.0)
    assert node._live.estimate.state.stamp_ns > NOW_NS + 4.9 * NS_PER_S
    assert node.counts["increments"] > before + 20


def test_a_node_that_is_reset_alone_goes_on_though_the_back_end_waits_for_its_increments(make: Make) -> None:
    node = make()
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 1.0)
    deliver(node, "slam/correction", start_at(NOW_NS + NS_PER_S))
    rest(node, NOW_NS + NS_PER_S, 0.1)
    node.reset()
    before = node.counts["increments"]
    rest(node, NOW_NS + NS_PER_S + 100_000_000, 1.0)
    assert node._live is not None
    assert node._live.estimate.state.stamp_ns > NOW_NS + 2 * NS_PER_S
    assert node.counts["increments"] > before + 20


def test_after_a_reset_a_start_state_counts_more_than_what_was_estimated_before(make: Make) -> None:
    node = make()
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 1.0)
    deliver(node, "slam/correction", start_at(NOW_NS + NS_PER_S))
    node.reset()
    rest(node, NOW_NS + NS_PER_S, 1.0)
    elsewhere = start_at(NOW_NS + 2 * NS_PER_S)
    elsewhere.pose.position.x = 1000.0
    deliver(node, "initial_state", elsewhere)
    rest(node, NOW_NS + 2 * NS_PER_S, 1.0)
    assert node._live is not None
    assert node._live.estimate.pose.T_map_body.t[0] == pytest.approx(1000.0, abs=1.0)


@pytest.mark.parametrize("back_s", [20, 100])
def test_a_correction_of_before_a_clock_was_set_back_that_comes_late_is_no_start(make: Make, back_s: int) -> None:
    node, again_ns = make("input.on_time_jump:=reset"), NOW_NS - back_s * NS_PER_S
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 2.0)
    rest(node, again_ns, 2.0)
    deliver(node, "slam/correction", start_at(NOW_NS + NS_PER_S))
    assert node._live is None
    deliver(node, "initial_state", start_at(again_ns + 2 * NS_PER_S))
    before = node.counts["increments"]
    rest(node, again_ns + 2 * NS_PER_S + STEP_NS, 1.0)
    assert node.counts["increments"] > before + 20
    deliver(node, "slam/correction", start_at(again_ns + 2 * NS_PER_S + NS_PER_S // 2))
    assert node._correction is not None


def test_an_invalid_start_state_in_flight_is_refused_and_a_jump_goes_on_without_it(make: Make) -> None:
    node = make()
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 2.0)
    invalid = start_at(NOW_NS - 60 * NS_PER_S)
    invalid.covariance[0] = float("nan")
    deliver(node, "initial_state", invalid)
    assert node.counts["dropped/not_finite"] == 1
    rest(node, NOW_NS - 60 * NS_PER_S, 2.0)
    assert node.counts["time_jumps"] == node.counts["dropped/not_finite"] == 1
    assert node._live is not None
    assert node._live.estimate.state.stamp_ns < NOW_NS


def test_corrections_that_come_late_are_told_until_they_are_in_time(make: Make) -> None:
    node = make()
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 4.0)
    for lag_s, late in ((3.5, True), (2.5, True), (0.2, False)):
        deliver(node, "slam/correction", start_at(NOW_NS + round((4.0 - lag_s) * NS_PER_S)))
        assert ("lag" in node.alarms) == late
        assert not late or f"{lag_s:.1f} s behind the readings" in node.alarms["lag"]


def test_a_reset_ends_the_alarms_of_the_flight_before(make: Make) -> None:
    node = make()
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 1.0)
    rest(node, NOW_NS + 2 * NS_PER_S, 3.0)
    deliver(node, "slam/correction", start_at(NOW_NS + NS_PER_S))
    assert {"imu", "lag"} <= node.alarms.keys()
    node.reset()
    assert node.alarms == {}
    rest(node, NOW_NS + 6 * NS_PER_S, 1.0)
    assert "lag" not in node.alarms


def test_a_correction_steps_from_map_to_odom_and_the_odometry_has_a_rate_and_covariances(make: Make) -> None:
    node = make("odometry_rate_hz:=50.0")
    edges: list[TransformStamped] = []
    odometry: list[Odometry] = []
    other = rclpy.create_node("other", use_global_arguments=False)
    other.create_subscription(TFMessage, "/tf", lambda message: edges.extend(message.transforms), STATE)
    other.create_subscription(Odometry, "/uav1/ins/odometry", odometry.append, STATE)

    def spin(until: Callable[[], object]) -> bool:
        return wait_for(until, lambda: rclpy.spin_once(other, timeout_sec=0.02))

    outputs = node._outputs
    try:
        assert spin(lambda: outputs._tf.get_subscription_count() and outputs._odometry.get_subscription_count())
        deliver(node, "initial_state", start_at(NOW_NS))
        rest(node, NOW_NS, 0.2)
        assert spin(lambda: len(edges) == 20 and len(odometry) == 10)
        moved = start_at(NOW_NS + 200_000_000)
        moved.pose.position.x = 5.0
        deliver(node, "slam/correction", moved)
        rest(node, NOW_NS + 205_000_000, 0.1)
        assert spin(lambda: len(edges) == 30 and len(odometry) == 15)
    finally:
        other.destroy_node()
    poses = {
        child: [edge.transform.translation.x for edge in edges if edge.child_frame_id == child]
        for child in ("uav1/odom", "uav1/base_link")
    }
    assert {edge.header.frame_id for edge in edges} == {"uav1/map", "uav1/odom"}
    np.testing.assert_allclose(poses["uav1/base_link"], 0.0, atol=1e-9)
    np.testing.assert_allclose(poses["uav1/odom"], [0.0] * 10 + [5.0] * 5, atol=1e-9)
    stamps = np.array([message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec for message in odometry])
    np.testing.assert_array_equal(np.diff(stamps), 20_000_000)
    assert all(np.linalg.eigvalsh(message.twist.covariance.reshape(6, 6))[0] > 0 for message in odometry)
    sigmas_m = [np.sqrt(message.pose.covariance[0]) for message in odometry]
    assert np.all(np.diff(sigmas_m[:10]) > 0)  # propagated to the stamp, not that of the last correction


def test_a_node_that_is_behind_catches_up_in_one_turn(make: Make) -> None:
    """Image stamps and readings that wait are taken together, and the transforms of all that time are one message."""
    node, transforms = make("odometry_rate_hz:=50.0"), []
    deliver(node, "initial_state", start_at(NOW_NS))
    rest(node, NOW_NS, 0.05)
    listening = node.create_subscription(
        TFMessage, "/tf", lambda m, _: transforms.append(m), STATE, callback_group=Batches(at_once=False)
    )
    readings = node.create_publisher(Imu, "imu/data_raw", SENSOR)
    images = node.create_publisher(CameraInfo, "left/camera_info", STAMPS)
    assert wait_for(lambda: all(p.get_subscription_count() for p in (readings, images, node._outputs._tf)))
    gravity, before = Vector3(z=node.config.imu.gravity), node.counts["increments"]
    for k in range(11, 91):
        stamp_ns = NOW_NS + k * STEP_NS
        if k % 4 == 0:
            images.publish(CameraInfo(header=header(stamp_ns, "left_optical")))
        readings.publish(Imu(header=header(stamp_ns, node.base_frame), linear_acceleration=gravity))
    time.sleep(0.3)  # in the node's queues
    assert wait_for(lambda: node.counts["increments"] - before == 20, node._take_waiting)  # nothing else turns
    assert wait_for(lambda: sum(len(m.transforms) for m in transforms) >= 2 * 18, lambda: take_waiting(listening))
    assert len(transforms) <= 5
    assert node.counts["imu_gaps"] == 0


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        ("uav2/base_link", "initial_state is of uav2/base_link, which /tf_static does not connect with the body"),
        ("uav1/left_optical", "initial_state is of uav1/left_optical, which /tf_static places elsewhere than the body"),
        ("", ""),
    ],
)
def test_a_start_state_of_another_frame_than_the_body_is_told(
    domain_id: int, tmp_path: Path, frame: str, said: str
) -> None:
    """The readings come first, in the body's frame, so that nothing else asks for /tf_static."""
    spec, log = NodeSpec("ins_propagator", "/uav1", {}), tmp_path / "ins_propagator.log"
    with Witness(domain_id) as witness, running([spec], tmp_path, domain_id):
        create = witness.node.create_publisher
        readings, images = (
            create(Imu, "/uav1/imu/data_raw", SENSOR),
            create(CameraInfo, "/uav1/left/camera_info", STAMPS),
        )
        starts = create(NavigationState, "/uav1/initial_state", LATCHED)
        transforms = create(TFMessage, "/tf_static", LATCHED_BY_MANY)
        publishers = (readings, images, starts, transforms)
        assert witness.sees(lambda: all(one.get_subscription_count() for one in publishers))
        turns = itertools.count()

        def fly() -> None:
            stamp_ns = NOW_NS + next(turns) * STEP_NS
            readings.publish(Imu(header=header(stamp_ns, "uav1/base_link"), linear_acceleration=Vector3(z=9.81)))
            images.publish(CameraInfo(header=header(stamp_ns, "left_optical")))

        def rest_a_while() -> None:
            for _ in range(2):  # what was sent before the first of both has been handled
                witness.statuses.clear()
                assert witness.sees(lambda: witness.text("uav1: ins_propagator"), fly)

        rest_a_while()
        camera = Pose(np.eye(3), np.array([0.1, 0.0, 0.0]))
        edge = transform_to_msg(camera, stamp_ns=0, parent="uav1/base_link", child="uav1/left_optical")
        transforms.publish(TFMessage(transforms=[edge]))
        rest_a_while()
        start = start_at(NOW_NS + next(turns) * STEP_NS)
        start.child_frame_id = frame
        starts.publish(start)
        if said:
            assert witness.sees(lambda: said in log.read_text(), fly), log.read_text()
        refused = "elsewhere" in said
        if not refused:
            assert witness.sees(lambda: int(witness.value("uav1: ins_propagator", "increments") or 0) > 5, fly)
        assert ("initial_state" in log.read_text()) == bool(said)
