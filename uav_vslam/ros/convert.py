# SPDX-License-Identifier: Apache-2.0
"""Conversion between messages and records; of messages that bags hold as well, `datasets.messages` makes the records.

Large arrays go into messages through `array.array`, which rclpy copies as bytes; a list or an ndarray is copied element
by element. Every `*_from_msg` checks what it reads and raises `InvalidMessage`.
"""

from array import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    TransformStamped,
    TwistWithCovariance,
    Vector3,
)
from geometry_msgs.msg import Pose as PoseMsg
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image, PointCloud2, PointField
from std_msgs.msg import Header

from uav_vslam.datasets.messages import image_of, imu_of_data, navigation_state_of, stamp_ns_of, time_ns_of
from uav_vslam.errors import BagError, InvalidMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.types import (
    NS_PER_S,
    ImuIncrement,
    ImuSample,
    JointInformation,
    NavEstimate,
    PoseEstimate,
    StereoFeatures,
    Twist,
)
from uav_vslam_msgs.msg import InsIncrement, NavigationState
from uav_vslam_msgs.msg import JointInformation as JointInformationMsg
from uav_vslam_msgs.msg import StereoFeatures as StereoFeaturesMsg

Array = NDArray[np.float64]

TYPECODES = {
    np.dtype(kind): code
    for kind, code in (
        (np.uint8, "B"),
        (np.int8, "b"),
        (np.uint16, "H"),
        (np.int16, "h"),
        (np.uint32, "I"),
        (np.float32, "f"),
        (np.float64, "d"),
    )
}


def flat(values: NDArray[Any]) -> array:
    """Return an ndarray as the `array.array` that a message field copies as bytes."""
    contiguous = np.ascontiguousarray(values)
    out = array(TYPECODES[contiguous.dtype])
    out.frombytes(contiguous.tobytes())
    return out


def stamp_from_ns(stamp_ns: int) -> Time:
    """Return a message stamp."""
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)


def header(stamp_ns: int, frame_id: str) -> Header:
    """Return a header."""
    return Header(stamp=stamp_from_ns(stamp_ns), frame_id=frame_id)


def pose_to_msg(pose: Pose) -> PoseMsg:
    """Return geometry_msgs/Pose."""
    w, x, y, z = pose.quaternion_wxyz.tolist()
    return PoseMsg(position=Point(**_xyz(pose.t)), orientation=Quaternion(w=w, x=x, y=y, z=z))


def pose_from_msg(message: PoseMsg) -> Pose:
    """Return a pose."""
    p, q = message.position, message.orientation
    t = _finite([p.x, p.y, p.z], "position")
    try:
        return Pose.from_quaternion_wxyz([q.w, q.x, q.y, q.z], t)
    except ValueError as error:
        raise InvalidMessage("orientation", str(error)) from None


def imu_from_data(data: bytes) -> tuple[ImuSample, str]:
    """Return the reading of a serialised Imu message, and its frame."""
    try:
        sample, frame = imu_of_data(data)
    except (BagError, UnicodeDecodeError) as error:
        raise InvalidMessage("encoding", str(error)) from None
    if not sample.is_finite:
        what = "linear_acceleration" if np.isfinite(sample.gyro).all() else "angular_velocity"
        raise InvalidMessage(
            "not_finite", f"{what} holds NaN or infinity, or is marked as not measured (covariance -1)"
        )
    return sample, frame


def image_from_msg(message: Image | CompressedImage) -> NDArray[Any]:
    """Return (H, W) or (H, W, 3) BGR pixels, without a copy if the encoding allows."""
    try:
        return image_of(message)
    except BagError as error:
        raise InvalidMessage("image", str(error)) from None


def transform_to_msg(pose: Pose, *, stamp_ns: int, parent: str, child: str) -> TransformStamped:
    """Return T_parent_child as a message."""
    message = TransformStamped(header=header(stamp_ns, parent), child_frame_id=child)
    message.transform.translation = Vector3(**_xyz(pose.t))
    message.transform.rotation = pose_to_msg(pose).orientation
    return message


def features_to_msg(features: StereoFeatures, *, frame_id: str, size: tuple[int, int]) -> StereoFeaturesMsg:
    """Return the message; `size` is the image's width and height [px]."""
    return StereoFeaturesMsg(
        header=header(features.stamp_ns, frame_id),
        width=size[0],
        height=size[1],
        pixels=flat(features.pixels),
        descriptor_size=features.descriptors.shape[1],
        descriptors=flat(features.descriptors),
        tracks=flat(features.tracks),
    )


def features_from_msg(message: StereoFeaturesMsg) -> StereoFeatures:
    """Return stereo features."""
    pixels = rows_of(message.pixels, np.float32, 4, "pixels")
    descriptors = rows_of(message.descriptors, np.uint8, message.descriptor_size, "descriptors")
    tracks = np.array(message.tracks, dtype=np.uint32)
    if not len(pixels) == len(descriptors) == len(tracks):
        raise InvalidMessage("shape", f"{len(pixels)} points, {len(descriptors)} descriptors, {len(tracks)} tracks")
    _finite(pixels, "pixels")
    return StereoFeatures(stamp_ns_of(message), pixels, descriptors, tracks)


def increment_to_msg(increment: ImuIncrement, *, frame_id: str) -> InsIncrement:
    """Return the message."""
    return InsIncrement(
        header=header(increment.stamp_ns, frame_id),
        start=stamp_from_ns(increment.start_ns),
        samples=increment.samples,
        delta_rotation=increment.delta_R.ravel(),
        delta_velocity=increment.delta_v,
        delta_position=increment.delta_p,
        rate_start=increment.rate_start,
        rate_end=increment.rate_end,
        rate_slope_start=increment.rate_slope_start,
        rate_slope_end=increment.rate_slope_end,
        gyro_bias=increment.gyro_bias,
        accel_bias=increment.accel_bias,
        bias_jacobian=increment.bias_jacobian.ravel(),
        covariance=increment.covariance.ravel(),
        gyro_noise=increment.gyro_noise,
        accel_noise=increment.accel_noise,
    )


def increment_from_msg(message: InsIncrement) -> ImuIncrement:
    """Return a preintegrated increment."""
    start_ns, stamp_ns = time_ns_of(message.start), stamp_ns_of(message)
    if stamp_ns <= start_ns:
        raise InvalidMessage("stamp", f"an increment from {start_ns} to {stamp_ns} ns has no duration")
    return ImuIncrement(
        start_ns=start_ns,
        stamp_ns=stamp_ns,
        samples=int(message.samples),
        delta_R=_finite(message.delta_rotation, "delta_rotation").reshape(3, 3),
        delta_v=_finite(message.delta_velocity, "delta_velocity"),
        delta_p=_finite(message.delta_position, "delta_position"),
        rate_start=_finite(message.rate_start, "rate_start"),
        rate_end=_finite(message.rate_end, "rate_end"),
        rate_slope_start=_finite(message.rate_slope_start, "rate_slope_start"),
        rate_slope_end=_finite(message.rate_slope_end, "rate_slope_end"),
        gyro_bias=_finite(message.gyro_bias, "gyro_bias"),
        accel_bias=_finite(message.accel_bias, "accel_bias"),
        bias_jacobian=_finite(message.bias_jacobian, "bias_jacobian").reshape(9, 6),
        covariance=_finite(message.covariance, "covariance").reshape(9, 9),
        gyro_noise=_positive(message.gyro_noise, "gyro_noise"),
        accel_noise=_positive(message.accel_noise, "accel_noise"),
    )


def navigation_to_msg(nav: NavEstimate, *, frame_id: str, child_frame_id: str) -> NavigationState:
    """Return the message."""
    state = nav.state
    return NavigationState(
        header=header(state.stamp_ns, frame_id),
        child_frame_id=child_frame_id,
        pose=pose_to_msg(state.T_map_body),
        velocity=Vector3(**_xyz(state.v_map)),
        gyro_bias=Vector3(**_xyz(state.gyro_bias)),
        accel_bias=Vector3(**_xyz(state.accel_bias)),
        covariance=nav.covariance.ravel(),
    )


def navigation_from_msg(message: NavigationState) -> NavEstimate:
    """Return a navigation estimate."""
    nav = navigation_state_of(message)
    if not np.linalg.eigvalsh(nav.covariance)[0] > 0:
        raise InvalidMessage("covariance", "the covariance of a navigation state must be positive definite")
    return nav


def odometry_to_msg(pose: PoseEstimate, twist: TwistWithCovariance, *, frame_id: str, child_frame_id: str) -> Odometry:
    """Return nav_msgs/Odometry: the pose in `frame_id`, the twist in the body frame, as the message defines."""
    stamped = header(pose.stamp_ns, frame_id)
    return Odometry(header=stamped, child_frame_id=child_frame_id, pose=_with_covariance(pose), twist=twist)


def twist_to_msg(twist: Twist) -> TwistWithCovariance:
    """Return geometry_msgs/TwistWithCovariance."""
    message = TwistWithCovariance(covariance=twist.covariance.ravel())
    message.twist.linear, message.twist.angular = Vector3(**_xyz(twist.linear)), Vector3(**_xyz(twist.angular))
    return message


def pose_with_covariance_to_msg(pose: PoseEstimate, *, frame_id: str) -> PoseWithCovarianceStamped:
    """Return geometry_msgs/PoseWithCovarianceStamped."""
    return PoseWithCovarianceStamped(header=header(pose.stamp_ns, frame_id), pose=_with_covariance(pose))


def _with_covariance(pose: PoseEstimate) -> PoseWithCovariance:
    return PoseWithCovariance(pose=pose_to_msg(pose.T_map_body), covariance=pose.covariance.ravel())


def odometry_from_msg(message: Odometry) -> PoseEstimate:
    """Return pose and covariance of nav_msgs/Odometry."""
    covariance = _finite(message.pose.covariance, "pose.covariance").reshape(6, 6)
    return PoseEstimate(stamp_ns_of(message), pose_from_msg(message.pose.pose), covariance)


def joint_to_msg(joint: JointInformation, *, frame_id: str) -> JointInformationMsg:
    """Return the message; only the upper triangle of the information matrix is sent."""
    return JointInformationMsg(
        header=header(joint.stamp_ns, frame_id),
        vehicle=joint.vehicle,
        session=joint.session,
        pose=pose_to_msg(joint.T_map_body),
        ids=flat(joint.ids),
        positions=flat(joint.positions),
        information=flat(joint.information[np.triu_indices(len(joint.information))]),
        descriptor_size=joint.descriptors.shape[1],
        descriptors=flat(joint.descriptors),
        prior_id=joint.prior_id,
        sources=list(joint.other_sources),
    )


def joint_from_msg(message: JointInformationMsg) -> JointInformation:
    """Return the own belief over pose and landmarks."""
    ids = np.array(message.ids, dtype=np.uint32)
    n = 6 + 3 * len(ids)
    upper = np.array(message.information, dtype=float)
    if len(upper) != n * (n + 1) // 2:
        raise InvalidMessage("shape", f"{len(ids)} landmarks need {n * (n + 1) // 2} numbers, not {len(upper)}")
    positions = rows_of(message.positions, np.float64, 3, "positions")
    descriptors = rows_of(message.descriptors, np.uint8, message.descriptor_size, "descriptors")
    if not len(ids) == len(positions) == len(descriptors):
        raise InvalidMessage("shape", f"{len(ids)} ids, {len(positions)} positions, {len(descriptors)} descriptors")
    information = np.zeros((n, n))
    information[np.triu_indices(n)] = _finite(upper, "information")
    return JointInformation(
        stamp_ns=stamp_ns_of(message),
        vehicle=message.vehicle,
        session=int(message.session),
        T_map_body=pose_from_msg(message.pose),
        ids=ids,
        positions=_finite(positions, "positions"),
        information=information + np.triu(information, 1).T,
        descriptors=descriptors,
        prior_id=message.prior_id,
        other_sources=tuple(message.sources),
    )


def cloud_to_msg(points: Array, *, stamp_ns: int, frame_id: str, bgr: NDArray[np.uint8] | None = None) -> PointCloud2:
    """Return (N, 3) points as an x, y, z float32 cloud; with (N, 3) colours, also rgb as RViz and Foxglove read it.

    RViz draws no float64 clouds (`XYZPCTransformer::supports`).
    """
    data = np.ascontiguousarray(points, dtype=np.float32).view(np.uint8).reshape(-1, 12)
    names = ["x", "y", "z"]
    if bgr is not None:
        names.append("rgb")  # a float32 whose bytes are b, g, r, 0
        data = np.hstack([data, bgr, np.zeros((len(bgr), 1), np.uint8)])
    return PointCloud2(
        header=header(stamp_ns, frame_id),
        height=1,
        width=len(data),
        fields=[PointField(name=n, offset=4 * k, datatype=PointField.FLOAT32, count=1) for k, n in enumerate(names)],
        point_step=4 * len(names),
        row_step=4 * len(names) * len(data),
        data=flat(data.ravel()),
        is_dense=True,
    )


def _xyz(vector: Array) -> dict[str, float]:
    x, y, z = (float(v) for v in vector)
    return {"x": x, "y": y, "z": z}


def _finite(values: Any, what: str) -> Array:
    out = np.asarray(values, dtype=float)
    if not np.isfinite(out).all():
        raise InvalidMessage("not_finite", f"{what} holds NaN or infinity")
    return out


def _positive(value: float, what: str) -> float:
    if not 0.0 < value < float("inf"):
        raise InvalidMessage("not_positive", f"{what} is {value:g}")
    return value


def rows_of(values: Any, dtype: Any, columns: int, what: str) -> NDArray[Any]:
    """Reshape a flat array to rows of `columns` numbers.

    Raises:
        InvalidMessage: it does not hold whole rows.
    """
    data = np.array(values, dtype=dtype)
    if columns == 0 or data.size % columns:
        if data.size == 0:
            return data.reshape(0, columns)
        raise InvalidMessage("shape", f"{what} holds {data.size} numbers, not a multiple of {columns}")
    return data.reshape(-1, columns)
