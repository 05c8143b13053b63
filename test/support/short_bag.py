# SPDX-License-Identifier: Apache-2.0
"""The beginning of a recording."""

from pathlib import Path

from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.rosbag import iter_raw, topics_of


def before(end_ns: int, bag: Path, path: Path) -> Path:
    """Write the messages of a bag that were recorded before a stamp [ns] to a new one, and return its path."""
    latched = {topic: info.latched for topic, info in topics_of([bag]).items()}
    with RawRecorder(path) as recorder:
        for raw in iter_raw([bag]):
            if raw.stamp_ns < end_ns:
                recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns, latched=latched[raw.topic])
    return path
