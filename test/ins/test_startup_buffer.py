# SPDX-License-Identifier: Apache-2.0
"""The startup buffer holds a span of time, independent of the IMU rate."""

import numpy as np
import pytest

from uav_vslam.ins.startup_buffer import MAX_APART_S, MAX_UNCOVERED_S, StartupBuffer
from uav_vslam.types import NS_PER_S, ImuSample


def reading(stamp_ns: int) -> ImuSample:
    return ImuSample(stamp_ns, np.zeros(3), np.zeros(3))


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [10, 200, 4000])
@pytest.mark.parametrize("held_s", [0.5, 1.5])
def test_the_span_is_buffered_at_any_rate(rate_hz: int, held_s: float) -> None:
    early = StartupBuffer(held_s)
    for k in range(3 * rate_hz):
        early.add(reading(k * NS_PER_S // rate_hz))
        if k % 5 == 0:
            early.add(k * NS_PER_S // rate_hz + 1000)
        stamps = [sample.stamp_ns for sample in early.readings()]
        assert stamps[-1] - stamps[0] <= (held_s + 2.5 / rate_hz) * NS_PER_S
    assert stamps[-1] - stamps[0] >= held_s * NS_PER_S


def test_rest_counts_once_the_cameras_send_images() -> None:
    """Their driver may start a minute after the IMU's; what was known of the motion then is of no use."""
    buffer, step_ns = StartupBuffer(1.0), 5_000_000
    for k in range(12_000):
        buffer.add(reading(k * step_ns))
    assert buffer.at_rest() == []
    buffer.add(12_000 * step_ns)
    assert [one.stamp_ns for one in buffer.at_rest()][-1] == 11_999 * step_ns
    assert len(buffer.at_rest()) == 201


def test_rest_counts_as_soon_as_it_has_lasted_where_images_come_before() -> None:
    buffer, lasts = StartupBuffer(1.0), []
    buffer.add(0)
    for k in range(202):
        buffer.add(reading(k * 5_000_000))
        lasts.append(bool(buffer.at_rest()))
    assert lasts == [False] * 200 + [True] * 2


def test_nothing_is_dropped_before_the_span_is_full() -> None:
    """So the first alignment uses all readings from the first on."""
    early = StartupBuffer(1.0)
    items = [reading(0), 1000, *(reading(k * 5_000_000) for k in range(1, 203))]
    for item in items[:-1]:
        early.add(item)
    assert early.readings() == [items[0], *items[2:-1]]
    early.add(items[-1])
    assert early.readings() == items[2:]
    assert early.take() == items[2:]  # the image is dropped too


def test_take_empties_the_buffer() -> None:
    early = StartupBuffer()
    items = [reading(0), 1000, reading(2000)]
    for item in items:
        early.add(item)
    assert early.take() == items
    assert early.take() == []


def test_ahead_is_relative_to_the_newest_reading() -> None:
    early = StartupBuffer()
    early.add(5 * NS_PER_S)  # an image
    assert early.ahead_s(0) is None
    for seconds in (20, 21, 19):
        early.add(reading(seconds * NS_PER_S))
    early.take()
    assert early.ahead_s(0) == -21.0
    assert early.ahead_s(24 * NS_PER_S) == 3.0


def test_a_start_from_long_before_the_readings_is_refused() -> None:
    early, first_ns = StartupBuffer(), 100 * NS_PER_S
    assert early.refusal(0) == ""  # nothing to compare it with yet
    for k in range(4):
        early.add(reading(first_ns + k * NS_PER_S // 2))
    covered_ns = first_ns - round(MAX_UNCOVERED_S * NS_PER_S)
    assert early.refusal(covered_ns) == ""
    assert "2.0 s before the first IMU sample" in early.refusal(covered_ns - 1000)
    assert early.refusal(covered_ns - 1000, in_flight=True) == ""  # the back end makes no newer one
    newest_ns = first_ns + 3 * NS_PER_S // 2
    stale_ns = newest_ns - round(MAX_APART_S * NS_PER_S)
    assert early.refusal(stale_ns, in_flight=True) == ""
    assert "30.0 s before the newest IMU sample" in early.refusal(stale_ns - 1000, in_flight=True)
