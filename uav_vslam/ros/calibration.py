# SPDX-License-Identifier: Apache-2.0
"""The place and calibration of a vehicle's sensors, from calibration files, camera_info and /tf_static."""

import dataclasses
from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np
from rclpy.callback_groups import CallbackGroup
from sensor_msgs.msg import CameraInfo, Imu
from tf2_msgs.msg import TFMessage

from uav_vslam.datasets.frame_tree import SAME_PLACE, Edge
from uav_vslam.datasets.messages import transforms_of
from uav_vslam.datasets.sensor_setup import SensorSetup
from uav_vslam.errors import CalibrationError, InvalidMessage
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.geometry.stereo import SIDES, StereoRig
from uav_vslam.ins.mounting import ImuMounting
from uav_vslam.ros.convert import imu_from_data
from uav_vslam.ros.qos import LATCHED_BY_MANY, SENSOR, STATE
from uav_vslam.ros.vehicle_node import VehicleNode
from uav_vslam.types import NS_PER_S, ImuSample

MAX_WAITING = 2000  # readings held until the place of the IMU is known
LATE_S = 2.0  # time of such readings after which its transform is missed: static ones come with the nodes
MISSING = "transform"  # key in diagnostics of transforms that are still missing
PUBLISH = "publish it there (/tf is not read), or set input.frames"
CHANGED = "calibration"  # key of the failure that the calibration received is not the one in use


class RigListener:
    """Collects calibration and extrinsics; `rig` is None until complete, then `on_complete` is called once.

    Where calibration files hold all, it is complete from the start, and nothing is called.
    Topics are not ordered among each other: images may arrive before their calibration.
    A calibration that changes afterwards is a failure of the node, and used only after `restart`.

    Attributes:
        setup: what was received.
        rig: the one in use.
    """

    def __init__(self, node: VehicleNode, on_complete: Callable[[], None] = lambda: None) -> None:
        self._node, self._on_complete = node, on_complete
        self.setup = SensorSetup.of(node.vehicle, node.config.input)
        self._received: dict[str, tuple[object, ...]] = {}  # by each camera's newest camera_info
        if self.setup.needs_infos:
            for side in SIDES:
                topic = getattr(node.config.input.topics, f"{side}_info")
                node.listen(CameraInfo, topic, partial(self._on_camera, side), STATE)
        if self.setup.needs_frames:
            node.listen(TFMessage, "/tf_static", self._on_transforms, LATCHED_BY_MANY)
        self.rig = self._assembled()

    @property
    def missing(self) -> str:
        """Reason for the missing rig, in words; empty once it is complete."""
        if self.rig is not None:
            return ""
        if sides := self.setup.missing_infos:
            return f"there is no valid camera_info of the {' and the '.join(sides)} camera"
        return f"/tf_static has no {', '.join(self.setup.missing_transforms())}; {PUBLISH}{_likely_base(self.setup)}"

    def left_frame(self, of_images: str) -> str:
        """Return the frame of the left camera; where nothing else names it, that of its images."""
        return (self.setup.camera_frame("left") or of_images).lstrip("/")

    def restart(self) -> None:
        """Use the newest calibration, if it can be used."""
        self.rig = self._newest() or self.rig
        if self.rig is not None:
            self._follow()

    def _on_camera(self, side: str, message: CameraInfo) -> None:
        content = _content(message)
        if self._received.get(side) == content and side in self.setup.cameras:
            return
        try:
            self.setup.add_camera(side, message)
        except CalibrationError as error:
            raise InvalidMessage("calibration", str(error)) from None
        self._received[side] = content
        self._follow()

    def _on_transforms(self, message: TFMessage) -> None:
        self.setup.frames.add(_valid_edges(self._node, message))
        self._follow()

    def _follow(self) -> None:
        """Complete the rig, or report that another one than that in use was received."""
        if self.rig is None:
            self.rig = self._assembled()
            if self.rig is not None:
                self._on_complete()
            return
        fault = self._fault(self.rig)
        if fault != self._node.failures.get(CHANGED):
            self._node.report_failure(CHANGED, "")  # so that it is logged: the one before may be half of a change
        self._node.report_failure(CHANGED, fault)

    def _fault(self, used: StereoRig) -> str:
        """Return how the newest calibration differs from the one in use, in a line; empty if it does not."""
        if self.setup.missing_infos:
            return ""
        try:
            changes = _changes(used, self.setup.rig())
        except CalibrationError as error:
            return f"the calibration has changed to one that can't be used: {error}"
        return f"the calibration has changed and is used only after a reset of all nodes: {changes}" if changes else ""

    def _newest(self) -> StereoRig | None:
        if self.setup.missing_infos or self.setup.missing_transforms():
            return None
        try:
            return self.setup.rig()
        except CalibrationError:
            return None

    def _assembled(self) -> StereoRig | None:
        """Return the first rig, once it is complete.

        Raises:
            InvalidMessage: what was received can't be one.
        """
        if self.setup.missing_infos:
            return None
        missing = self.setup.missing_transforms()
        if missing:
            self._node.notes[MISSING] = f"/tf_static has no {', '.join(missing)}"
            return None
        self._node.notes.pop(MISSING, None)
        try:
            rig = self.setup.rig()
        except CalibrationError as error:
            self.setup.cameras.clear()  # later ones may be valid
            raise InvalidMessage("calibration", str(error)) from None
        self._node.get_logger().info(f"rig complete: baseline {rig.baseline_m:.3f} m")
        return rig


def _likely_base(setup: SensorSetup) -> str:
    """Return the setting that names the body, to follow `PUBLISH`; empty where none of the frames would do."""
    return f".base: {setup.likely_base}" if setup.likely_base else ""


def _valid_edges(node: VehicleNode, message: TFMessage) -> list[Edge]:
    edges, faults = transforms_of(message)
    for fault in faults:
        node.drop("transform", fault)
    return edges


def _content(info: CameraInfo) -> tuple[object, ...]:
    """Return what of a camera_info makes a calibration."""
    matrices = (bytes(matrix) for matrix in (info.k, info.d, info.r, info.p))
    roi = info.roi
    window = roi.x_offset, roi.y_offset, roi.width, roi.height, info.binning_x, info.binning_y
    return info.header.frame_id, info.width, info.height, info.distortion_model, *window, *matrices


def _changes(used: StereoRig, newest: StereoRig) -> str:
    """Return in words how a rig differs from the one in use; empty if it does not."""
    changes = []
    for side in SIDES:
        before, now = getattr(used, side), getattr(newest, side)
        if not all(np.array_equal(getattr(before, f.name), getattr(now, f.name)) for f in dataclasses.fields(before)):
            changes.append(f"{side} camera {_in_words(now)}, in use {_in_words(before)}")
    places = (used.T_body_left, newest.T_body_left), (used.T_body_right, newest.T_body_right)
    if not all(np.allclose(before.matrix, now.matrix, atol=SAME_PLACE) for before, now in places):
        changes.append(f"places of the cameras, baseline {newest.baseline_m:.4f} m, in use {used.baseline_m:.4f} m")
    return "; ".join(changes)


def _in_words(camera: PinholeCamera) -> str:
    """Return the calibration of a camera in a line."""
    focal, centre = (f"{x:.2f}, {y:.2f}" for x, y in ((camera.fx, camera.fy), (camera.cx, camera.cy)))
    lens = ", ".join(f"{value:.4g}" for value in camera.distortion)
    return f"{camera.width}x{camera.height} px, f ({focal}), centre ({centre}), {camera.model} ({lens})"


class ImuListener:
    """Finds out where the IMU is; readings wait until then.

    A place that changes afterwards is a failure of the node, and used only after `restart`.

    Attributes:
        setup: what was received.
    """

    def __init__(self, node: VehicleNode, on_reading: Callable[[ImuSample], None], group: CallbackGroup) -> None:
        """Set up.

        Args:
            node: owner.
            on_reading: gets each reading as of the body's origin and axes, in order of arrival.
            group: of the readings.
        """
        self._node, self._on_reading = node, on_reading
        self.setup = SensorSetup.of(node.vehicle, node.config.input)
        self._mounting: ImuMounting | None = None
        self._used = Pose.identity()  # pose in the body, if there is a mounting
        self._frame = ""  # of the newest reading
        self._waiting: deque[ImuSample] = deque()
        self._readings = node.listen(Imu, node.config.input.topics.imu, self._on_imu, SENSOR, raw=True, group=group)
        if self.setup.needs_imu_frame:
            node.listen(TFMessage, "/tf_static", self._on_transforms, LATCHED_BY_MANY)

    def restart(self) -> None:
        """Find out again where the IMU is."""
        self._mounting = None
        self._node.failures.pop(CHANGED, None)
        self._node.alarms.pop("imu_frame", None)

    def take_readings(self) -> None:
        """Take the readings that wait."""
        self._readings.take_waiting(self._node)

    def _on_imu(self, data: bytes) -> None:
        reading, frame = imu_from_data(data)
        if self._mounting is not None:
            if frame != self._frame:
                self._report_frame(frame)
            self._on_reading(self._mounting.to_body(reading))
            return
        self.setup.imu_frame = self._frame = frame
        self._waiting.append(reading)
        self._locate()

    def _report_frame(self, frame: str) -> None:
        """Warn of readings of another frame than the first ones'."""
        self._frame = frame
        was = self.setup.imu_frame
        text = f"IMU readings are of {frame or 'no frame'} now, and taken for those of {was or 'no frame'} as before"
        self._node.report_alarm("imu_frame", text if frame != was else "")
        self._node.get_logger().warning(text)

    def _on_transforms(self, message: TFMessage) -> None:
        self.setup.frames.add(_valid_edges(self._node, message))  # in flight too: start states may be of any frame
        if self._mounting is not None:
            self._node.report_failure(CHANGED, self._fault())
        elif self._waiting:
            self._locate()

    def _fault(self) -> str:
        """Return how the newest place of the IMU differs from the one in use, in a line; empty if it does not."""
        try:
            place = self.setup.T_body_imu()
        except CalibrationError as error:
            return f"the place of the IMU has changed to one that can't be used: {error}"
        if np.allclose(place.matrix, self._used.matrix, atol=SAME_PLACE):
            return ""
        moved_m = np.linalg.norm(place.t - self._used.t)
        turned_deg = np.rad2deg(np.linalg.norm(so3_log(self._used.R.T @ place.R)))
        return (
            f"the place of the IMU has changed and is used only after a reset of all nodes: moved by {moved_m:.3f} m, "
            f"turned by {turned_deg:.2f} deg"
        )

    def _locate(self) -> None:
        """Go on with the readings that wait, if the place of the IMU is known.

        Raises:
            InvalidMessage: it is not, and the oldest reading is dropped.
        """
        missing = ", ".join(self.setup.missing_imu_transforms())
        if missing:
            self._node.notes[MISSING] = f"/tf_static has no {missing}"
            too_many = len(self._waiting) > MAX_WAITING
            text = f"/tf_static has no {missing}, the IMU's frame; {PUBLISH}{_likely_base(self.setup)}"
            if too_many or self._waiting[-1].stamp_ns - self._waiting[0].stamp_ns > LATE_S * NS_PER_S:
                self._node.report_failure(MISSING, text)
            if too_many:
                self._waiting.popleft()
                raise InvalidMessage("imu_frame", text)
            return
        self._node.notes.pop(MISSING, None)
        self._node.failures.pop(MISSING, None)
        if self.setup.imu_unnamed:
            self._node.get_logger().warning("IMU messages have no frame_id: the IMU counts as the body")
        self._used = self.setup.T_body_imu()
        self._mounting = ImuMounting(self._used)
        while self._waiting:
            try:
                self._on_reading(self._mounting.to_body(self._waiting.popleft()))
            except InvalidMessage as error:
                self._node.drop(error.reason, str(error))
