# SPDX-License-Identifier: Apache-2.0
"""Frames meet their motion whatever comes first, is missing, or comes twice."""

import itertools

import numpy as np
import pytest

from uav_vslam.config import ImuConfig
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.slam.frame_queue import MAX_WAITING, FrameQueue
from uav_vslam.types import ImuIncrement, StereoFeatures


def frame(stamp_ns: int) -> StereoFeatures:
    return StereoFeatures(stamp_ns, np.ones((1, 4), np.float32), np.zeros((1, 128), np.uint8))


def motion(start_ns: int, stamp_ns: int) -> ImuIncrement:
    return preintegrate([], start_ns, stamp_ns, gyro_bias=np.zeros(3), accel_bias=np.zeros(3), imu=ImuConfig())


def drain(queue: FrameQueue) -> list[tuple[int, int]]:
    """Return (stamp, number of features) of each frame that is complete."""
    out = []
    while (item := queue.pop()) is not None:
        features, increment = item
        assert increment is None or increment.stamp_ns == features.stamp_ns
        out.append((features.stamp_ns, len(features)))
    return out


@pytest.mark.parametrize("when", list(itertools.combinations(range(5), 2)))
def test_frames_and_motions_may_overtake_each_other(when: tuple[int, int]) -> None:
    frames, motions = iter([frame(10), frame(20), frame(30)]), iter([motion(10, 20), motion(20, 30)])
    queue, got = FrameQueue(10), []
    for k in range(5):
        if k in when:
            queue.add_increment(next(motions))
        else:
            queue.add_features(next(frames))
        got += drain(queue)
    assert got == [(10, 1), (20, 1), (30, 1)]
    assert (queue.lost, queue.before_start, queue.without_motion) == (0, 0, 0)


def test_nothing_is_ready_before_the_start_is_known_and_older_frames_are_dropped() -> None:
    queue = FrameQueue()
    for stamp_ns in (5, 8, 10, 20):
        queue.add_features(frame(stamp_ns))
    assert drain(queue) == []
    queue.start_ns = 10
    assert drain(queue) == [(10, 1)]
    assert queue.before_start == 2


def test_a_start_between_two_frames_is_reached_by_motion_alone() -> None:
    queue = FrameQueue(15)
    queue.add_features(frame(10))
    queue.add_features(frame(20))
    queue.add_increment(motion(15, 20))
    assert drain(queue) == [(20, 1)]


def test_an_image_without_features_is_bridged() -> None:
    queue = FrameQueue(10)
    queue.add_increment(motion(10, 20))
    queue.add_increment(motion(20, 30))
    assert drain(queue) == []  # its features may still come
    queue.add_features(frame(30))
    assert drain(queue) == [(20, 0), (30, 1)]
    assert queue.lost == 1


def test_a_frame_whose_motion_never_comes_does_not_hold_up_the_others() -> None:
    queue = FrameQueue(10)
    for stamp_ns in (20, 30):
        queue.add_features(frame(stamp_ns))
    queue.add_increment(motion(10, 30))  # the inertial stage never heard of the image at 20
    assert drain(queue) == [(30, 1)]
    assert queue.without_motion == 1


@pytest.mark.parametrize("repeated", [10, 20])
def test_a_repeated_frame_is_used_once_and_holds_up_nothing(repeated: int) -> None:
    queue = FrameQueue(10)
    for stamp_ns in sorted([10, 20, 30, repeated]):
        queue.add_features(frame(stamp_ns))
    queue.add_increment(motion(10, 20))
    queue.add_increment(motion(20, 30))
    assert drain(queue) == [(10, 1), (20, 1), (30, 1)]
    assert queue.without_motion == 1


def test_what_waits_is_bounded() -> None:
    queue = FrameQueue(0)
    for stamp_ns in range(10, 10 + 2 * MAX_WAITING):
        queue.add_features(frame(stamp_ns))
    queue.add_increment(motion(0, 10 + MAX_WAITING))
    assert drain(queue) == [(10 + MAX_WAITING, 1)]
