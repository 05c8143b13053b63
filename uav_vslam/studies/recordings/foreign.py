# SPDX-License-Identifier: Apache-2.0
"""Turns one of our recordings into one as from elsewhere: other topics, frames, clocks, and calibration in a file."""

import dataclasses
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from uav_vslam.config.input import TopicsConfig
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import RawMessage, decode, encode
from uav_vslam.datasets.kalibr_camchain import camchain
from uav_vslam.datasets.message_builders import transforms_message
from uav_vslam.datasets.rosbag import iter_raw, topics_of
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NS_PER_S

Change = Callable[[RawMessage], RawMessage | None]

NAMES = {
    "/uav1/left/image_raw": "/camera/infra1/image_rect_raw",
    "/uav1/right/image_raw": "/camera/infra2/image_rect_raw",
    "/uav1/left/camera_info": "/camera/infra1/camera_info",
    "/uav1/right/camera_info": "/camera/infra2/camera_info",
    "/uav1/imu/data_raw": "/imu",
    "/uav1/initial_state": "/start",
    "/uav1/left/image_raw/compressed": "/camera/infra1/image_rect_raw/compressed",
    "/uav1/right/image_raw/compressed": "/camera/infra2/image_rect_raw/compressed",
}
FOREIGN_TOPICS = TopicsConfig(
    **{
        role: NAMES[f"/uav1/{topic}"]
        for role, topic in (
            ("left", "left/image_raw"),
            ("right", "right/image_raw"),
            ("left_info", "left/camera_info"),
            ("right_info", "right/camera_info"),
            ("imu", "imu/data_raw"),
            ("initial_state", "initial_state"),
        )
    }
)
IMU_FRAME = "imu_link"
UPSIDE_DOWN = Pose(so3_exp([np.pi, 0.0, 0.0]), np.zeros(3))  # of the IMU in the body


def rewritten(source: Path, out: Path, *changes: Change, volatile: Collection[str] = (), storage: str = "mcap") -> Path:
    """Copy a bag; each change edits or (None) drops messages. Of its latched topics `volatile` are no longer so."""
    latched = {topic: info.latched for topic, info in topics_of([source]).items()}
    with RawRecorder(out, storage=storage) as recorder:
        for raw in iter_raw([source]):
            changed: RawMessage | None = raw
            for change in changes:
                changed = change(changed) if changed is not None else None
            if changed is not None:
                kept = latched.get(raw.topic, False) and raw.topic not in volatile
                recorder.write(changed.topic, changed.msgtype, changed.data, changed.stamp_ns, latched=kept)
    return out


def edited(topic: str, edit: Callable[[Any], Any]) -> Change:
    """Return a change of one topic's messages."""
    return lambda raw: dataclasses.replace(raw, data=encode(edit(decode(raw)))) if raw.topic == topic else raw


def without(*topics: str) -> Change:
    """Return a change that drops topics."""
    return lambda raw: None if raw.topic in topics else raw


def renamed(raw: RawMessage) -> RawMessage:
    """Give the topics of uav1 the names of a depth camera's driver."""
    return dataclasses.replace(raw, topic=NAMES.get(raw.topic, raw.topic))


def shifted(message: Any, by_ns: int) -> Any:
    """Move a message's stamp."""
    stamp = message.header.stamp
    total = stamp.sec * NS_PER_S + stamp.nanosec + by_ns
    stamp.sec, stamp.nanosec = divmod(total, NS_PER_S)
    return message


def in_imu_frame(message: Any) -> Any:
    """Name the frame of a reading that is in axes of its own."""
    message.header.frame_id = IMU_FRAME
    return message


def turned(message: Any) -> Any:
    """Express a reading in the axes of an IMU that is mounted upside down."""
    for vector in (message.angular_velocity, message.linear_acceleration):
        vector.y, vector.z = -vector.y, -vector.z
    return in_imu_frame(message)


def with_imu_edge(message: Any, vehicle: str = "uav1", T_body_imu: Pose = UPSIDE_DOWN) -> Any:
    """Add where that IMU is to the static frames."""
    extra = transforms_message(0, [(f"{vehicle}/base_link", IMU_FRAME, T_body_imu)])
    message.transforms = [*message.transforms, *extra.transforms]
    return message


def kalibr_of(bag: Path, folder: Path, *, timeshift_s: float = 0.0, T_body_imu: Pose | None = None) -> Path:
    """Write the recorded calibration as Kalibr does, whose body is the IMU."""
    return write_kalibr(open_flight(bag, "uav1").rig, folder, timeshift_s=timeshift_s, T_body_imu=T_body_imu)


def write_kalibr(rig: StereoRig, folder: Path, *, timeshift_s: float = 0.0, T_body_imu: Pose | None = None) -> Path:
    """Write a rig as Kalibr does; with another pose of the IMU in the body than the identity."""
    tree = camchain(rig, T_body_imu=T_body_imu or Pose.identity(), time_offset_s=timeshift_s)
    path = folder / "camchain-imucam.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path
