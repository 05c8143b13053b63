# SPDX-License-Identifier: Apache-2.0
"""Builds bag messages from records; `messages` reads them back."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.cdr import message
from uav_vslam.datasets.messages import TruthSample
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate

Array = NDArray[np.float64]


def with_header(built: Any, stamp_ns: int, frame_id: str) -> Any:
    """Give a message another header; return it."""
    built.header = _header(stamp_ns, frame_id)
    return built


def image_message(stamp_ns: int, frame_id: str, image: NDArray[Any], *, encoding: str = "") -> Any:
    """Build sensor_msgs/Image from (H, W) grey or (H, W, 3) BGR pixels, or with another encoding of theirs."""
    encoding = encoding or ("bgr8" if image.ndim == 3 else "mono8" if image.dtype == np.uint8 else "mono16")
    pixels = np.ascontiguousarray(image).astype(image.dtype.newbyteorder("<"), copy=False)
    return message(
        "sensor_msgs/msg/Image",
        header=_header(stamp_ns, frame_id),
        height=image.shape[0],
        width=image.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=pixels.strides[0],
        data=pixels.view(np.uint8).reshape(-1),
    )


def compressed_image_message(stamp_ns: int, frame_id: str, encoded: bytes, *, fmt: str) -> Any:
    """Build sensor_msgs/CompressedImage from the bytes of a file.

    Args:
        stamp_ns: exposure time [ns].
        frame_id: of the camera.
        encoded: bytes of the file.
        fmt: "jpeg" or "png"; of a Bayer mosaic "bayer_rggb8; png compressed", as `compressed_image_transport` has it.
    """
    data = np.frombuffer(encoded, np.uint8)
    return message("sensor_msgs/msg/CompressedImage", header=_header(stamp_ns, frame_id), format=fmt, data=data)


def camera_info_message(stamp_ns: int, frame_id: str, camera: PinholeCamera) -> Any:
    """Build sensor_msgs/CameraInfo; K and D are the calibration; P repeats K, because the rig is not rectified."""
    return message(
        "sensor_msgs/msg/CameraInfo",
        header=_header(stamp_ns, frame_id),
        height=camera.height,
        width=camera.width,
        distortion_model=camera.model,
        d=np.asarray(camera.distortion, dtype=float),
        k=camera.K.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack([camera.K, np.zeros(3)]).ravel(),
        binning_x=0,
        binning_y=0,
        roi=message("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def imu_message(sample: ImuSample, frame_id: str) -> Any:
    """Build sensor_msgs/Imu; orientation is marked as unavailable."""
    unknown = np.zeros(9)
    unknown[0] = -1.0
    return message(
        "sensor_msgs/msg/Imu",
        header=_header(sample.stamp_ns, frame_id),
        orientation=_quaternion(np.array([1.0, 0.0, 0.0, 0.0])),
        orientation_covariance=unknown,
        angular_velocity=_vector(sample.gyro),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=_vector(sample.accel),
        linear_acceleration_covariance=np.zeros(9),
    )


def truth_message(sample: TruthSample, vehicle: str) -> Any:
    """Build nav_msgs/Odometry of a vehicle in `world`; the twist is in the body frame, as the message defines it."""
    twist = message(
        "geometry_msgs/msg/Twist",
        linear=_vector(sample.T_world_body.R.T @ sample.v_world),
        angular=_vector(sample.rate_body),
    )
    return message(
        "nav_msgs/msg/Odometry",
        header=_header(sample.stamp_ns, "world"),
        child_frame_id=f"{vehicle}/base_link",
        pose=message("geometry_msgs/msg/PoseWithCovariance", pose=_pose(sample.T_world_body), covariance=np.zeros(36)),
        twist=message("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )


def navigation_state_message(estimate: NavEstimate, vehicle: str) -> Any:
    """Build uav_vslam_msgs/NavigationState of a vehicle in its map frame."""
    state = estimate.state
    return message(
        "uav_vslam_msgs/msg/NavigationState",
        header=_header(state.stamp_ns, f"{vehicle}/map"),
        child_frame_id=f"{vehicle}/base_link",
        pose=_pose(state.T_map_body),
        velocity=_vector(state.v_map),
        gyro_bias=_vector(state.gyro_bias),
        accel_bias=_vector(state.accel_bias),
        covariance=np.asarray(estimate.covariance, dtype=float).ravel(),
    )


def transforms_message(stamp_ns: int, edges: Sequence[tuple[str, str, Pose]]) -> Any:
    """Build tf2_msgs/TFMessage from edges (parent frame, child frame, T_parent_child)."""
    transforms = []
    for parent, child, pose in edges:
        transform = message(
            "geometry_msgs/msg/Transform", translation=_vector(pose.t), rotation=_quaternion(pose.quaternion_wxyz)
        )
        transforms.append(
            message(
                "geometry_msgs/msg/TransformStamped",
                header=_header(stamp_ns, parent),
                child_frame_id=child,
                transform=transform,
            )
        )
    return message("tf2_msgs/msg/TFMessage", transforms=transforms)


def _header(stamp_ns: int, frame_id: str) -> Any:
    sec, nanosec = divmod(int(stamp_ns), NS_PER_S)
    stamp = message("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def _vector(values: Array) -> Any:
    x, y, z = np.asarray(values, dtype=float).tolist()
    return message("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _quaternion(wxyz: Array) -> Any:
    w, x, y, z = wxyz.tolist()
    return message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _pose(pose: Pose) -> Any:
    x, y, z = np.asarray(pose.t, dtype=float).tolist()
    point = message("geometry_msgs/msg/Point", x=x, y=y, z=z)
    return message("geometry_msgs/msg/Pose", position=point, orientation=_quaternion(pose.quaternion_wxyz))
