# SPDX-License-Identifier: Apache-2.0
"""Frames are paired with increments in any order, with losses and repetitions."""

import itertools

import numpy as np
import pytest

from uav_vslam.config import ImuConfig
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.slam.frame_queue import MAX_AHEAD, MAX_WAITING, FrameQueue
from uav_vslam.types import ImuIncrement, StereoFeatures


def frame(stamp_ns: int) -> StereoFeatures:
    return StereoFeatures(stamp_ns, np.ones((1, 4), np.float32), np.zeros((1, 128), np.uint8))


def motion(start_ns: int, stamp_ns: int) -> ImuIncrement:
    return preintegrate([], start_ns, stamp_ns, gyro_bias=np.zeros(3), accel_bias=np.zeros(3), imu=ImuConfig())


def started(start_ns: int) -> FrameQueue:
    """Return a queue that knows the start state's stamp."""
    queue = FrameQueue()
    queue.start_ns = start_ns
    return queue


def drain(queue: FrameQueue) -> list[tuple[int, int]]:
    """Return (stamp, number of features) of each frame that is complete."""
    out = []
    while (item := queue.pop()) is not None:
        features, increment = item
        assert increment is None or increment.stamp_ns == features.stamp_ns
        out.append((features.stamp_ns, len(features)))
    return out


@pytest.mark.parametrize("when", list(itertools.combinations(range(5), 2)))
def test_frames_and_increments_arrive_in_any_order(when: tuple[int, int]) -> None:
    frames, motions = iter([frame(10), frame(20), frame(30)]), iter([motion(10, 20), motion(20, 30)])
    queue, got = started(10), []
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
    queue = started(15)
    queue.add_features(frame(10))
    queue.add_features(frame(20))
    queue.add_increment(motion(15, 20))
    assert drain(queue) == [(20, 1)]


def test_an_image_without_features_is_bridged() -> None:
    queue = started(10)
    queue.add_increment(motion(10, 20))
    queue.add_increment(motion(20, 30))
    assert drain(queue) == []  # its features may still arrive
    queue.add_features(frame(30))
    assert drain(queue) == [(20, 0), (30, 1)]
    assert queue.lost == 1


def test_a_frame_without_increment_does_not_block_the_others() -> None:
    queue = started(10)
    for stamp_ns in (20, 30):
        queue.add_features(frame(stamp_ns))
    queue.add_increment(motion(10, 30))  # the INS did not receive the image at 20
    assert drain(queue) == [(30, 1)]
    assert queue.without_motion == 1


@pytest.mark.parametrize("repeated", [10, 20])
def test_a_repeated_frame_is_used_once_and_blocks_nothing(repeated: int) -> None:
    queue = started(10)
    for stamp_ns in sorted([10, 20, 30, repeated]):
        queue.add_features(frame(stamp_ns))
    queue.add_increment(motion(10, 20))
    queue.add_increment(motion(20, 30))
    assert drain(queue) == [(10, 1), (20, 1), (30, 1)]
    assert queue.without_motion == 1


def test_the_queue_is_bounded() -> None:
    queue = started(0)
    for stamp_ns in range(10, 10 + 2 * MAX_WAITING):
        queue.add_features(frame(stamp_ns))
    queue.add_increment(motion(0, 10 + MAX_WAITING))
    assert drain(queue) == [(10 + MAX_WAITING, 1)]
    assert queue.without_motion == 2 * MAX_WAITING - MAX_WAITING  # each drop is counted


def test_frames_that_overflow_before_the_start_is_known_count_as_before_it() -> None:
    queue = FrameQueue()
    for stamp_ns in range(MAX_WAITING + 3):
        queue.add_features(frame(stamp_ns))
    assert queue.before_start == 3


def test_motion_continues_without_features_and_none_is_lost() -> None:
    """A camera that is silent for much longer than the queue's capacity."""
    queue, got = started(0), []
    count = 3 * MAX_WAITING
    for k in range(count):
        queue.add_increment(motion(10 * k, 10 * (k + 1)))
        got += drain(queue)
        assert len(got) == max(0, k + 1 - MAX_AHEAD)
    queue.add_features(frame(10 * count))
    got += drain(queue)
    assert got == [*((10 * k, 0) for k in range(1, count)), (10 * count, 1)]
    assert queue.lost == count - 1


@pytest.mark.parametrize(("period", "late"), [(4, 0), (10, 1), (30, 4)])
def test_a_slow_front_end_is_waited_for(period: int, late: int) -> None:
    """It processes one image in `period`, 1.5 periods late; the first ones may count as lost."""
    queue, got = started(0), []
    for k in range(1, 10 * period):
        queue.add_increment(motion(10 * (k - 1), 10 * k))
        seen = k - period - period // 2
        if seen >= 0 and seen % period == 0:
            queue.add_features(frame(10 * seen))
        got += drain(queue)
    used = [stamp_ns for stamp_ns, points in got if points]
    assert used == [10 * period * number for number in range(late, 9)]
    assert queue.without_motion + queue.before_start == late


def test_features_later_than_their_increment_are_dropped() -> None:
    queue = started(0)
    for k in range(MAX_AHEAD + 2):
        queue.add_increment(motion(10 * k, 10 * (k + 1)))
    assert drain(queue) == [(10, 0), (20, 0)]
    queue.add_features(frame(20))
    queue.add_features(frame(30))
    assert drain(queue) == [(30, 1)]
    assert queue.without_motion == 1


def test_a_frame_whose_increment_was_lost_comes_without_one() -> None:
    queue = started(10)
    for stamp_ns in (10, 20, 30, 40):
        queue.add_features(frame(stamp_ns))
    queue.add_increment(motion(20, 30))  # the one from 10 to 20 was lost
    queue.add_increment(motion(30, 40))
    assert drain(queue) == [(10, 1), (20, 1), (30, 1), (40, 1)]
    assert (queue.without_motion, queue.motion_refused) == (0, 0)


def test_increments_from_before_the_stamp_reached_are_refused_and_counted() -> None:
    queue = started(10)
    for stamp_ns in (20, 30):
        queue.add_features(frame(stamp_ns))
    queue.add_increment(motion(5, 20))  # it does not begin at the start state
    queue.add_increment(motion(10, 20))
    queue.add_increment(motion(10, 20))  # repeated
    queue.add_increment(motion(20, 30))
    assert drain(queue) == [(20, 1), (30, 1)]
    assert queue.motion_refused == 2


def test_no_increment_is_lost_while_frames_come_that_show_nothing_new() -> None:
    """Each frame says that the cameras are alive, so that motion waits; not until the oldest falls out."""
    queue, reached = started(0), 0
    for k in range(MAX_WAITING + 20):
        queue.add_increment(motion(10 * k, 10 * k + 10))
        queue.add_features(frame(-1))  # from before the start
        while (item := queue.pop()) is not None:
            increment = item[1]
            assert increment is not None
            assert increment.start_ns == reached
            reached = increment.stamp_ns
    assert reached >= 200
    assert queue.before_start == MAX_WAITING + 20


@pytest.mark.parametrize("apart", [-1, 1, 30])
def test_frames_whose_stamps_are_beside_those_of_the_increments_are_told_with_the_difference(apart: int) -> None:
    queue = started(0)
    for k in range(1, 6):
        queue.add_features(frame(100 * k + apart))
        queue.add_increment(motion(100 * (k - 1), 100 * k))
        drain(queue)
    assert queue.unpaired >= 4
    assert queue.apart_ns == apart
    for k in range(6, 9):
        queue.add_increment(motion(100 * (k - 1), 100 * k))
        queue.add_features(frame(100 * k))
        assert drain(queue)[-1] == (100 * k, 1)
    assert queue.unpaired == 0


def test_most_frames_without_an_increment_of_their_stamp_are_told_though_some_have_one() -> None:
    """As where camera_info, which ends the increments, comes once a second."""
    queue = started(0)
    for k in range(1, 36):
        queue.add_features(frame(100 * k))
        if k % 7 == 0:
            queue.add_increment(motion(100 * (k - 7), 100 * k))
        drain(queue)
    assert queue.without_motion == 30
    assert queue.unpaired >= 15
