# SPDX-License-Identifier: Apache-2.0
"""A start state waits for readings near its stamp; the estimate of a back end in flight takes precedence."""

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.ins.pending_start import PendingStart, Refusal
from uav_vslam.ins.startup_buffer import MAX_APART_S, MAX_UNCOVERED_S, StartupBuffer
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, NavState

FIRST_NS = 100 * NS_PER_S
BODY = "uav1/base_link"


def start_at(stamp_ns: int) -> NavEstimate:
    return NavEstimate(NavState(stamp_ns, Pose.identity(), np.zeros(3), np.zeros(3), np.zeros(3)), np.eye(15))


def conflict(frame: str) -> str:
    return "" if frame == BODY else f"is of {frame}"


@pytest.fixture
def buffer() -> StartupBuffer:
    """One reading, at FIRST_NS."""
    made = StartupBuffer()
    made.add(ImuSample(FIRST_NS, np.zeros(3), np.zeros(3)))
    return made


def test_without_readings_a_start_state_waits() -> None:
    pending, start = PendingStart(buffer := StartupBuffer()), start_at(FIRST_NS)
    pending.give(start, BODY)
    assert (pending.ahead_s, pending.confirmed(conflict)) == (None, None)
    buffer.add(ImuSample(FIRST_NS, np.zeros(3), np.zeros(3)))
    assert pending.ahead_s == 0.0
    assert pending.confirmed(conflict) is start


def test_a_start_state_is_confirmed_once(buffer: StartupBuffer) -> None:
    pending = PendingStart(buffer)
    assert (pending.ahead_s, pending.confirmed(conflict)) == (None, None)
    pending.give(start := start_at(FIRST_NS), BODY)
    assert pending.confirmed(conflict) is start
    assert (pending.ahead_s, pending.confirmed(conflict)) == (None, None)


def test_a_start_state_far_ahead_waits_until_readings_are_near(buffer: StartupBuffer) -> None:
    pending, wait_s = PendingStart(buffer), MAX_APART_S + 1.0
    pending.give(start := start_at(FIRST_NS + round(wait_s * NS_PER_S)), BODY)
    assert pending.ahead_s == pytest.approx(wait_s)
    assert pending.confirmed(conflict) is None
    buffer.add(ImuSample(FIRST_NS + NS_PER_S, np.zeros(3), np.zeros(3)))
    assert pending.confirmed(conflict) is start


def test_a_start_state_of_no_use_is_refused_with_its_reason_and_waits_no_longer(buffer: StartupBuffer) -> None:
    pending = PendingStart(buffer)
    pending.give(start_at(0), "camera")  # two faults: the stamp is named
    refusal = pending.confirmed(conflict)
    assert isinstance(refusal, Refusal)
    assert refusal.reason == "start_stamp"
    assert refusal.text.startswith("initial_state is stamped 0 ns, 100.0 s before")
    assert pending.ahead_s is None
    pending.give(start_at(FIRST_NS), "camera")
    assert pending.confirmed(conflict) == Refusal("start_frame", "initial_state is of camera")


def test_the_take_off_state_does_not_replace_the_estimate_of_a_back_end_in_flight(buffer: StartupBuffer) -> None:
    pending = PendingStart(buffer)
    pending.resume(newest := start_at(FIRST_NS + NS_PER_S), BODY)
    pending.give(start_at(FIRST_NS), BODY)
    assert pending.confirmed(conflict) is newest
    pending.give(newer := start_at(FIRST_NS + 2 * NS_PER_S), BODY)
    assert pending.confirmed(conflict) is newer


def test_only_the_back_ends_estimate_may_be_long_before_the_first_reading(buffer: StartupBuffer) -> None:
    stamp_ns = FIRST_NS - round((MAX_UNCOVERED_S + 1.0) * NS_PER_S)
    pending = PendingStart(buffer)
    pending.give(start_at(stamp_ns), BODY)
    assert isinstance(pending.confirmed(conflict), Refusal)
    assert not pending.is_resumed(stamp_ns)
    pending.resume(newest := start_at(stamp_ns), BODY)
    assert pending.confirmed(conflict) is newest
    assert pending.is_resumed(stamp_ns)


def test_an_estimate_that_readings_cover_is_a_start_like_any_other(buffer: StartupBuffer) -> None:
    pending = PendingStart(buffer)
    pending.resume(start_at(FIRST_NS), BODY)
    assert not pending.is_resumed(FIRST_NS)
