# SPDX-License-Identifier: Apache-2.0
"""Records of the ROS messages that bags hold, built by rosbags or rclpy; those of nodes alone are in `ros.convert`."""

import dataclasses
import struct
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.camera_calibration import camera, pose_in_pair
from uav_vslam.errors import BagError, CalibrationError, InvalidMessage
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, NavState

Array = NDArray[np.float64]

# Type and channels of each image encoding, and the OpenCV conversion to grey or BGR pixels; None: they are.
ENCODINGS: dict[str, tuple[Any, int, int | None]] = {
    "mono8": (np.uint8, 1, None),
    "8UC1": (np.uint8, 1, None),
    "mono16": (np.uint16, 1, None),
    "16UC1": (np.uint16, 1, None),
    "bgr8": (np.uint8, 3, None),
    "8UC3": (np.uint8, 3, None),
    "rgb8": (np.uint8, 3, cv2.COLOR_RGB2BGR),
    "bgra8": (np.uint8, 4, cv2.COLOR_BGRA2BGR),
    "8UC4": (np.uint8, 4, cv2.COLOR_BGRA2BGR),
    "rgba8": (np.uint8, 4, cv2.COLOR_RGBA2BGR),
    "bgr16": (np.uint16, 3, None),
    "rgb16": (np.uint16, 3, cv2.COLOR_RGB2BGR),
    "uyvy": (np.uint8, 2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422": (np.uint8, 2, cv2.COLOR_YUV2BGR_UYVY),
    "yuyv": (np.uint8, 2, cv2.COLOR_YUV2BGR_YUYV),
    "yuv422_yuy2": (np.uint8, 2, cv2.COLOR_YUV2BGR_YUYV),
} | {
    f"bayer_{pattern}{bits}": (kind, 1, conversion)
    for bits, kind in ((8, np.uint8), (16, np.uint16))
    for pattern, conversion in (
        ("rggb", cv2.COLOR_BayerRGGB2BGR),
        ("bggr", cv2.COLOR_BayerBGGR2BGR),
        ("gbrg", cv2.COLOR_BayerGBRG2BGR),
        ("grbg", cv2.COLOR_BayerGRBG2BGR),
    )
}
TRUTH_TYPES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
AS_THE_SENSOR_LAY = cv2.IMREAD_IGNORE_ORIENTATION  # of EXIF: the calibration is of the stored pixels, as in ROS

# A serialised message (CDR) begins with its encoding, the stamp and the length of the frame_id with its final zero.
PLAIN_CDR = (b"\0\0", b"\0\1")  # big and little endian
CDR_HEADER, FRAME_ID = 4, 16  # bytes before the content, and before the frame_id's characters
# After the frame_id: orientation, rate and force, each with its covariance.
IMU_NUMBERS, GYRO, GYRO_COVARIANCE, ACCEL, ACCEL_COVARIANCE = 37, slice(13, 16), 16, slice(25, 28), 28
ASYMMETRY = 1e-6  # of a covariance, in correlation: more is no rounding
NOT_MEASURED = -1.0  # in sensor_msgs/Imu the first number of the covariance of what the device does not measure


@dataclass(frozen=True, slots=True)
class TruthSample:
    """The true motion at one stamp, as in `nav_msgs/Odometry`.

    Attributes:
        stamp_ns: time [ns].
        T_world_body: pose.
        v_world: (3,) velocity [m/s].
        rate_body: (3,) angular rate [rad/s].
    """

    stamp_ns: int
    T_world_body: Pose
    v_world: Array
    rate_body: Array


def stamp_ns_of(stamped: Any) -> int:
    """Return the header stamp of a message [ns]."""
    return time_ns_of(stamped.header.stamp)


def time_ns_of(time: Any) -> int:
    """Return a builtin_interfaces/Time [ns]."""
    return _nanoseconds(time.sec, time.nanosec)


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp of a serialised message that begins with a std_msgs/Header [ns].

    Raises:
        BagError: the bytes are too few.
    """
    if len(data) < 12:
        raise BagError(f"a message of {len(data)} bytes has no header; record the topic again")
    return _nanoseconds(*struct.unpack_from(f"{_byte_order(data)}iI", data, CDR_HEADER))


def imu_of_data(data: bytes) -> tuple[ImuSample, str]:
    """Return the reading of a serialised Imu message and its frame_id, without the message in between.

    Raises:
        BagError: the bytes are too few, or not plain CDR (a foreign one may have the other byte order).
    """
    if data[:2] not in PLAIN_CDR or len(data) < FRAME_ID:
        raise BagError(f"{len(data)} bytes of encoding {data[:2].hex()!r} are no message in plain CDR")
    order = _byte_order(data)
    (length,) = struct.unpack_from(f"{order}I", data, FRAME_ID - 4)
    begin = CDR_HEADER + -(-(FRAME_ID + length - CDR_HEADER) // 8) * 8  # numbers of 8 bytes are aligned
    if len(data) < begin + 8 * IMU_NUMBERS:
        raise BagError(f"{len(data)} bytes are too few for a sensor_msgs/Imu whose frame_id has {length}")
    numbers = np.frombuffer(data, f"{order}f8", IMU_NUMBERS, begin).astype(float)
    frame = data[FRAME_ID : FRAME_ID + length - 1].decode()
    gyro = _measured(numbers[GYRO], numbers[GYRO_COVARIANCE])
    return ImuSample(header_stamp_ns(data), gyro, _measured(numbers[ACCEL], numbers[ACCEL_COVARIANCE])), frame


def _byte_order(data: bytes) -> str:
    """Return the order of the bytes of a serialised message as `struct` writes it."""
    return "<" if data[1] & 1 else ">"


def _nanoseconds(sec: int, nanosec: int) -> int:
    return int(sec) * NS_PER_S + int(nanosec)


def image_of(built: Any) -> NDArray[Any]:
    """Return the (H, W) or (H, W, 3) BGR pixels of an Image or CompressedImage.

    Raises:
        BagError: the image can't be decoded.
    """
    if hasattr(built, "format"):
        pixels = decoded(np.asarray(built.data))
        if pixels is None:
            raise BagError(f"compressed image at {stamp_ns_of(built)} ns can't be decoded; is it {built.format!r}?")
        return _demosaiced(pixels, built.format.partition(";")[0].strip())
    if built.encoding not in ENCODINGS:
        raise BagError(f"image encoding {built.encoding!r} can't be used; use {', '.join(ENCODINGS)} or compressed")
    dtype, channels, conversion = ENCODINGS[built.encoding]
    kind = np.dtype(dtype).newbyteorder(">" if built.is_bigendian else "<")
    line = built.width * channels * kind.itemsize
    if line * built.height == 0:
        raise BagError(f"image of {built.width}x{built.height} px is empty; record it again")
    if channels == 2 and built.width % 2:
        raise BagError(f"image {built.width} px wide can't be {built.encoding}, of pairs of pixels; record it again")
    if built.step < line or len(built.data) < built.step * built.height:
        raise BagError(
            f"image of {built.width}x{built.height} px in {built.encoding} holds {len(built.data)} bytes, with a step "
            f"of {built.step}; its step must be at least {line} bytes, and its data height x step: correct its driver"
        )
    rows = np.asarray(built.data)[: built.step * built.height].reshape(built.height, built.step)[:, :line]
    pixels = np.ascontiguousarray(rows).view(kind).astype(dtype, copy=False)
    if channels > 1:
        pixels = pixels.reshape(built.height, built.width, channels)
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion))


def _demosaiced(pixels: NDArray[Any], encoding: str) -> NDArray[Any]:
    """Return BGR pixels where a compressed image is a Bayer mosaic, and other pixels as they are."""
    if pixels.ndim != 2 or not encoding.startswith("bayer_") or encoding not in ENCODINGS:
        return pixels
    conversion = ENCODINGS[encoding][2]
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion))


def decoded(data: NDArray[np.uint8]) -> NDArray[Any] | None:
    """Return an encoded image's pixels, or None."""
    return _decoded(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)


def halved(data: NDArray[np.uint8]) -> NDArray[Any] | None:
    """Return an encoded image's pixels, or None; grey and at half size, as that is the fastest that reads it all."""
    return _decoded(data, cv2.IMREAD_REDUCED_GRAYSCALE_2)


def _decoded(data: NDArray[np.uint8], flags: int) -> NDArray[Any] | None:
    try:
        return cv2.imdecode(data, AS_THE_SENSOR_LAY | flags)
    except cv2.error:  # empty data, or a size beyond OpenCV's limits
        return None


def camera_of(info: Any) -> PinholeCamera:
    """Return the intrinsics of a CameraInfo's images, after its binning and region of interest.

    Raises:
        CalibrationError: the distortion model is not supported, K, D or the size is not filled in, or the region of
            interest is not within the sensor.
    """
    k = info.k
    sensor = camera((info.width, info.height), (k[0], k[4], k[2], k[5]), info.distortion_model, info.d)
    return _recorded_part(info, sensor)


def _recorded_part(info: Any, sensor: PinholeCamera) -> PinholeCamera:
    """Return the camera of what a sensor sends: a window of it, of pixels that are means of `binning` ones."""
    step_x, step_y = max(info.binning_x, 1), max(info.binning_y, 1)
    left, top = info.roi.x_offset, info.roi.y_offset
    width, height = info.roi.width or sensor.width - left, info.roi.height or sensor.height - top
    if (left, top, width, height, step_x, step_y) == (0, 0, *sensor.size, 1, 1):
        return sensor
    if left + width > sensor.width or top + height > sensor.height:
        raise CalibrationError(
            f"the region of interest of camera_info, {width}x{height} px from ({left}, {top}), is not within its "
            f"{sensor.width}x{sensor.height} px; width, height and K are those of the whole sensor without binning"
        )
    return dataclasses.replace(
        sensor,
        width=width // step_x,
        height=height // step_y,
        fx=sensor.fx / step_x,
        fy=sensor.fy / step_y,
        cx=(sensor.cx - left + 0.5) / step_x - 0.5,  # whole numbers are the centres of pixels
        cy=(sensor.cy - top + 0.5) / step_y - 0.5,
    )


def rectified_camera_of(info: Any) -> tuple[PinholeCamera, Pose]:
    """Return the intrinsics of rectified images, from P of a CameraInfo, and T_cam_rectified from R.

    Raises:
        CalibrationError: P, R or the size is not filled in, or the region of interest is not within the sensor.
    """
    fx, _, cx, _, _, fy, cy = np.asarray(info.p, dtype=float)[:7].tolist()
    R_rectified_cam = np.asarray(info.r, dtype=float).reshape(3, 3)
    if not np.allclose(R_rectified_cam @ R_rectified_cam.T, np.eye(3), atol=1e-3):
        raise CalibrationError("R of camera_info is no rotation; is it filled in? Or leave out input.rectified")
    sensor = PinholeCamera(info.width, info.height, fx, fy, cx, cy)
    return _recorded_part(info, sensor), Pose(R_rectified_cam.T, np.zeros(3))


def T_pair_cam_of(info: Any, *, rectified: bool) -> Pose | None:
    """Return the pose of the images of a CameraInfo in the rectified frame of their stereo pair; None if P has none."""
    R_pair_cam = np.eye(3) if rectified else np.asarray(info.r, dtype=float).reshape(3, 3)
    return pose_in_pair(np.asarray(info.p, dtype=float).reshape(3, 4), R_pair_cam)


def imu_of(built: Any) -> ImuSample:
    """Return the reading of an Imu message."""
    gyro = _measured(_array(built.angular_velocity), built.angular_velocity_covariance[0])
    accel = _measured(_array(built.linear_acceleration), built.linear_acceleration_covariance[0])
    return ImuSample(stamp_ns_of(built), gyro, accel)


def _measured(vector: Array, variance: float) -> Array:
    """Return a vector of an Imu message; NaN if it is left at zero and marked as not measured."""
    return np.full(3, np.nan) if variance == NOT_MEASURED and not vector.any() else vector


def truth_of(built: Any) -> TruthSample:
    """Return the motion of one of `TRUTH_TYPES`: of an Odometry; of the others the pose, and NaN for the rest.

    Raises:
        InvalidMessage: the quaternion is zero, or the pose is not finite.
    """
    try:
        if hasattr(built, "transform"):
            T_world_body = _pose(built.transform.rotation, built.transform.translation)
        else:
            pose = getattr(built.pose, "pose", built.pose)  # with covariance or without
            T_world_body = _pose(pose.orientation, pose.position)
    except ValueError as error:
        raise InvalidMessage("orientation", str(error)) from None
    if not (np.isfinite(T_world_body.t).all() and np.isfinite(T_world_body.R).all()):
        raise InvalidMessage("pose", "it is not finite")
    if not hasattr(built, "twist"):
        unknown = np.full(3, np.nan)
        return TruthSample(stamp_ns_of(built), T_world_body, unknown, unknown)
    twist = built.twist.twist
    return TruthSample(stamp_ns_of(built), T_world_body, T_world_body.R @ _array(twist.linear), _array(twist.angular))


def navigation_state_of(built: Any) -> NavEstimate:
    """Return the estimate of a NavigationState message.

    Raises:
        InvalidMessage: the quaternion is zero, a number is not finite, or the covariance is not symmetric.
    """
    try:
        pose = _pose(built.pose.orientation, built.pose.position)
    except ValueError as error:
        raise InvalidMessage("orientation", str(error)) from None
    parts = [pose.t, *(_array(vector) for vector in (built.velocity, built.gyro_bias, built.accel_bias))]
    P = np.array(built.covariance, dtype=float).reshape(15, 15)
    names = ("position", "velocity", "gyro_bias", "accel_bias", "covariance")
    for what, numbers in zip(names, (*parts, P), strict=True):
        if not np.isfinite(numbers).all():
            raise InvalidMessage("not_finite", f"{what} holds NaN or infinity")
    sigmas = np.sqrt(np.abs(np.diag(P)))
    if (np.abs(P - P.T) > ASYMMETRY * np.outer(sigmas, sigmas)).any():
        raise InvalidMessage("covariance", "the covariance is not symmetric; fill in both triangles of the matrix")
    return NavEstimate(NavState(stamp_ns_of(built), pose, *parts[1:]), P)


def transforms_of(built: Any) -> tuple[list[tuple[str, str, Pose]], list[str]]:
    """Return the edges (parent frame, child frame, T_parent_child) of a TFMessage, and what is wrong with the others.

    An invalid one may be of a sensor that is not ours: tf2 drops it alone, too.

    Raises:
        CalibrationError: it is another message.
    """
    if not hasattr(built, "transforms"):
        raise CalibrationError(f"/tf_static holds {built.__msgtype__}; record tf2_msgs/msg/TFMessage")
    edges, faults = [], []
    for stamped in built.transforms:
        parent, child = stamped.header.frame_id.lstrip("/"), stamped.child_frame_id.lstrip("/")
        try:
            pose = _pose(stamped.transform.rotation, stamped.transform.translation)
            if not np.isfinite(pose.matrix).all():
                raise ValueError("the transform holds NaN or infinity")
            edges.append((parent, child, pose))
        except ValueError as error:
            faults.append(f"/tf_static, {parent} to {child}: {error}; publish a corrected transform")
    return edges, faults


def _pose(q: Any, position: Any) -> Pose:
    return Pose.from_quaternion_wxyz([q.w, q.x, q.y, q.z], _array(position))


def _array(vector: Any) -> Array:
    return np.array([vector.x, vector.y, vector.z], dtype=float)
