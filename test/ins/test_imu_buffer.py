# SPDX-License-Identifier: Apache-2.0
"""What the buffer accepts, how long it keeps it, and what it cuts for an interval."""

import numpy as np
import pytest

from uav_vslam.config import ImuConfig
from uav_vslam.ins.imu_buffer import MAX_HELD_S, ImuBuffer
from uav_vslam.ins.preintegration import has_gap, preintegrate
from uav_vslam.types import NS_PER_S, ImuSample

IMU = ImuConfig()


def reading(stamp_ns: int, value: float = 0.0) -> ImuSample:
    return ImuSample(stamp_ns, np.full(3, value), np.zeros(3))


@pytest.mark.parametrize("stamp_ns", [10, 9])
def test_a_reading_that_is_not_later_is_rejected(stamp_ns: int) -> None:
    buffer = ImuBuffer(IMU)
    buffer.append(reading(10))
    with pytest.raises(ValueError, match="not after 10 ns"):
        buffer.append(reading(stamp_ns))
    assert [s.stamp_ns for s in buffer.cut(0, 20)] == [10]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_reading_that_is_not_finite_is_rejected(value: float) -> None:
    with pytest.raises(ValueError, match="not finite"):
        ImuBuffer(IMU).append(reading(10, value))


def test_a_cut_holds_one_reading_beyond_each_end() -> None:
    buffer = ImuBuffer(IMU)
    for stamp_ns in range(0, 100, 10):
        buffer.append(reading(stamp_ns))
    assert [s.stamp_ns for s in buffer.cut(25, 45)] == [20, 30, 40, 50]
    assert [s.stamp_ns for s in buffer.cut(45, 60)] == [40, 50, 60]
    assert [s.stamp_ns for s in buffer.cut(60, 62)] == [60, 70]
    assert buffer.covers(90)
    assert not buffer.covers(91)


def test_readings_only_before_or_only_after_an_interval_are_a_gap() -> None:
    buffer = ImuBuffer(IMU)
    assert buffer.cut(0, 10) == []
    buffer.append(reading(100))
    assert buffer.cut(10, 20) == []
    assert buffer.cut(100, 110) == []
    assert buffer.cut(200, 210) == []


def test_readings_are_buffered_for_minutes_and_dropped_ones_are_a_gap() -> None:
    buffer, second = ImuBuffer(IMU), NS_PER_S
    step_ns, end_ns = second // 25, round(3 * MAX_HELD_S) * second
    for stamp_ns in range(0, end_ns + 1, step_ns):
        buffer.append(reading(stamp_ns))
    kept = buffer.cut(0, end_ns)
    assert kept[0].stamp_ns == end_ns - round(MAX_HELD_S) * second
    assert len(kept) == MAX_HELD_S * 25 + 1
    assert has_gap(kept, 0, end_ns)
    assert not has_gap(kept, kept[0].stamp_ns, end_ns)
    increment = preintegrate(kept, 0, end_ns, gyro_bias=np.zeros(3), accel_bias=np.zeros(3), imu=IMU)
    assert np.sqrt(increment.covariance[2, 2]) > np.pi / np.sqrt(3.0)  # nothing is known of the heading
