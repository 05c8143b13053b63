# SPDX-License-Identifier: Apache-2.0
"""The token bucket grants what it earned, to the byte, without credit."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_vslam.cooperation.budget import ByteBudget
from uav_vslam.types import NS_PER_S

steps = st.lists(st.tuples(st.integers(0, 3 * NS_PER_S), st.integers(0, 3000)), max_size=60)


def test_a_new_budget_is_full() -> None:
    assert ByteBudget(900, 1400).available(123) == 1400


def test_a_new_budget_starts_with_its_initial_bytes_up_to_the_burst() -> None:
    assert ByteBudget(900, 1400, 900).available(123) == 900
    assert ByteBudget(900, 1400, 2000).available(123) == 1400


def test_the_bucket_refills_at_the_rate_up_to_the_burst() -> None:
    budget = ByteBudget(900, 1400)
    assert budget.spend(0, 1400)
    assert budget.available(0) == 0
    assert budget.available(NS_PER_S // 2) == 450
    assert budget.available(NS_PER_S) == 900
    assert budget.available(100 * NS_PER_S) == 1400


def test_a_packet_that_exceeds_the_budget_takes_nothing() -> None:
    budget = ByteBudget(900, 1000)
    assert budget.spend(0, 400)
    assert not budget.spend(0, 601)
    assert budget.available(0) == 600
    assert budget.spend(0, 600)


def test_many_small_steps_add_as_much_as_one_large() -> None:
    budget = ByteBudget(900, 5000)
    budget.spend(0, 5000)
    for step in range(1, 1001):
        budget.available(step * 3_333_333)
    assert budget.available(1000 * 3_333_333) == 900 * 1000 * 3_333_333 // NS_PER_S


def test_a_clock_that_steps_back_adds_nothing() -> None:
    budget = ByteBudget(900, 1000)
    assert budget.spend(10 * NS_PER_S, 1000)
    assert budget.available(0) == 0
    assert budget.available(10 * NS_PER_S) == 0


def test_a_rate_of_zero_never_refills() -> None:
    budget = ByteBudget(0, 0)
    assert not budget.spend(0, 1)
    assert not budget.spend(10**18, 1)


@pytest.mark.parametrize(("rate", "burst"), [(-1, 0), (0, -1)])
def test_a_negative_budget_is_refused(rate: int, burst: int) -> None:
    with pytest.raises(ValueError, match="negative"):
        ByteBudget(rate, burst)


@given(rate=st.integers(0, 5000), burst=st.integers(0, 3000), steps=steps)
def test_over_any_time_no_more_than_rate_times_time_and_burst_is_granted(
    rate: int, burst: int, steps: list[tuple[int, int]]
) -> None:
    budget, now_ns = ByteBudget(rate, burst), 0
    granted: list[tuple[int, int]] = []
    for pause_ns, size in steps:
        now_ns += pause_ns
        before = budget.available(now_ns)
        if budget.spend(now_ns, size):
            granted.append((now_ns, size))
            assert budget.available(now_ns) == before - size >= 0
        else:
            assert budget.available(now_ns) == before < size
    for first, (begin_ns, _) in enumerate(granted):
        total = 0
        for end_ns, size in granted[first:]:
            total += size
            assert total * NS_PER_S <= rate * (end_ns - begin_ns) + burst * NS_PER_S


def test_a_clock_that_was_set_back_refills_nothing_at_once_and_then_as_before() -> None:
    budget = ByteBudget(100, 200)
    assert budget.spend(100 * NS_PER_S, 200)
    budget.restart_clock()
    assert budget.available(50 * NS_PER_S) == 0
    assert budget.available(51 * NS_PER_S) == 100
