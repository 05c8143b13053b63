# SPDX-License-Identifier: Apache-2.0
"""A step of one sensor's stamps that the lag between the sensors follows is a clock; any other is a loss."""

from collections.abc import Iterable

import numpy as np
import pytest

from uav_vslam.ins.sensor_clock import SensorTimeLine, sensor_time_line
from uav_vslam.ins.sensor_lag import IMAGES, IMU
from uav_vslam.types import NS_PER_S

MS = NS_PER_S // 1000
SET_MS = 2000  # when it happens, of 4 s
Arrival = tuple[int, str, int]  # when, stream, stamp [ms]


def arrivals(*, image_delay_ms: int = 0, end_ms: int = 4000) -> list[Arrival]:
    """Return readings at 200 Hz and images at 10 Hz in the order of their arrival."""
    readings = [(at_ms, IMU, at_ms) for at_ms in range(0, end_ms, 5)]
    images = [(at_ms + image_delay_ms, IMAGES, at_ms) for at_ms in range(0, end_ms, 100)]
    return sorted(arrival for arrival in [*readings, *images] if arrival[0] < end_ms)


def feed(arriving: Iterable[Arrival]) -> tuple[SensorTimeLine, list[tuple[str, int]]]:
    """Return the time line, and stream and stamp [ms] of what it let through."""
    line, passed = sensor_time_line("bridge"), []
    for _, name, stamp_ms in arriving:
        passed += line.add(name, stamp_ms * MS, stamp_ms).items
    return line, passed


@pytest.mark.parametrize("image_delay_ms", [0, 80, 250])
@pytest.mark.parametrize("name", [IMU, IMAGES])
@pytest.mark.parametrize("step_ms", [-2000, -300, -60, 60, 300, 2000])
def test_a_clock_that_was_set_is_refused_from_its_first_message_on(
    name: str, step_ms: int, image_delay_ms: int
) -> None:
    events = arrivals(image_delay_ms=image_delay_ms)
    wrong = [(at, each, ms + step_ms) if each == name and ms >= SET_MS else (at, each, ms) for at, each, ms in events]
    line, passed = feed(wrong)
    assert passed == [(each, ms) for _, each, ms in events if each != name or ms < SET_MS]
    assert list(line.faults) == [name]
    assert f"{name} stamps jump by {step_ms / 1000:+.2f} s" in line.faults[name]
    assert line.refused["stamp_jump"] + line.refused["stamp_repeated"] == len(events) - len(passed)


@pytest.mark.parametrize("lost_ms", [50, 300, 1500])
@pytest.mark.parametrize("lost", [(IMU,), (IMAGES,), (IMU, IMAGES)])
def test_what_comes_after_a_loss_is_used(lost: tuple[str, ...], lost_ms: int) -> None:
    gap = range(SET_MS, SET_MS + lost_ms)
    arriving = [(at, name, ms) for at, name, ms in arrivals(end_ms=5000) if not (name in lost and ms in gap)]
    line, passed = feed(arriving)
    assert sorted(passed) == sorted((name, ms) for _, name, ms in arriving)
    assert not line.refused


def test_readings_are_used_after_two_seconds_if_the_camera_dies_before_the_lag_is_certain() -> None:
    shifted = [(at, name, ms + 300 * (name == IMU and ms >= SET_MS)) for at, name, ms in arrivals(end_ms=6000)]
    arriving = [(at, name, ms) for at, name, ms in shifted if name == IMU or ms <= SET_MS]
    _, passed = feed(arriving)
    assert sorted(passed) == sorted((name, ms) for _, name, ms in arriving)


def test_a_machine_that_falls_behind_is_no_clock_even_if_it_loses_messages() -> None:
    """Images take 0.4 s more from then on, and one of three is lost; with the load, the delay also varies."""
    rng = np.random.default_rng(1)
    late = [
        (at + (400 + int(rng.integers(0, 60)) if at >= SET_MS and name == IMAGES else 0), name, ms)
        for at, name, ms in arrivals(end_ms=8000)
        if name == IMU or at < SET_MS or at % 300
    ]
    line, passed = feed(sorted(late))
    assert sorted(passed) == sorted((name, ms) for _, name, ms in late)
    assert not line.faults


def test_nineteen_of_twenty_readings_lost_at_random_are_no_clock() -> None:
    rng = np.random.default_rng(1)
    kept = [arrival for arrival in arrivals(end_ms=20_000) if arrival[1] == IMAGES or rng.random() < 0.05]
    line, passed = feed(kept)
    assert not line.refused
    assert {name for name, _ in passed} == {IMU, IMAGES}


def test_stray_stamps_cost_nothing_else() -> None:
    events = arrivals()
    at = next(k for k, (_, name, ms) in enumerate(events) if name == IMAGES and ms == SET_MS)
    strays = [(0, IMU, SET_MS + 700), (0, IMU, SET_MS - 700), (0, IMAGES, SET_MS + 700)]
    for stray in strays:
        line, passed = feed([*events[:at], stray, *events[at:]])
        assert sorted(passed) == sorted((name, ms) for _, name, ms in events)
        assert line.refused == {"stamp_jump": 1}
        assert not line.faults


@pytest.mark.parametrize("set_name", [IMU, IMAGES])
@pytest.mark.parametrize("step_ms", [-300, 300])
def test_a_clock_that_is_right_again_is_used_again_at_once(set_name: str, step_ms: int) -> None:
    events, wrong = arrivals(), range(SET_MS, SET_MS + 1010)
    line, passed = feed((at, name, ms + step_ms * (name == set_name and ms in wrong)) for at, name, ms in events)
    assert sorted(passed) == sorted((name, ms) for _, name, ms in events if name != set_name or ms not in wrong)
    assert not line.faults


@pytest.mark.parametrize("name", [IMU, IMAGES])
def test_a_stream_whose_stamps_never_advance_stops_nothing(name: str) -> None:
    """As of a driver that does not set them: no usual spacing is known of it."""
    events = arrivals()
    _, passed = feed((at, each, 0 if each == name else ms) for at, each, ms in events)
    assert [(each, ms) for each, ms in passed if each != name] == [(each, ms) for _, each, ms in events if each != name]
    assert [ms for each, ms in passed if each == name] == [0]
