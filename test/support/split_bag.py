# SPDX-License-Identifier: Apache-2.0
"""A recording as of a driver that does not unite its IMU: gyroscope and accelerometer have topics of their own."""

import dataclasses
from pathlib import Path

import numpy as np

from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import decode, encode
from uav_vslam.datasets.rosbag import iter_raw, topics_of
from uav_vslam.studies.recordings.foreign import shifted
from uav_vslam.types import NS_PER_S

GYRO, ACCEL = "/camera/gyro/sample", "/camera/accel/sample"
LATER_NS = 1_000_000  # the accelerometer measures after the gyroscope


def split(source: Path, out: Path, *, every: int = 2, topic: str = "/uav1/imu/data_raw") -> Path:
    """Copy a bag; every so many specific forces are kept, LATER_NS after the angular rate of the same message."""
    latched = {name: info.latched for name, info in topics_of([source]).items()}
    readings = 0
    with RawRecorder(out) as recorder:
        for raw in iter_raw([source]):
            if raw.topic != topic:
                recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns, latched=latched[raw.topic])
                continue
            for name, unmeasured in ((GYRO, "linear_acceleration"), (ACCEL, "angular_velocity")):
                message = decode(raw)
                setattr(message, unmeasured, dataclasses.replace(message.linear_acceleration, x=0.0, y=0.0, z=0.0))
                if name == GYRO:
                    recorder.write(GYRO, raw.msgtype, encode(message), raw.stamp_ns)
                elif readings % every == 0:
                    data = encode(shifted(message, LATER_NS))
                    recorder.write(ACCEL, raw.msgtype, data, raw.stamp_ns + LATER_NS)
            readings += 1
    return out


def forces_at(stamps_ns: np.ndarray, bag: Path) -> np.ndarray:
    """Return (N, 3) specific forces at stamps, linear between those of the recording."""
    kept = [decode(raw) for raw in iter_raw([bag], [ACCEL])]
    at = np.array([one.header.stamp.sec * NS_PER_S + one.header.stamp.nanosec for one in kept])
    vectors = [one.linear_acceleration for one in kept]
    return np.stack(
        [np.interp(stamps_ns - at[0], at - at[0], [getattr(v, axis) for v in vectors]) for axis in "xyz"], axis=1
    )
