# SPDX-License-Identifier: Apache-2.0
"""Where a vehicle's sensor data and calibration come from."""

from dataclasses import dataclass, field
from pathlib import Path

from uav_vslam.config.settings import Settings, refuse, setting

COMPRESSED = "/compressed"
TIME_JUMPS = ("bridge", "reset", "refuse")


def image_names(topic: str) -> tuple[str, ...]:
    """Return the names under which a camera's images may come: raw, and compressed by convention."""
    return (topic,) if topic.endswith(COMPRESSED) else (topic, topic + COMPRESSED)


@dataclass(frozen=True, slots=True)
class TopicsConfig(Settings):
    """Topics of a vehicle; relative names are below its namespace, absolute ones begin with a slash."""

    left: str = setting(
        "left/image_raw", "left image; with /compressed appended, sensor_msgs/CompressedImage is read as well"
    )
    right: str = setting("right/image_raw", "right image, raw or compressed as the left one")
    left_info: str = setting("left/camera_info", "calibration of the left camera")
    right_info: str = setting("right/camera_info", "calibration of the right camera")
    imu: str = setting("imu/data_raw", "IMU readings")
    accel: str = setting(
        "",
        "accelerometer readings, where they are recorded on a topic of their own: `imu` is then that of the gyroscope. "
        "Of recordings alone: a live driver has to unite them (RealSense: unite_imu_method: 2)",
    )
    initial_state: str = setting("initial_state", "start state")
    truth: str = setting(
        "ground_truth/odometry",
        "ground truth, offline only: Odometry, PoseStamped, PoseWithCovarianceStamped or TransformStamped",
    )


@dataclass(frozen=True, slots=True)
class FramesConfig(Settings):
    """Names of frames in /tf_static; those of sensors replace what their messages have in header.frame_id."""

    base: str = setting(
        "",
        "body frame of the vehicle; empty: VEHICLE/base_link. With calibration files that place the cameras the body "
        "is theirs, unless this and `imu` are both set: /tf_static then places the IMU",
    )
    imu: str = setting("", "frame of the IMU; empty: as in its messages")
    left: str = setting("", "optical frame of the left camera; empty: as in its camera_info")
    right: str = setting("", "optical frame of the right camera; empty: as in its camera_info")


@dataclass(frozen=True, slots=True)
class InputConfig(Settings):
    """Where a vehicle's sensor data and calibration come from."""

    calibration: tuple[Path, ...] = setting(
        (),
        "calibration files of Kalibr, OpenVINS, ORB-SLAM3, VINS-Fusion, ROS or EuRoC, relative to the configuration "
        "file; what they hold is not taken from camera_info and /tf_static",
    )
    cameras: tuple[str, ...] = setting(
        (), "left and right camera by their names in a Kalibr camchain, such as cam1, cam3; empty: there are two"
    )
    rectified: bool = setting(
        False, "images are rectified (image_rect): P and R of camera_info count instead of K and D"
    )
    pair_tolerance_s: float = setting(
        0.0,
        "largest difference between the stamps of an image pair; 0: half of the median frame period, at most 0.02",
        unit="s",
        at_least=0,
    )
    on_time_jump: str = setting(
        "bridge",
        "when the clock of the sensors jumps. bridge: go on with unknown motion in between; reset: start again as "
        "start.method says; refuse: use no message until the stamps are right again",
        choices=TIME_JUMPS,
    )
    topics: TopicsConfig = field(default_factory=TopicsConfig)
    frames: FramesConfig = field(default_factory=FramesConfig)

    def _check_together(self) -> None:
        if self.cameras and not self.calibration:
            refuse("cameras", list(self.cameras), "none where input.calibration names no file that has cameras")

    def topic(self, vehicle: str, role: str) -> str:
        """Return the absolute name of a vehicle's topic; `role` is a field of `TopicsConfig`."""
        name: str = getattr(self.topics, role)
        return name if name.startswith("/") else f"/{vehicle}/{name}"

    def gyro_topics(self, vehicle: str) -> dict[str, str]:
        """Return the gyroscope's topic by the accelerometer's, if a vehicle's has one of its own; otherwise nothing."""
        return {self.topic(vehicle, "accel"): self.topic(vehicle, "imu")} if self.topics.accel else {}

    def base_frame(self, vehicle: str) -> str:
        """Return the name of the vehicle's body frame."""
        return self.frames.base or f"{vehicle}/base_link"
