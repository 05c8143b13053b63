# SPDX-License-Identifier: Apache-2.0
"""A status tells the operator what is wrong now: nothing in a healthy start, and nothing once a fault is over."""

import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from types import SimpleNamespace

from uav_vslam.ros.health import (
    LONGEST_START_S,
    NO_CLOCK_S,
    RECENT_REPORTS,
    RECENT_S,
    START_S,
    RecentDrops,
    RecentEvents,
    Start,
)
from uav_vslam.types import NS_PER_S


class Clock:
    """A ROS clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def now(self) -> SimpleNamespace:
        return SimpleNamespace(nanoseconds=round(self.now_s * NS_PER_S))


def published() -> bool:
    return True


def test_a_start_lasts_while_the_clock_of_a_replay_stands_and_then_for_its_own_time() -> None:
    clock = Clock()
    start = Start(clock, published)  # type: ignore[arg-type]
    assert start.lasts()
    for since_s, lasts in ((0.0, True), (0.9 * START_S, True), (1.1 * START_S, False)):
        clock.now_s = 1000.0 + since_s
        assert start.lasts() is lasts


def test_a_clock_that_never_runs_does_not_keep_a_node_starting(monkeypatch: pytest.MonkeyPatch) -> None:
    start = Start(Clock(), published)  # type: ignore[arg-type]
    made_s = start._made_s
    monkeypatch.setattr("uav_vslam.ros.health.time.monotonic", lambda: made_s + 1.01 * LONGEST_START_S)
    assert not start.lasts()


def test_a_clock_that_nobody_publishes_ends_the_start_after_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, someone = Clock(), [False]
    start = Start(clock, lambda: someone[0])  # type: ignore[arg-type]
    made_s = start._made_s
    assert start.lasts()
    assert not start.lacks_clock()
    monkeypatch.setattr("uav_vslam.ros.health.time.monotonic", lambda: made_s + NO_CLOCK_S)
    assert start.lacks_clock()
    assert not start.lasts()
    someone[0] = True  # a replay whose nodes are not all there yet
    assert start.lasts()
    assert not start.lacks_clock()
    someone[0], clock.now_s = False, 1000.0  # the system's time
    assert not start.lacks_clock()


def test_a_drop_is_reported_with_its_reason_until_it_is_long_past() -> None:
    drops = RecentDrops()
    counts = {"dropped/stamp": 2, "frames": 7}
    reports = [drops.next_report(counts) for _ in range(RECENT_REPORTS + 1)]
    assert reports == ["stamp 2"] * RECENT_REPORTS + [""]
    assert drops.next_report(counts | {"dropped/stamp": 3, "dropped/frame_lost": 1}) == "frame_lost 1, stamp 1"


def test_events_count_for_ten_seconds_of_stamps_and_not_after_a_clock_that_was_set_back() -> None:
    events = RecentEvents()
    counts = [events.count(round(at_s * NS_PER_S), happened) for at_s, happened in ((1, 1), (2, 0), (3, 2), (10.9, 0))]
    assert counts == [1, 1, 3, 3]
    assert events.count(round((1 + RECENT_S) * NS_PER_S), 0) == 2
    assert events.count(round((3 + RECENT_S) * NS_PER_S), 0) == 0
    events.count(100 * NS_PER_S, 1)
    assert events.count(50 * NS_PER_S, 0) == 0
