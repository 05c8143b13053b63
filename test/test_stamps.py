# SPDX-License-Identifier: Apache-2.0
"""A single stamp from the future is rejected, a real time jump accepted at the second stamp; the nearest stamp."""

import numpy as np
import pytest

from uav_vslam.errors import InvalidMessage
from uav_vslam.stamps import IMAGE_TIME_JUMP_S, IMU_TIME_JUMP_S, TimeJumpGuard, nearest
from uav_vslam.types import NS_PER_S

JUMP_NS = round(IMU_TIME_JUMP_S * NS_PER_S)
FAR_NS = 1000 * JUMP_NS


def rejected(stamps_ns: list[int]) -> list[int]:
    """Return those of the stamps that are rejected, fed in order."""
    guard, out = TimeJumpGuard("IMU", IMU_TIME_JUMP_S), []
    for stamp_ns in stamps_ns:
        try:
            guard.check(stamp_ns)
        except InvalidMessage:
            out.append(stamp_ns)
    return out


@pytest.mark.parametrize(
    ("stamps_ns", "expected"),
    [
        ([1, 2, 3, 2 + JUMP_NS, 2 * JUMP_NS], []),
        ([1, FAR_NS, 2, 3], [FAR_NS]),
        ([1, FAR_NS, 2, FAR_NS + 1, 3], [FAR_NS, FAR_NS + 1]),  # the old stamp between discards the candidate
        ([1, FAR_NS, FAR_NS + 1, FAR_NS + 2], [FAR_NS]),
        ([1, FAR_NS, FAR_NS, FAR_NS + 1], [FAR_NS, FAR_NS]),  # a duplicate is no confirmation
        ([1, FAR_NS, 2 * FAR_NS, 3 * FAR_NS], [FAR_NS, 2 * FAR_NS, 3 * FAR_NS]),
        ([0, FAR_NS, FAR_NS + 1], [FAR_NS]),  # a clock set after the first reading
        ([FAR_NS, 1, FAR_NS + 1], []),  # an old stamp is no jump, nor is the next one
    ],
)
def test_a_jump_ahead_is_accepted_once_confirmed(stamps_ns: list[int], expected: list[int]) -> None:
    assert rejected(stamps_ns) == expected


def test_the_error_names_stream_and_jump() -> None:
    guard = TimeJumpGuard("IMU", IMU_TIME_JUMP_S)
    guard.check(0)
    with pytest.raises(InvalidMessage, match=r"stamp_jump: IMU stamp 60000000000 ns is 60.0 s after the newest"):
        guard.check(60 * NS_PER_S)


def test_a_keyframe_recording_loses_no_image() -> None:
    guard = TimeJumpGuard("image", IMAGE_TIME_JUMP_S)
    for seconds in (0, 8, 16, 40):
        guard.check(seconds * NS_PER_S)


def test_the_nearest_stamp_is_found_before_between_and_after_all() -> None:
    others_ns = np.array([10, 20, 40], np.int64)
    stamps_ns = np.array([41, -5, 14, 15, 16, 20, 31], np.int64)  # 15 is as near to 10 as to 20
    assert nearest(stamps_ns, others_ns).tolist() == [2, 0, 0, 0, 1, 1, 2]
    assert nearest(stamps_ns, others_ns[:1]).tolist() == [0] * len(stamps_ns)
