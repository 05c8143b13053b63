# SPDX-License-Identifier: Apache-2.0
"""The place and calibration of a vehicle's sensors, from calibration files, camera_info and /tf_static."""

from collections.abc import Callable
from functools import partial

from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

from uav_vslam.datasets.messages import transforms_of
from uav_vslam.datasets.sensor_setup import SIDES, SensorSetup
from uav_vslam.errors import CalibrationError, InvalidMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ros.convert import camera_from_msg
from uav_vslam.ros.qos import LATCHED_BY_MANY, STATE
from uav_vslam.ros.runtime import VehicleNode

MISSING = "transform"  # key in diagnostics of transforms that are still missing


class RigListener:
    """Collects calibration and extrinsics; `rig` is None until complete, then `on_complete` is called once.

    Where calibration files tell all, it is complete from the start, and nothing is called.
    Topics are not ordered among each other: images may arrive before their calibration.
    """

    def __init__(self, node: VehicleNode, on_complete: Callable[[], None]) -> None:
        self._node, self._on_complete = node, lambda: None
        self._setup = SensorSetup.of(node.vehicle, node.config.input)
        self.rig: StereoRig | None = None
        if self._setup.needs_infos:
            for side in SIDES:
                topic = getattr(node.config.input.topics, f"{side}_info")
                node.listen(CameraInfo, topic, partial(self._on_camera, side), STATE)
        if self._setup.needs_frames:
            node.listen(TFMessage, "/tf_static", self._on_transforms, LATCHED_BY_MANY)
        self._assemble()
        self._on_complete = on_complete

    @property
    def time_offset_ns(self) -> int:
        """IMU time minus image stamp [ns]."""
        return self._setup.time_offset_ns

    @property
    def left_frame(self) -> str:
        """Frame of the left camera, empty until known."""
        return self._setup.camera_frame("left")

    def _on_camera(self, side: str, message: CameraInfo) -> None:
        if side not in self._setup.cameras:
            self._setup.cameras[side] = (camera_from_msg(message), message.header.frame_id)
            self._assemble()

    def _on_transforms(self, message: TFMessage) -> None:
        self._setup.frames.add(transforms_of(message))
        self._assemble()

    def _assemble(self) -> None:
        if self.rig is not None or self._setup.missing_infos:
            return
        missing = self._setup.missing_transforms()
        if missing:
            self._node.notes[MISSING] = f"/tf_static has no {', '.join(missing)}"
            return
        self._node.notes.pop(MISSING, None)
        try:
            self.rig = self._setup.rig()
        except CalibrationError as error:
            self._setup.cameras.clear()  # later ones may be valid
            raise InvalidMessage("calibration", str(error)) from None
        self._node.get_logger().info(f"rig complete: baseline {self.rig.baseline_m:.3f} m")
        self._on_complete()


class ImuListener:
    """Finds out where the IMU is; readings are of no use before."""

    def __init__(self, node: VehicleNode) -> None:
        self._node = node
        self._setup = SensorSetup.of(node.vehicle, node.config.input)
        self._listens = False

    @property
    def time_offset_ns(self) -> int:
        """IMU time minus image stamp [ns]."""
        return self._setup.time_offset_ns

    @property
    def has_infos(self) -> bool:
        """Whether camera_info is expected: if the calibration files tell all, cameras need not publish it."""
        return self._setup.needs_infos

    def locate(self, frame_id: str) -> Pose:
        """Return T_body_imu for readings in a frame.

        Raises:
            InvalidMessage: the frame is not connected to the body, so far.
        """
        self._setup.imu_frame = frame_id
        missing = ", ".join(self._setup.missing_imu_transforms())
        if missing and not self._listens:
            self._listens = True
            self._node.listen(TFMessage, "/tf_static", self._on_transforms, LATCHED_BY_MANY)
        if missing:
            self._node.notes[MISSING] = text = f"/tf_static has no {missing}"
            raise InvalidMessage("imu_frame", f"{text}, the IMU's frame; publish it, or set input.frames")
        self._node.notes.pop(MISSING, None)
        return self._setup.T_body_imu()

    def _on_transforms(self, message: TFMessage) -> None:
        self._setup.frames.add(transforms_of(message))
