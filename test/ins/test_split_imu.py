# SPDX-License-Identifier: Apache-2.0
"""The specific force at a reading of the gyroscope is known between two that were measured, and nowhere else."""

import numpy as np

from uav_vslam.ins.split_imu import SplitImu

MS = 1_000_000


def force(stamp_ns: int) -> np.ndarray:
    return np.array([1.0, 2.0, 3.0]) * stamp_ns / MS


def add(imu: SplitImu[int], kind: str, *stamps_ms: float) -> list[int]:
    """Add readings; return those of the gyroscope that are complete, with a force that is linear in time."""
    found = []
    for stamp_ns in (int(one * MS) for one in stamps_ms):
        complete = imu.add_gyro(stamp_ns, stamp_ns) if kind == "gyro" else imu.add_accel(stamp_ns, force(stamp_ns))
        for reading, at in complete:
            np.testing.assert_allclose(at, force(reading), rtol=1e-12)
            found.append(reading // MS)
    return found


def test_a_reading_waits_for_the_force_after_it() -> None:
    imu: SplitImu[int] = SplitImu()
    assert add(imu, "accel", 0) == []
    assert add(imu, "gyro", 0) == [0]
    assert add(imu, "gyro", 3, 7, 12) == []
    assert add(imu, "accel", 10) == [3, 7]
    assert add(imu, "accel", 20) == [12]
    assert add(imu, "accel", 30, 40) == []
    assert add(imu, "gyro", 24, 36) == [24, 36]  # forces may come first
    assert imu.unmatched == 0


def test_readings_before_the_first_force_and_in_a_gap_are_left_out() -> None:
    imu: SplitImu[int] = SplitImu()
    assert add(imu, "gyro", 0, 5) == []
    assert add(imu, "accel", 4) == []
    assert add(imu, "accel", 14) == [5]
    assert add(imu, "gyro", 60) == []
    assert add(imu, "accel", 120) == []
    assert imu.unmatched == 2
    assert add(imu, "gyro", 125) == []
    assert add(imu, "accel", 130) == [125]


def test_a_late_or_repeated_force_is_ignored_and_a_clock_that_was_set_begins_again() -> None:
    imu: SplitImu[int] = SplitImu()
    add(imu, "accel", 9_000, 9_010, 9_005, 9_010)
    assert add(imu, "gyro", 9_007, 9_012) == [9_007]
    assert add(imu, "accel", 1_000) == []
    assert add(imu, "gyro", 1_005) == []
    assert add(imu, "accel", 1_010) == [1_005]
    assert imu.unmatched == 1
