# SPDX-License-Identifier: Apache-2.0
"""Recorded messages of IMUs whose accelerometer has a topic of its own, as if one topic held both sensors' readings."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.cdr import RawMessage, decode, encode
from uav_vslam.datasets.messages import imu_of
from uav_vslam.errors import BagError
from uav_vslam.ins.split_imu import SplitImu

Recorded = tuple[RawMessage, Any]  # a message, and what it holds


def united(messages: Iterable[RawMessage], gyro_topics: Mapping[str, str]) -> Iterator[RawMessage]:
    """Give the gyroscopes' messages the accelerometers' readings, which then are left out; all else passes.

    What can't be read passes too, on the gyroscope's topic.

    Args:
        messages: in recorded order.
        gyro_topics: by the accelerometer's (`InputConfig.gyro_topics`); if empty, nothing changes.
    """
    imus: dict[str, SplitImu[Recorded]] = {topic: SplitImu() for topic in gyro_topics.values()}
    for raw in messages:
        topic = gyro_topics.get(raw.topic, raw.topic)
        if topic not in imus:
            yield raw
            continue
        try:
            built = decode(raw)
            reading = imu_of(built)
        except BagError:
            yield dataclasses.replace(raw, topic=topic)
            continue
        if raw.topic in gyro_topics:
            complete = imus[topic].add_accel(reading.stamp_ns, reading.accel)
        else:
            complete = imus[topic].add_gyro(reading.stamp_ns, (raw, built))
        for (one, content), force in complete:
            yield dataclasses.replace(one, data=encode(_with_force(content, force)))


def _with_force(built: Any, force: NDArray[np.float64]) -> Any:
    vector = built.linear_acceleration
    vector.x, vector.y, vector.z = map(float, force)
    built.linear_acceleration_covariance = np.zeros(9)  # measured, with a variance that is not known
    return built
