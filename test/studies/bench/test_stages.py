# SPDX-License-Identifier: Apache-2.0
"""Ratios of times mean what they say, on a clock that only the works advance."""

from collections.abc import Callable

import pytest

from uav_vslam.studies.bench import stages as speed
from uav_vslam.studies.bench.stages import medians, take_turns

Takes = Callable[[float], Callable[[], None]]


@pytest.fixture
def takes(monkeypatch: pytest.MonkeyPatch) -> Takes:
    """Return a maker of works that take so many milliseconds."""
    now_ns = 0

    def work(ms: float) -> Callable[[], None]:
        def run() -> None:
            nonlocal now_ns
            now_ns += round(1e6 * ms)

        return run

    monkeypatch.setattr(speed.time, "process_time_ns", lambda: now_ns)
    return work


def test_it_returns_the_median_of_the_works_and_its_ratio_to_the_reference(takes: Takes) -> None:
    assert take_turns([takes(4.0), takes(40.0), takes(6.0)], takes(2.0)) == (6.0, 3.0)


def test_the_reference_may_be_slow_at_its_first_call(takes: Takes) -> None:
    calls = iter([takes(1000.0), takes(1.0), takes(1.0)])
    assert take_turns([takes(5.0), takes(5.0)], lambda: next(calls)()) == (5.0, 5.0)


def test_the_ratio_is_that_of_neighbours_however_the_machine_slows_down(takes: Takes) -> None:
    pairs = [(takes(slow * 3.0), takes(slow * other)) for slow, other in ((1.0, 1.0), (2.0, 3.0), (10.0, 1.0))]
    assert medians(pairs) == (6.0, 6.0, 3.0)
