# SPDX-License-Identifier: Apache-2.0
"""A vehicle's sensors in its body: from calibration files, and what these do not hold from messages.

The bag reader and the nodes collect messages in their own way; what follows from them is decided here.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from uav_vslam.config import InputConfig, VehicleConfig, differences, replaced
from uav_vslam.config.input import COMPRESSED
from uav_vslam.datasets.calibration_files import read_calibration
from uav_vslam.datasets.camera_calibration import Calibration
from uav_vslam.datasets.frame_tree import SAME_PLACE, FrameTree
from uav_vslam.datasets.messages import T_pair_cam_of, camera_of, rectified_camera_of
from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.geometry.stereo import MIN_BASELINE_M, SIDES, StereoRig
from uav_vslam.types import NS_PER_S

SAME_AXES_DEG = 0.5  # between two sensors that count as one


@dataclass(slots=True)
class SensorSetup:
    """What is known of a vehicle's sensors so far.

    Attributes:
        vehicle: name.
        config: of its input.
        files: content of the calibration files.
        frames: static frames received.
        cameras: calibration and frame of each side received, by side; see `add_camera`.
        imu_frame: header.frame_id of the IMU's messages; None before the first.
    """

    vehicle: str
    config: InputConfig
    files: Calibration
    frames: FrameTree = field(default_factory=FrameTree)
    cameras: dict[str, tuple[PinholeCamera, str]] = field(default_factory=dict)
    _T_pair_cam: dict[str, Pose | None] = field(default_factory=dict)  # as P and R of camera_info place the cameras
    _T_cam_images: dict[str, Pose] = field(default_factory=dict)  # axes of the images, if they are rectified
    imu_frame: str | None = None
    _distorted: set[str] = field(default_factory=set)  # sides whose camera_info has lens distortion

    @classmethod
    def of(cls, vehicle: str, config: InputConfig) -> "SensorSetup":
        """Read the calibration files.

        Raises:
            CalibrationError: one can't be read.
        """
        return cls(vehicle, config, read_calibration(config.calibration, config.cameras))

    def add_camera(self, side: str, info: Any) -> None:
        """Take the calibration of a camera's images from its CameraInfo: K and D, or P and R of rectified ones.

        Raises:
            CalibrationError: it is not filled in, or its lens is not supported.
        """
        self._distorted = self._distorted - {side} | ({side} if np.any(info.d) else set())
        if self.config.rectified:
            camera, self._T_cam_images[side] = rectified_camera_of(info)
        else:
            camera = camera_of(info)
        self._T_pair_cam[side] = T_pair_cam_of(info, rectified=self.config.rectified)
        self.cameras[side] = camera, info.header.frame_id

    @property
    def time_offset_ns(self) -> int:
        """IMU time minus image stamp [ns]."""
        return round(self.files.time_offset_s * NS_PER_S)

    @property
    def missing_infos(self) -> list[str]:
        """Sides whose camera_info is still needed, for the intrinsics or for the name of the frame."""
        return [side for side in SIDES if self._needs_info(side) and side not in self.cameras]

    @property
    def needs_infos(self) -> bool:
        """Whether the calibration files and settings leave anything to camera_info."""
        return any(self._needs_info(side) for side in SIDES)

    @property
    def needs_frames(self) -> bool:
        """Whether the calibration files leave the place of a sensor to /tf_static."""
        return bool(self._unplaced_frames())

    @property
    def needs_imu_frame(self) -> bool:
        """Whether the calibration files leave the place of the IMU to /tf_static, should it not be the body."""
        return not self._imu_in_files or self._base_named

    def camera_frame(self, side: str) -> str:
        """Return the name of a camera's frame; empty while unknown."""
        override: str = getattr(self.config.frames, side)
        return override or (self.cameras[side][1] if side in self.cameras else "")

    def missing_transforms(self) -> list[str]:
        """Return what /tf_static still has to connect, in words."""
        return self._unconnected(self._unplaced_frames())

    @property
    def likely_base(self) -> str:
        """The frame to name as the body where /tf_static connects all sensors, but has no such body; else empty."""
        base, frames = self.config.base_frame(self.vehicle), self._unplaced_frames()
        return "" if base in self.frames or base in frames else self.frames.body_of(frames)

    def camera(self, index: int) -> PinholeCamera:
        """Return the intrinsics of a camera, 0 for the left one.

        Raises:
            CalibrationError: they are unknown.
        """
        if index < len(self.files.cameras):
            return self.files.cameras[index].camera
        if SIDES[index] not in self.cameras:
            raise CalibrationError(f"no camera_info of the {SIDES[index]} camera, and no file has its calibration")
        return self.cameras[SIDES[index]][0]

    def rig(self) -> StereoRig:
        """Return the stereo rig.

        Raises:
            CalibrationError: a camera is unknown or not connected to the body, or the cameras contradict each other.
        """
        if self.shares_frame and self.T_left_right_of_infos is None:
            raise CalibrationError(
                f"both cameras have the frame {self.camera_frame('left')!r}, and P of camera_info no baseline: "
                "name the right one's by input.frames.right, or give a file with input.calibration"
            )
        left, right = (self.camera(k) for k in range(len(SIDES)))
        T_body_left, T_body_right = (self._T_body_cam(k) for k in range(len(SIDES)))
        return StereoRig(left, right, T_body_left, T_body_right)

    @property
    def rectified_twice(self) -> str:
        """Why points would be undistorted that are so already, by their topics' names; empty if they would not."""
        for index, side in enumerate(SIDES):
            topic, unknown = self.config.topic(self.vehicle, side), side in self.missing_infos
            if unknown or self.config.rectified or not _is_named_rectified(topic):
                continue
            if self.camera(index).distortion.any():
                remedy = "give files of rectified images" if self.files.cameras else "set input.rectified: true"
                return f"{topic} is rectified by its name, and the calibration has lens distortion: {remedy}"
        return ""

    @property
    def lens_doubt(self) -> str:
        """Why points would be undistorted twice, or not at all, by their topics' names; empty if they would not."""
        return self.rectified_twice or self._never_rectified()

    def _never_rectified(self) -> str:
        if not self.config.rectified or self.files.cameras:
            return ""
        for side in SIDES:
            topic = self.config.topic(self.vehicle, side)
            if side in self._distorted and "raw" in _words(topic) and not _is_named_rectified(topic):
                return (
                    f"{topic} is raw by its name, and its lens has distortion, which input.rectified: true leaves in "
                    "it: set that to false, or name the rectified images"
                )
        return ""

    @property
    def T_left_right_of_infos(self) -> Pose | None:
        """Pose of the right camera in the left one as P of their camera_info has it; None if that has no baseline."""
        left, right = (self._T_pair_cam.get(side) for side in SIDES)
        T_left_right = left.inverse() @ right if left is not None and right is not None else None
        return T_left_right if T_left_right and np.linalg.norm(T_left_right.t) >= MIN_BASELINE_M else None

    @property
    def shares_frame(self) -> bool:
        """Whether both cameras have one frame, the left one's, as stereo drivers set it: P has the baseline."""
        return not self._in_files(1) and self.camera_frame("left") == self.camera_frame("right")

    def T_body_imu(self) -> Pose:
        """Return the pose of the IMU: of the files, or of its frame, which is the body's if it has no name.

        Raises:
            CalibrationError: the frame is not connected to the body.
        """
        if self._imu_in_files:
            return self._T_body_files() @ self._T_files_imu()
        if not self._imu_frames():
            return Pose.identity()
        return self.frames.find(self.config.base_frame(self.vehicle), self._imu_frame)

    def missing_imu_transforms(self) -> list[str]:
        """Return what /tf_static still has to connect for the IMU, in words."""
        return self._unconnected(self._imu_frames())

    def turned_accel(self, frame: str) -> str:
        """Return how the axes of an accelerometer's frame differ from the gyroscope's; empty if they do not."""
        gyro = self._imu_frame
        if not frame or not self.frames.connected(gyro, frame):
            return ""
        angle_deg = np.rad2deg(np.linalg.norm(so3_log(self.frames.find(gyro, frame).R)))
        return f"{frame} is turned by {angle_deg:.1f} deg against {gyro}" if angle_deg > SAME_AXES_DEG else ""

    def conflict(self, frame: str) -> str:
        """Return why a state or truth of a frame is not one of the body, empty if it is or nothing is known of it."""
        frame = frame.lstrip("/")
        if not self._cameras_in_files or self._base_named:
            return self._apart(frame) if frame else ""
        if not (frame and self._imu_frame):
            return ""
        if frame in (self._imu_frame, self.config.frames.base):
            return ""
        return (
            f"is of {frame}, but the calibration files make the IMU, {self._imu_frame}, the body; if /tf_static "
            f"connects them, set input.frames.base: {frame} and input.frames.imu: {self._imu_frame}"
        )

    def unplaced(self, frame: str) -> str:
        """Return why it is not known whether a state of a frame is one of the body, empty if it is known."""
        frame, base = frame.lstrip("/"), self.config.base_frame(self.vehicle)
        in_files = self._cameras_in_files and not self._base_named  # `conflict` then judges by names
        if not frame or in_files or self.frames.connected(base, frame):
            return ""
        return (
            f"is of {frame}, which /tf_static does not connect with the body, {base}, and is taken for the body's: "
            f"give it for {base}, or set input.frames.base: {frame}"
        )

    def _apart(self, frame: str) -> str:
        """Return where /tf_static has a frame, if it is not where the body is."""
        base = self.config.base_frame(self.vehicle)
        if not self.frames.connected(base, frame):
            return ""
        T_base_frame = self.frames.find(base, frame)
        if np.allclose(T_base_frame.matrix, np.eye(4), atol=SAME_PLACE):
            return ""
        return (
            f"is of {frame}, which /tf_static places elsewhere than the body, {base}: give it for {base}, or set "
            f"input.frames.base: {frame}"
        )

    @property
    def imu_unnamed(self) -> bool:
        """Whether nothing places the IMU, so that it counts as the body."""
        return not self._imu_frame and not self._imu_in_files

    @property
    def _imu_frame(self) -> str:
        return (self.config.frames.imu or self.imu_frame or "").lstrip("/")

    @property
    def _cameras_in_files(self) -> bool:
        return self.files.T_body_cam(0) is not None

    @property
    def _imu_in_files(self) -> bool:
        """Whether the files place the IMU: it is their body unless they say otherwise."""
        return self._cameras_in_files or self.files.T_body_imu is not None

    @property
    def _base_named(self) -> bool:
        """Whether the body is another frame than that of the files, to which /tf_static connects their IMU."""
        return bool(self.config.frames.base and self.config.frames.imu)

    def _unplaced_frames(self) -> list[str]:
        """Return the frames of the sensors that the files do not place."""
        frames = [self.camera_frame(side) for k, side in enumerate(SIDES) if not self._in_files(k)]
        return frames + self._imu_frames()

    def _imu_frames(self) -> list[str]:
        if not self.needs_imu_frame:
            return []
        return [] if self._imu_frame in ("", self.config.base_frame(self.vehicle)) else [self._imu_frame]

    def _T_files_imu(self) -> Pose:
        return self.files.T_body_imu or Pose.identity()

    def _T_body_files(self) -> Pose:
        """Return the pose of the files' body in the vehicle's."""
        if not self._imu_frames():
            return Pose.identity()
        T_body_imu = self.frames.find(self.config.base_frame(self.vehicle), self._imu_frame)
        return T_body_imu @ self._T_files_imu().inverse()

    def _unconnected(self, frames: Iterable[str]) -> list[str]:
        base = self.config.base_frame(self.vehicle)
        unknown = [frame for frame in frames if not self.frames.connected(base, frame)]
        unnamed = "a camera without camera_info" if self.missing_infos else "a camera whose camera_info has no frame_id"
        return [f"{base} -> {frame or unnamed}{self._loop_in_words(frame)}" for frame in dict.fromkeys(unknown)]

    def _loop_in_words(self, frame: str) -> str:
        loop = self.frames.loop(frame)
        return f" without a loop (each is the child of the next: {', '.join(loop)})" if loop else ""

    def _needs_info(self, side: str) -> bool:
        index = SIDES.index(side)
        frame_unknown = not self._in_files(index) and not getattr(self.config.frames, side)
        return index >= len(self.files.cameras) or frame_unknown

    def _in_files(self, index: int) -> bool:
        """Return whether the files place a camera, in the body or relative to the left one."""
        return self.files.T_body_cam(index) is not None or (index > 0 and self._T_left_right() is not None)

    def _T_left_right(self) -> Pose | None:
        return self.files.cameras[1].T_left_cam if len(self.files.cameras) > 1 else None

    def _T_body_cam(self, index: int) -> Pose:
        known, T_left_right = self.files.T_body_cam(index), self._T_left_right()
        if known is not None:
            return self._T_body_files() @ known
        if index > 0 and T_left_right is not None:
            return self._T_body_cam(0) @ T_left_right
        if index > 0 and self.shares_frame and self.T_left_right_of_infos is not None:
            return self._T_body_cam(0) @ self.T_left_right_of_infos
        T_body_cam = self.frames.find(self.config.base_frame(self.vehicle), self.camera_frame(SIDES[index]))
        return T_body_cam @ self._T_cam_images.get(SIDES[index], Pose.identity())


def with_noise_of_files(config: VehicleConfig) -> VehicleConfig:
    """Return the configuration with the IMU noise of its calibration files, where it does not set its own.

    Raises:
        CalibrationError: a file can't be read.
    """
    noise = read_calibration(config.input.calibration, config.input.cameras).noise
    own = differences(config)
    return replaced(config, {k: v for k, v in noise.items() if k not in own}, where="input.calibration")


def _words(topic: str) -> list[str]:
    """Return the words of an image topic's last name."""
    return topic.removesuffix(COMPRESSED).rsplit("/", 1)[-1].split("_")


def _is_named_rectified(topic: str) -> bool:
    return any(word.startswith("rect") for word in _words(topic))
