# SPDX-License-Identifier: Apache-2.0
"""Round trips between records and messages, and the reasons for which messages are rejected."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from geometry_msgs.msg import TwistWithCovariance, Vector3
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from same_records import assert_same
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu

from uav_vslam.config import InputConfig
from uav_vslam.datasets.sensor_setup import SensorSetup
from uav_vslam.errors import CalibrationError, InvalidMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ros import convert
from uav_vslam.ros.odometry_data import OdometryData
from uav_vslam.types import (
    ImuIncrement,
    JointInformation,
    NavEstimate,
    NavState,
    PoseEstimate,
    StereoFeatures,
    Twist,
)

STAMP_NS = 1_283_212_800_123_456_789
NAN, INFINITY = float("nan"), float("inf")


def covariance(n: int, seed: int = 0) -> np.ndarray:
    A = np.random.default_rng(seed).normal(size=(n, n))
    return A @ A.T + n * np.eye(n)


def pose() -> Pose:
    return Pose(so3_exp(np.array([0.3, -1.2, 2.1])), np.array([1.5, -2.25, 70.1]))


def features(count: int = 5) -> StereoFeatures:
    rng = np.random.default_rng(1)
    pixels = rng.uniform(0, 1000, (count, 4)).astype(np.float32)
    tracks = np.arange(7, 7 + count, dtype=np.uint32)
    return StereoFeatures(STAMP_NS, pixels, rng.integers(0, 256, (count, 128), np.uint8), tracks)


def increment() -> ImuIncrement:
    rng = np.random.default_rng(2)
    return ImuIncrement(
        start_ns=STAMP_NS - 140_000_000,
        stamp_ns=STAMP_NS,
        samples=29,
        delta_R=so3_exp(np.array([0.01, 0.02, -0.03])),
        delta_v=rng.normal(size=3),
        delta_p=rng.normal(size=3),
        rate_start=rng.normal(size=3),
        rate_end=rng.normal(size=3),
        rate_slope_start=rng.normal(size=3),
        rate_slope_end=rng.normal(size=3),
        gyro_bias=rng.normal(size=3),
        accel_bias=rng.normal(size=3),
        bias_jacobian=rng.normal(size=(9, 6)),
        covariance=covariance(9),
        gyro_noise=2e-4,
        accel_noise=3e-3,
    )


def odometry() -> Odometry:
    estimate = PoseEstimate(STAMP_NS, pose(), covariance(6))
    return convert.odometry_to_msg(estimate, TwistWithCovariance(), frame_id="m", child_frame_id="b")


def navigation() -> NavEstimate:
    rng = np.random.default_rng(3)
    state = NavState(STAMP_NS, pose(), rng.normal(size=3), rng.normal(size=3), rng.normal(size=3))
    return NavEstimate(state, covariance(15))


@pytest.fixture(params=[0, 4])
def joint(request: pytest.FixtureRequest, make_joint: Callable[..., JointInformation]) -> JointInformation:
    """A belief with and without landmarks."""
    points = np.random.default_rng(4).normal(size=(request.param, 3))
    return make_joint(points, covariance(6 + 3 * request.param), stamp_ns=STAMP_NS, T_map_body=pose())


def serialised(message: Any) -> Any:
    """Return the message after serialisation and deserialisation."""
    return deserialize_message(serialize_message(message), type(message))


@pytest.mark.parametrize("count", [0, 5])
def test_features_come_back(count: int) -> None:
    sent = features(count)
    message = serialised(convert.features_to_msg(sent, frame_id="uav1/left_optical", size=(1280, 960)))
    assert (message.header.frame_id, message.width, message.height) == ("uav1/left_optical", 1280, 960)
    assert_same(convert.features_from_msg(message), sent)


def test_an_increment_comes_back() -> None:
    sent = increment()
    assert_same(convert.increment_from_msg(serialised(convert.increment_to_msg(sent, frame_id="b"))), sent)


def test_a_navigation_estimate_comes_back() -> None:
    sent = navigation()
    message = serialised(convert.navigation_to_msg(sent, frame_id="m", child_frame_id="b"))
    assert_same(convert.navigation_from_msg(message), sent)


def test_odometry_comes_back_with_its_twist() -> None:
    sent = PoseEstimate(STAMP_NS, pose(), covariance(6))
    twist = Twist(np.array([20.0, 1.0, -0.5]), np.array([0.1, -0.2, 0.3]), covariance(6))
    message = serialised(convert.odometry_to_msg(sent, convert.twist_to_msg(twist), frame_id="m", child_frame_id="b"))
    assert_same(convert.odometry_from_msg(message), sent)
    got = message.twist
    assert [got.twist.linear.x, got.twist.linear.y, got.twist.linear.z] == [20.0, 1.0, -0.5]
    assert [got.twist.angular.x, got.twist.angular.y, got.twist.angular.z] == [0.1, -0.2, 0.3]
    np.testing.assert_array_equal(got.covariance.reshape(6, 6), twist.covariance)


def test_the_joint_information_comes_back(joint: JointInformation) -> None:
    in_map = dataclasses.replace(joint, prior_id="0123abcd", other_sources=("uav9/1", "uav8/3"))
    for sent in (joint, in_map):
        got = convert.joint_from_msg(serialised(convert.joint_to_msg(sent, frame_id="m")))
        assert_same(got, sent)


def test_stamps_keep_their_nanoseconds() -> None:
    stamp = convert.stamp_from_ns(STAMP_NS)
    assert (stamp.sec, stamp.nanosec) == (1_283_212_800, 123_456_789)


def test_a_cloud_holds_its_points_as_float32() -> None:
    points = np.array([[1.0, 2.0, 3.0], [-4.5, 5.25, 1e-3]])
    cloud = serialised(convert.cloud_to_msg(points, stamp_ns=STAMP_NS, frame_id="m"))
    assert (cloud.width, cloud.row_step, [field.name for field in cloud.fields]) == (2, 24, ["x", "y", "z"])
    np.testing.assert_array_equal(np.frombuffer(cloud.data, np.float32).reshape(-1, 3), points.astype(np.float32))
    assert convert.cloud_to_msg(np.zeros((0, 3)), stamp_ns=0, frame_id="m").width == 0


def test_a_coloured_cloud_has_its_colours_where_viewers_read_them() -> None:
    rng = np.random.default_rng(3)
    points, bgr = rng.normal(size=(5, 3)), rng.integers(0, 256, (5, 3)).astype(np.uint8)
    cloud = serialised(convert.cloud_to_msg(points, bgr=bgr, stamp_ns=STAMP_NS, frame_id="m"))
    assert [(field.name, field.offset) for field in cloud.fields] == [("x", 0), ("y", 4), ("z", 8), ("rgb", 12)]
    rows = np.frombuffer(cloud.data, np.dtype([("xyz", "<f4", 3), ("packed", "<u4")]))
    np.testing.assert_array_equal(rows["xyz"], points.astype(np.float32))
    red, green, blue = ((rows["packed"] >> shift) & 255 for shift in (16, 8, 0))  # 0x00RRGGBB
    np.testing.assert_array_equal(np.stack([blue, green, red], axis=1), bgr)
    assert convert.cloud_to_msg(np.zeros((0, 3)), bgr=bgr[:0], stamp_ns=0, frame_id="m").width == 0


def refusal(read: Callable[[Any], Any], message: Any) -> str:
    """Return the reason why a message is refused."""
    with pytest.raises(InvalidMessage) as refused:
        read(serialised(message))
    return refused.value.reason


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("pixels", [1.0, 2.0, NAN, 4.0] * 5, "not_finite"),
        ("pixels", [1.0, 2.0, INFINITY, 4.0] * 5, "not_finite"),
        ("pixels", [1.0] * 19, "shape"),
        ("pixels", [1.0] * 16, "shape"),
        ("descriptors", bytes(5 * 128 - 1), "shape"),
        ("descriptor_size", 0, "shape"),
        ("descriptor_size", 64, "shape"),
        ("tracks", [1, 2, 3, 4], "shape"),
    ],
)
def test_features_that_are_refused(field: str, value: Any, reason: str) -> None:
    message = convert.features_to_msg(features(), frame_id="c", size=(1280, 960))
    setattr(message, field, value)
    assert refusal(convert.features_from_msg, message) == reason


@pytest.mark.parametrize(
    ("field", "count"),
    [
        ("delta_rotation", 9),
        ("delta_velocity", 3),
        ("rate_start", 3),
        ("rate_end", 3),
        ("rate_slope_start", 3),
        ("rate_slope_end", 3),
        ("delta_position", 3),
        ("gyro_bias", 3),
        ("accel_bias", 3),
        ("bias_jacobian", 54),
        ("covariance", 81),
    ],
)
def test_an_increment_with_nan_is_refused(field: str, count: int) -> None:
    message = convert.increment_to_msg(increment(), frame_id="b")
    setattr(message, field, [0.0] * (count - 1) + [NAN])
    assert refusal(convert.increment_from_msg, message) == "not_finite"


@pytest.mark.parametrize("value", [0.0, -1.0, NAN, float("inf")])
def test_an_increment_without_noise_is_refused(value: float) -> None:
    message = convert.increment_to_msg(increment(), frame_id="b")
    message.gyro_noise = value
    assert refusal(convert.increment_from_msg, message) == "not_positive"


def test_an_increment_without_length_is_refused() -> None:
    message = convert.increment_to_msg(increment(), frame_id="b")
    message.start = message.header.stamp
    assert refusal(convert.increment_from_msg, message) == "stamp"


@pytest.mark.parametrize("field", ["velocity", "gyro_bias", "accel_bias"])
def test_a_navigation_state_with_nan_is_refused(field: str) -> None:
    message = convert.navigation_to_msg(navigation(), frame_id="m", child_frame_id="b")
    setattr(message, field, Vector3(x=NAN))
    assert refusal(convert.navigation_from_msg, message) == "not_finite"


def test_a_navigation_state_at_no_place_is_refused() -> None:
    message = convert.navigation_to_msg(navigation(), frame_id="m", child_frame_id="b")
    message.pose.position.y = NAN
    assert refusal(convert.navigation_from_msg, message) == "not_finite"


@pytest.mark.parametrize("broken", [-np.eye(15), np.zeros((15, 15)), np.diag([1.0] * 14 + [-1e-6])])
def test_a_navigation_state_whose_covariance_is_not_positive_definite_is_refused(broken: np.ndarray) -> None:
    message = convert.navigation_to_msg(navigation(), frame_id="m", child_frame_id="b")
    message.covariance = broken.ravel()
    assert refusal(convert.navigation_from_msg, message) == "covariance"


def test_a_navigation_state_of_whose_covariance_one_triangle_is_filled_in_is_refused() -> None:
    message = convert.navigation_to_msg(navigation(), frame_id="m", child_frame_id="b")
    sigmas = np.logspace(-6, 1, 15)
    whole = np.outer(sigmas, sigmas) * (0.5 + 0.5 * np.eye(15))
    message.covariance = (whole * (1.0 + 1e-9 * np.tri(15))).ravel()  # rounded by its sender
    convert.navigation_from_msg(message)
    for triangle in (np.triu(whole), np.tril(whole)):  # a factorisation reads one of them, and would see no fault
        message.covariance = triangle.ravel()
        assert refusal(convert.navigation_from_msg, message) == "covariance"


@pytest.mark.parametrize("w", [0.0, NAN])
def test_an_invalid_orientation_is_refused(w: float) -> None:
    nav = convert.navigation_to_msg(navigation(), frame_id="m", child_frame_id="b")
    moving = odometry()
    for holder in (nav.pose, moving.pose.pose):
        q = holder.orientation
        q.w, q.x, q.y, q.z = w, 0.0, 0.0, 0.0
    assert refusal(convert.navigation_from_msg, nav) == "orientation"
    assert refusal(convert.odometry_from_msg, moving) == "orientation"


def test_odometry_with_nan_is_refused() -> None:
    message = odometry()
    message.pose.pose.position.z = NAN
    assert refusal(convert.odometry_from_msg, message) == "not_finite"
    message = odometry()
    message.pose.covariance = np.full(36, INFINITY)
    assert refusal(convert.odometry_from_msg, message) == "not_finite"


@pytest.mark.parametrize("joint", [4], indirect=True)
@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("information", [1.0] * 170, "shape"),
        ("information", [1.0] * 170 + [NAN], "not_finite"),
        ("positions", [0.0] * 11, "shape"),
        ("positions", [0.0] * 9, "shape"),
        ("positions", [0.0] * 11 + [NAN], "not_finite"),
        ("descriptors", bytes(3 * 128), "shape"),
        ("descriptor_size", 0, "shape"),
    ],
)
def test_a_joint_information_that_is_refused(joint: JointInformation, field: str, value: Any, reason: str) -> None:
    message = convert.joint_to_msg(joint, frame_id="m")
    setattr(message, field, value)
    assert refusal(convert.joint_from_msg, message) == reason


def reading(**fields: Any) -> bytes:
    message = Imu(angular_velocity=Vector3(x=1.0, y=2.0, z=3.0), linear_acceleration=Vector3(x=4.0, y=5.0, z=6.0))
    message.orientation_covariance[:], message.linear_acceleration_covariance[:] = -1.0, -2.0
    for name, value in fields.items():
        setattr(message, name, value)
    return serialize_message(message)


@pytest.mark.parametrize("frame", ["", "a", "imu", "uav1/imu", "uav1/imu_link", "Ä"])
def test_a_serialised_reading_is_read_whatever_the_length_of_its_frame(frame: str) -> None:
    sample, found = convert.imu_from_data(reading(header=convert.header(STAMP_NS, frame)))
    assert (sample.stamp_ns, found) == (STAMP_NS, frame)
    assert (sample.gyro.tolist(), sample.accel.tolist()) == ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])


@pytest.mark.parametrize("vector", ["angular_velocity", "linear_acceleration"])
@pytest.mark.parametrize(("zero", "marked"), [(True, False), (False, True), (True, True)])
def test_a_vector_that_an_imu_does_not_measure_is_refused(vector: str, zero: bool, marked: bool) -> None:
    """A zero alone may be measured, and some drivers mark what they measure."""
    covariance = np.full(9, -1.0 if marked else 1.0)
    fields = {f"{vector}_covariance": covariance} | ({vector: Vector3()} if zero else {})
    if zero and marked:
        with pytest.raises(InvalidMessage, match=rf"not_finite: {vector} .* not measured \(covariance -1\)"):
            convert.imu_from_data(reading(**fields))
    else:
        assert convert.imu_from_data(reading(**fields))[0].is_finite


def test_a_serialised_reading_of_the_other_byte_order_is_read() -> None:
    ours = reading(header=convert.header(STAMP_NS, "imu"))
    words, frame, numbers = (ours[4:16], np.uint32), ours[16:20], (ours[20:], float)
    turned, swapped = (np.frombuffer(*part).byteswap().tobytes() for part in (words, numbers))
    sample, found = convert.imu_from_data(bytes([0, 1 - ours[1], 0, 0]) + turned + frame + swapped)
    assert (sample.stamp_ns, found) == (STAMP_NS, "imu")
    assert (sample.gyro.tolist(), sample.accel.tolist()) == ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])


@pytest.mark.parametrize("end", range(0, 324, 7))
def test_a_reading_cut_short_is_refused(end: int) -> None:
    with pytest.raises(InvalidMessage) as refused:
        convert.imu_from_data(reading(header=convert.header(STAMP_NS, "uav1/imu"))[:end])
    assert refused.value.reason == "encoding"


@pytest.mark.parametrize("damage", [{1: 7}, {0: 1}, {15: 255}, {16: 255}])
def test_a_reading_of_another_encoding_or_with_a_broken_frame_is_refused(damage: dict[int, int]) -> None:
    data = bytearray(reading(header=convert.header(STAMP_NS, "uav1/imu")))
    for place, value in damage.items():
        data[place] = value
    with pytest.raises(InvalidMessage) as refused:
        convert.imu_from_data(bytes(data))
    assert refused.value.reason == "encoding"


def test_readings_with_nan_are_refused() -> None:
    for fields in ({"angular_velocity": Vector3(y=NAN)}, {"linear_acceleration": Vector3(z=INFINITY)}):
        with pytest.raises(InvalidMessage) as refused:
            convert.imu_from_data(reading(**fields))
        assert refused.value.reason == "not_finite"


@pytest.mark.parametrize("frames", [("map", "base"), ("uav1/map", "uav1/base_link"), ("", "")])
def test_odometry_written_as_data_is_the_serialised_message(frames: tuple[str, str]) -> None:
    write = OdometryData(frame_id=frames[0], child_frame_id=frames[1])
    for seed in range(2):
        estimate = PoseEstimate(STAMP_NS + seed, pose(), covariance(6, seed))
        moving = Twist(np.array([1.0, seed, 3.0]), np.array([4.0, 5.0, seed]), covariance(6, seed + 9))
        message = convert.odometry_to_msg(
            estimate, convert.twist_to_msg(moving), frame_id=frames[0], child_frame_id=frames[1]
        )
        data = write.of(estimate, moving)
        assert len(data) == len(serialize_message(message))
        assert deserialize_message(data, Odometry) == message  # the bytes that align fields may be any


@pytest.mark.parametrize(
    "message",
    [
        Image(encoding="mono8", width=4, height=4, step=4, data=bytes(15)),
        Image(encoding="mono8", width=4, height=4, step=3, data=bytes(16)),
        Image(encoding="nv12", width=4, height=4, step=8, data=bytes(32)),
        CompressedImage(format="jpeg", data=b"no picture"),
        CompressedImage(format="jpeg"),
    ],
    ids=["too few bytes", "lines too short", "unknown encoding", "not a picture", "empty"],
)
def test_images_that_can_not_be_read_are_refused(message: Any) -> None:
    assert refusal(convert.image_from_msg, message) == "image"


@pytest.mark.parametrize(
    "message",
    [
        CameraInfo(width=640, height=480),
        CameraInfo(width=640, height=480, k=[NAN, 0, 320, 0, 500, 240, 0, 0, 1]),
        CameraInfo(width=0, height=480, k=[500.0, 0, 320, 0, 500, 240, 0, 0, 1]),
        CameraInfo(width=640, height=480, k=[500.0, 0, 320, 0, 500, 240, 0, 0, 1], distortion_model="equidistant"),
    ],
    ids=["no K", "NaN in K", "no width", "unknown distortion"],
)
def test_calibrations_that_can_not_be_used_are_refused(message: Any) -> None:
    with pytest.raises(CalibrationError):
        SensorSetup.of("uav1", InputConfig()).add_camera("left", message)


def test_pixels_come_back_from_an_image() -> None:
    pixels = np.arange(12, dtype=np.uint8).reshape(3, 4)
    message = Image(encoding="mono8", width=4, height=3, step=4, data=convert.flat(pixels.ravel()))
    np.testing.assert_array_equal(convert.image_from_msg(serialised(message)), pixels)
