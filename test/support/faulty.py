# SPDX-License-Identifier: Apache-2.0
"""Plants faults into a recording of `uav1`: each is a list of changes for `foreign.rewritten`."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from uav_vslam.datasets.cdr import RawMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.studies.recordings.foreign import Change, edited, shifted, turned, without

LEFT, RIGHT = "/uav1/left/image_raw", "/uav1/right/image_raw"
INFOS = ("/uav1/left/camera_info", "/uav1/right/camera_info")
IMU, START, TRUTH = "/uav1/imu/data_raw", "/uav1/initial_state", "/uav1/ground_truth/odometry"
GRAVITY = 9.80665
CLIPPED = 20.0  # [m/s^2] of a shaken accelerometer


def later(topic: str, by_ns: int) -> Change:
    """Add to the header stamps."""
    return edited(topic, lambda message: shifted(message, by_ns))


def missing(topic: str, numbers: range) -> Change:
    """Leave out messages by number."""
    return _counted(topic, lambda number, raw: None if number in numbers else raw)


def ending(topic: str, share: float, total: int) -> Change:
    """Leave out the last messages, all but a share of `total`."""
    return missing(topic, range(int(share * total), total))


def backwards(topic: str, number: int, by_ns: int) -> Change:
    """Let some successive stamps jump back."""
    change = later(topic, -by_ns)
    return _counted(topic, lambda count, raw: change(raw) if count in range(number, number + 5) else raw)


def swapped(raw: RawMessage) -> RawMessage:
    """Exchange left and right images."""
    return dataclasses.replace(raw, topic={LEFT: RIGHT, RIGHT: LEFT}.get(raw.topic, raw.topic))


def frozen(topic: str, first: int) -> Change:
    """Repeat the pixels of one image from there on."""
    kept: list[Any] = []

    def edit(message: Any) -> Any:
        kept.append(message.data)
        return dataclasses.replace(message, data=kept[min(first, len(kept) - 1)])

    return edited(topic, edit)


def black(topic: str) -> Change:
    return edited(topic, lambda message: dataclasses.replace(message, data=np.zeros_like(message.data)))


def cropped(topic: str) -> Change:
    def edit(message: Any) -> Any:
        height = message.height // 2
        return dataclasses.replace(message, height=height, data=message.data[: height * message.step])

    return edited(topic, edit)


def projected() -> list[Change]:
    """Light a texture onto the ground, some 60 m away, from the vehicle: it stands still in both images."""
    texture = np.random.default_rng(7).integers(0, 256, (10, 10)).astype(np.uint8).repeat(4, axis=0).repeat(4, axis=1)
    size = len(texture)

    def light(message: Any, row: int, column: int) -> Any:
        image = message.data.reshape(message.height, message.step).copy()
        image[row : row + size, column : column + size] = texture
        return dataclasses.replace(message, data=image.ravel())

    return [edited(LEFT, lambda one: light(one, 80, 120)), edited(RIGHT, lambda one: light(one, 81, 127))]


def scaled(sensor: str, factor: float) -> Change:
    """Scale the IMU's `angular_velocity` or `linear_acceleration`."""

    def edit(message: Any) -> Any:
        vector = getattr(message, sensor)
        vector.x, vector.y, vector.z = factor * vector.x, factor * vector.y, factor * vector.z
        return message

    return edited(IMU, edit)


def some_scaled(sensor: str, factor: float, numbers: range) -> Change:
    """Scale some readings of `angular_velocity` or `linear_acceleration`."""
    change = scaled(sensor, factor)
    return _counted(IMU, lambda number, raw: change(raw) if number in numbers else raw)


def upside_down(message: Any) -> Any:
    """Turn the readings, but leave the body's frame in the header."""
    frame_id = message.header.frame_id
    message = turned(message)
    message.header.frame_id = frame_id
    return message


def shaken_and_clipped(message: Any) -> Any:
    """Shake the vertical axis by 3 g at 37 Hz, and clip it."""
    t_s = message.header.stamp.nanosec / 1e9
    force = message.linear_acceleration
    force.z = float(np.clip(force.z + 3.0 * GRAVITY * np.sin(2.0 * np.pi * 37.0 * t_s), -CLIPPED, CLIPPED))
    return message


def vibrating(message: Any) -> Any:
    """Add white noise of 0.5 m/s^2 on the vertical axis, the same for a stamp."""
    stamp = message.header.stamp
    rng = np.random.default_rng([stamp.sec, stamp.nanosec])
    message.linear_acceleration.z += float(rng.normal(0.0, 0.5))
    return message


def unreadable(message: Any) -> Any:
    """Name an encoding that nobody knows."""
    return dataclasses.replace(message, encoding="yuv9")


def empty(message: Any) -> Any:
    """Leave an image without pixels, as after an exposure that failed."""
    return dataclasses.replace(message, width=0, height=0, step=0, data=np.zeros(0, np.uint8))


def first(topic: str, count: int, change: Change) -> Change:
    """Change the first messages only."""
    return _counted(topic, lambda number, raw: change(raw) if number < count else raw)


def at_rest(message: Any) -> Any:
    """Forget the velocity of a start state."""
    message.velocity.x = message.velocity.y = message.velocity.z = 0.0
    return message


def moved_away(message: Any) -> Any:
    """Give a position in a frame 1 km away."""
    message.pose.pose.position.x += 1000.0
    return message


def in_unit(unit_m: float) -> Change:
    """Give the truth's positions and velocities in another unit [m]."""

    def edit(message: Any) -> Any:
        for vector in (message.pose.pose.position, message.twist.twist.linear):
            for axis in "xyz":
                setattr(vector, axis, getattr(vector, axis) / unit_m)
        return message

    return edited(TRUTH, edit)


def never_turned(message: Any) -> Any:
    """Give the orientation that a source of positions alone fills in."""
    q = message.pose.pose.orientation
    q.w, q.x, q.y, q.z = 1.0, 0.0, 0.0, 0.0
    return message


def of_other_axes(message: Any) -> Any:
    """Give the orientation of a motion capture's own axes, which are any."""
    pose = message.pose.pose
    q = pose.orientation
    T_world_body = Pose.from_quaternion_wxyz([q.w, q.x, q.y, q.z], np.zeros(3))
    T_body_other = Pose(so3_exp([0.3, -1.1, 2.0]), np.zeros(3))
    q.w, q.x, q.y, q.z = (T_world_body @ T_body_other).quaternion_wxyz.tolist()
    return message


def half_size(message: Any) -> Any:
    """Describe images of half the size."""
    return dataclasses.replace(message, width=message.width // 2, height=message.height // 2, k=0.5 * message.k)


def baseline(factor: float) -> Change:
    """Scale the distance of the cameras in /tf_static; the left one stays."""

    def edit(message: Any) -> Any:
        left, right = message.transforms[0].transform.translation, message.transforms[1].transform.translation
        for axis in "xyz":
            near = getattr(left, axis)
            setattr(right, axis, near + factor * (getattr(right, axis) - near))
        return message

    return edited("/tf_static", edit)


def _counted(topic: str, change: Callable[[int, RawMessage], RawMessage | None]) -> Change:
    count = 0

    def counting(raw: RawMessage) -> RawMessage | None:
        nonlocal count
        if raw.topic != topic:
            return raw
        count += 1
        return change(count - 1, raw)

    return counting


def recorded_at_stamp_plus(delay_ns: int) -> Change:
    """Record everything later than its header says."""
    return lambda raw: dataclasses.replace(raw, stamp_ns=raw.stamp_ns + delay_ns)


# Name: changes, and (severity, subject, words that must be said) of each finding that names the fault.
Expected = tuple[str, str, tuple[str, ...]]
FAULTS: dict[str, tuple[Callable[[], list[Change]], list[Expected]]] = {
    "no right images": (
        lambda: [without(RIGHT)],
        [("error", "right topic", (RIGHT, "was not recorded", "input.topics.right"))],
    ),
    "swapped cameras": (
        lambda: [swapped],
        [("error", "stereo geometry", ("left and right seem swapped", "upside down"))],
    ),
    "stereo stamps 30 ms apart": (
        lambda: [later(RIGHT, 30_000_000)],
        [("error", "stereo stamps", ("median 30 ms", "input.pair_tolerance_s: 0.036"))],
    ),
    "extrinsics that can't be read": (
        lambda: [lambda raw: dataclasses.replace(raw, data=raw.data[:20]) if raw.topic == "/tf_static" else raw],
        [("error", "frames", ("/tf_static", "not a valid tf2_msgs/msg/TFMessage"))],
    ),
    "stereo stamps 3 ms apart": (
        lambda: [later(RIGHT, 3_000_000)],
        [("warning", "stereo stamps", ("median 3 ms", "synchronise"))],
    ),
    "IMU stamps backwards": (
        lambda: [backwards(IMU, 300, 200_000_000)],
        [("warning", "IMU stamps", ("1 of", "go backwards", "message 301"))],
    ),
    "gap in the IMU": (
        lambda: [missing(IMU, range(200, 280))],
        [("warning", "IMU gaps", ("1 gap: 0.405 s at 0.99 s",))],
    ),
    "gap in the images": (
        lambda: [missing(LEFT, range(8, 12)), missing(RIGHT, range(8, 12))],
        [("warning", "left images gaps", ("1 gap: 0.7 s at 0.98 s",)), ("warning", "right images gaps", ("1 gap",))],
    ),
    "IMU in g": (
        lambda: [scaled("linear_acceleration", 1.0 / GRAVITY)],
        [("error", "IMU gravity size", ("in g, not in m/s^2",))],
    ),
    "gyroscope in degrees": (
        lambda: [scaled("angular_velocity", 180.0 / np.pi)],
        [
            ("error", "gyroscope against the truth", ("in degrees", "convert the readings to rad/s")),
            ("error", "gyroscope against the cameras", ("in degrees",)),
        ],
    ),
    "a gyroscope alone": (  # as drivers that do not unite both sensors publish it
        lambda: [scaled("linear_acceleration", 0.0)],
        [("error", "accelerometer", ("all readings are zero", "unite them in the driver"))],
    ),
    "an accelerometer alone": (
        lambda: [scaled("angular_velocity", 0.0)],
        [("error", "gyroscope", ("all readings are zero",))],
    ),
    "a few IMU readings of NaN": (
        lambda: [some_scaled("linear_acceleration", np.nan, range(200, 205))],
        [("warning", "IMU readings", ("5 of 685", "0 of the gyroscope, 5 of the accelerometer"))],
    ),
    "a few IMU readings that are no motion": (
        lambda: [some_scaled("linear_acceleration", -5.0, range(200, 500, 100))],
        [("warning", "IMU outliers", ("3 of 685", "45.4 m/s^2", "left out"))],
    ),
    "an IMU of NaN": (
        lambda: [some_scaled("angular_velocity", np.nan, range(1000))],
        [("error", "IMU readings", ("685 of 685", "685 of the gyroscope, 0 of"))],
    ),
    "IMU upside down": (
        lambda: [edited(IMU, upside_down)],
        [
            ("error", "IMU gravity direction", ("-z of the body", "upside down, or NED")),
            ("error", "gyroscope against the truth", ("(+x, -y, -z)", "upside down or NED")),
        ],
    ),
    "IMU frame that nothing connects": (
        lambda: [edited(IMU, turned)],
        [("error", "IMU frame", ("'imu_link'", "uav1/base_link -> imu_link"))],
    ),
    "no camera_info": (
        lambda: [without(*INFOS)],
        [
            ("error", "left_info topic", (INFOS[0], "input.calibration")),
            ("error", "right_info topic", (INFOS[1], "input.calibration")),
        ],
    ),
    "no extrinsics": (
        lambda: [without("/tf_static")],
        [("error", "camera frames", ("/tf_static", "uav1/base_link -> uav1/left_optical", "input.calibration"))],
    ),
    "camera_info of another size": (
        lambda: [edited(INFOS[0], half_size), edited(INFOS[1], half_size)],
        [("error", "left image size", ("320x240", "160x120")), ("error", "right image size", ("320x240", "160x120"))],
    ),
    "left camera_info alone of another size": (
        lambda: [edited(INFOS[0], half_size)],
        [("error", "rig", ("160x120", "320x240")), ("error", "left image size", ("320x240",))],
    ),
    "a projector on the vehicle": (
        projected,
        [("warning", "points that move", ("stand still in the image", "emitter_enabled"))],
    ),
    "images cropped": (
        lambda: [cropped(RIGHT)],
        [("error", "right image size", ("320x120", "320x240"))],
    ),
    "baseline of zero": (
        lambda: [baseline(0.0)],
        [("error", "rig", ("baseline is 0", "/tf_static"))],
    ),
    "baseline of another rig in P": (
        lambda: [edited(INFOS[1], lambda info: dataclasses.replace(info, p=info.p - 0.05 * info.k[4] * np.eye(12)[7]))],
        [("warning", "baseline", ("by P of camera_info", "the former is used"))],
    ),
    "baseline in millimetres": (
        lambda: [baseline(1000.0)],
        [("error", "baseline", ("baseline 776", "in millimetres: 0.776 m"))],
    ),
    "no start state": (
        lambda: [without(START)],
        [("error", "start state", ("no start state", "in_flight"))],
    ),
    "images of an unreadable encoding": (
        lambda: [edited(LEFT, unreadable), edited(RIGHT, unreadable)],
        [
            ("error", "left messages", ("8 of 8 messages", "image encoding")),
            ("error", "right messages", ("8 of 8 messages", "image encoding")),
        ],
    ),
    "first image empty": (
        lambda: [first(LEFT, 1, edited(LEFT, empty))],
        [("warning", "left messages", ("1 of 8 messages", "0x0 px is empty"))],
    ),
    "start state at rest in flight": (
        lambda: [edited(START, at_rest)],
        [("warning", "start state", ("its velocity is 0.00 0.00 0.00 m/s, the truth's",))],
    ),
    "truth of another origin": (
        lambda: [edited(TRUTH, moved_away)],
        [("warning", "truth origin", ("it is 1e+03 m and 0 deg", "--alignment se3"))],
    ),
    "truth in millimetres": (
        lambda: [in_unit(1e-3)],
        [("warning", "scale", ("cameras fly 0.001 times the distance of the truth", "the truth is in millimetres"))],
    ),
    "truth without an attitude": (
        lambda: [edited(TRUTH, never_turned)],
        [
            (
                "warning",
                "truth attitude",
                ("the same in all", "the gyroscope turns", "only positions are compared"),
            )
        ],
    ),
    "truth of other axes": (
        lambda: [edited(TRUTH, of_other_axes)],
        [
            (
                "warning",
                "truth axes",
                ("gravity direction", "the cameras agree with the gyroscope", "of the body's frame"),
            )
        ],
    ),
    "truth in kilometres": (
        lambda: [in_unit(1e3)],
        [("warning", "scale", ("the truth is in kilometres", "positions in metres"))],
    ),
    "start state of another time": (
        lambda: [later(START, -100_000_000_000)],
        [("error", "start time", ("-100",))],
    ),
    "truth of another time": (
        lambda: [later(TRUTH, 1_000_000_000_000)],
        [("warning", "truth time", ("0 of", "1000.00 s"))],
    ),
    "saturated accelerometer": (
        lambda: [edited(IMU, shaken_and_clipped)],
        [("warning", "accelerometer saturation", ("20 m/s^2 on z", "-20 m/s^2 on z"))],
    ),
    "vibration": (
        lambda: [edited(IMU, vibrating)],
        [("warning", "accelerometer noise", ("too much on z (", "set imu.accel_noise: 0.03"))],
    ),
    "frozen camera": (
        lambda: [frozen(RIGHT, 10)],
        [("error", "right images frozen", ("13 of 24", "first image 12"))],
    ),
    "black images": (
        lambda: [black(LEFT)],
        [("error", "left images blind", ("show nothing", "grey level 0"))],
    ),
    "IMU ends before the images": (
        lambda: [ending(IMU, 0.5, 685)],
        [("warning", "IMU coverage", ("12 after the last",))],
    ),
    "IMU stamped late": (
        lambda: [later(IMU, 60_000_000)],
        [
            ("warning", "gyroscope against the truth", ("60 ms late", "correct the stamps")),
            ("error", "gyroscope against the cameras", ("60 ms late", "timeshift_cam_imu: 0.06")),
        ],
    ),
    "IMU of another clock": (
        lambda: [later(IMU, -50_000_000_000)],
        [
            ("error", "IMU clock", ("50 s before", "one clock")),
            ("error", "IMU coverage", ("24 after the last",)),
            ("error", "gyroscope against the cameras", ("50.000 s early", "timeshift_cam_imu: -50 (")),
        ],
    ),
    "IMU recorded late": (
        lambda: [lambda raw: dataclasses.replace(raw, stamp_ns=raw.stamp_ns + 1_000_000_000 * (raw.topic == IMU))],
        [("warning", "IMU delay", ("1 s before", "can be run"))],
    ),
    "sensors of another clock than the recorder": (
        lambda: [recorded_at_stamp_plus(3_600_000_000_000)],
        [("warning", "clock", ("3.6e+03 s before recording time", "synchronise"))],
    ),
}

# Several at once: each must still be named.
TOGETHER: dict[str, list[str]] = {
    "nothing fits": ["no right images", "IMU in g", "no start state", "truth of another time", "gap in the IMU"],
    "a wrong IMU beside swapped cameras": ["swapped cameras", "gyroscope in degrees", "no start state"],
    "wrong sizes, upside down": ["camera_info of another size", "IMU upside down", "gap in the images"],
    "no calibration, other clock": ["no camera_info", "no extrinsics", "IMU of another clock", "frozen camera"],
}
