# SPDX-License-Identifier: Apache-2.0
"""An emulated link follows its configuration, is reproducible, and accounts for every packet."""

import dataclasses
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_vslam.config import LinkConfig
from uav_vslam.cooperation.link import Link, link_between
from uav_vslam.errors import ConfigError
from uav_vslam.types import NS_PER_S

FATES = ("queue_dropped", "blacked_out", "lost", "delivered")
FOREVER_NS = 10**15
MANY = 4000
SHARE_SIGMAS = 4.0  # of the binomial share over MANY packets

BAD = LinkConfig(
    rate_bytes_per_s=1200.0, delay_s=0.1, jitter_s=0.5, loss=0.2, duplication=0.1, blackouts=(5.0, 9.0), seed=3
)


def arrivals(link: Link[Any], times_s: list[float], size_bytes: int = 100) -> list[tuple[int, float]]:
    """Send packets numbered from 0 at the given times; return (number, arrival) with the clock ticking each 10 ms."""
    pending, found = [(round(t * NS_PER_S), number) for number, t in enumerate(times_s)], []
    for tick in range(round((times_s[-1] + 60.0) * 100)):
        now_ns = tick * 10_000_000
        while pending and pending[0][0] <= now_ns:
            link.send(pending[0][0], size_bytes, pending.pop(0)[1])
        found += [(item, tick / 100) for item in link.receive(now_ns)]
    return found


def test_a_perfect_link_delivers_at_once_and_in_order() -> None:
    link: Link[int] = Link(LinkConfig())
    for number in range(5):
        link.send(7, 10**6, number)
    assert link.receive(6) == []
    assert link.receive(7) == [0, 1, 2, 3, 4]
    assert link.receive(8) == []
    assert link.packets == {"offered": 5, "delivered": 5}
    assert link.size_bytes == {"offered": 5 * 10**6, "delivered": 5 * 10**6}


def test_a_packet_arrives_after_the_delay() -> None:
    link: Link[str] = Link(LinkConfig(delay_s=0.25))
    link.send(NS_PER_S, 10, "a")
    assert link.receive(NS_PER_S + 249_999_999) == []
    assert link.receive(NS_PER_S + 250_000_000) == ["a"]


def test_the_rate_spaces_packets_once_the_burst_is_spent() -> None:
    link: Link[int] = Link(LinkConfig(rate_bytes_per_s=1000.0, burst_bytes=500))
    assert arrivals(link, [0.0, 0.0, 0.0], 500) == [(0, 0.0), (1, 0.5), (2, 1.0)]


def test_after_a_pause_at_most_the_burst_leaves_at_once() -> None:
    link: Link[int] = Link(LinkConfig(rate_bytes_per_s=1000.0, burst_bytes=500))
    assert arrivals(link, [0.0, 60.0, 60.0, 60.0], 250) == [(0, 0.0), (1, 60.0), (2, 60.0), (3, 60.25)]


def test_each_direction_has_its_own_reproducible_random_sequence() -> None:
    def received(sender: str, receiver: str) -> list[int]:
        link: Link[int] = link_between(LinkConfig(loss=0.5), sender, receiver)
        for number in range(100):
            link.send(0, 1, number)
        return link.receive(0)

    assert received("a", "b") == received("a", "b") != received("b", "a")


def test_a_packet_larger_than_the_burst_is_delayed() -> None:
    link: Link[int] = Link(LinkConfig(rate_bytes_per_s=1000.0, burst_bytes=500))
    assert arrivals(link, [0.0, 0.0], 1500) == [(0, 1.0), (1, 2.5)]


def test_a_full_queue_drops_the_newcomer() -> None:
    link: Link[int] = Link(LinkConfig(rate_bytes_per_s=100.0, burst_bytes=100, queue_bytes=250))
    found = arrivals(link, [0.0, 0.0, 0.0, 0.0, 1.0], 100)
    assert [number for number, _ in found] == [0, 1, 2, 4]  # 0 leaves at once, 1 and 2 wait, 3 would exceed 250
    assert link.packets["queue_dropped"] == 1
    assert link.size_bytes["queue_dropped"] == 100


def test_jitter_reorders_packets() -> None:
    found = arrivals(Link(LinkConfig(delay_s=0.1, jitter_s=1.0, seed=1)), [0.05 * k for k in range(40)])
    numbers = [number for number, _ in found]
    assert sorted(numbers) == list(range(40))
    assert numbers != sorted(numbers)
    assert all(0.1 <= t - 0.05 * number <= 1.12 for number, t in found)  # and a tick of the clock


def test_nothing_passes_in_a_blackout() -> None:
    link: Link[int] = Link(LinkConfig(blackouts=(1.0, 2.0, 3.0, 3.5)))
    start_s = 1000.0  # a link's time starts with its first packet
    found = arrivals(link, [start_s + 0.5 * k for k in range(9)])
    assert [number for number, _ in found] == [0, 1, 4, 5, 7, 8]
    assert link.packets["blacked_out"] == 3


@pytest.mark.parametrize("share", [0.05, 0.2, 0.7])
def test_loss_and_duplication_rates_are_as_configured(share: float) -> None:
    link: Link[int] = Link(LinkConfig(loss=share, duplication=share, seed=11))
    for number in range(MANY):
        link.send(number, 10, number)
    kept = MANY - link.packets["lost"]
    allowed = SHARE_SIGMAS * (share * (1 - share) / (MANY * (1 - share))) ** 0.5
    assert link.packets["lost"] / MANY == pytest.approx(share, abs=allowed)
    assert link.packets["duplicated"] / kept == pytest.approx(share, abs=allowed)
    assert len(link.receive(FOREVER_NS)) == kept + link.packets["duplicated"]


def test_a_clock_that_is_set_back_begins_the_link_again() -> None:
    link: Link[int] = Link(LinkConfig(rate_bytes_per_s=600.0, burst_bytes=600, delay_s=2.0, blackouts=(0.0, 3.0)))

    def fly() -> list[int]:
        arrived = []
        for second in range(100, 160):
            link.send(second * NS_PER_S, 600, second)
            arrived += link.receive(second * NS_PER_S)
        return arrived

    assert fly() == fly() == list(range(103, 158))
    assert link.packets["offered"] == sum(link.packets[fate] for fate in FATES) + 2  # on the air
    assert link.packets["lost"] == 2


def test_loss_of_zero_and_one_is_deterministic() -> None:
    for loss, expected in ((0.0, 200), (1.0, 0)):
        link: Link[int] = Link(LinkConfig(loss=loss))
        for number in range(200):
            link.send(0, 1, number)
        assert len(link.receive(0)) == expected


def test_the_same_seed_gives_the_same_packets_and_another_seed_others() -> None:
    times = [0.1 * k for k in range(200)]
    first = arrivals(Link(BAD), times)
    assert arrivals(Link(BAD), times) == first
    assert arrivals(Link(dataclasses.replace(BAD, seed=4)), times) != first


def test_a_packet_s_fate_does_not_depend_on_the_size_of_earlier_ones() -> None:
    def lost(sizes: list[int]) -> list[int]:
        link: Link[int] = Link(LinkConfig(rate_bytes_per_s=100.0, queue_bytes=10**9, loss=0.5, seed=5))
        for number, size in enumerate(sizes):
            link.send(0, size, number)
        return sorted(link.receive(FOREVER_NS))

    assert lost([10] * 50) == lost(list(range(1, 51)))


@given(
    rate=st.integers(1, 5000),
    burst=st.integers(0, 3000),
    offers=st.lists(st.tuples(st.integers(0, 3 * NS_PER_S), st.integers(1, 2000)), min_size=1, max_size=40),
)
def test_never_more_than_rate_times_time_and_burst_leaves(rate: int, burst: int, offers: list[tuple[int, int]]) -> None:
    link: Link[int] = Link(LinkConfig(rate_bytes_per_s=float(rate), burst_bytes=burst, queue_bytes=4000))
    now_ns, left = 0, 0
    for pause_ns, size in offers:
        for moment in (now_ns + pause_ns // 2, now_ns + pause_ns):
            left += sum(link.receive(moment))
            assert left <= rate * moment / NS_PER_S + burst + 1e-3
        now_ns += pause_ns
        link.send(now_ns, size, size)
        assert link.queued_bytes <= 4000


@given(
    loss=st.just(0.0) | st.floats(1e-9, 1),
    duplication=st.just(0.0) | st.floats(1e-9, 1),
    rate=st.just(0.0) | st.floats(1, 3000),
    jitter=st.just(0.0) | st.floats(1e-9, 2),
    seed=st.integers(0, 2**32),
    offers=st.lists(st.tuples(st.integers(0, 2 * NS_PER_S), st.integers(0, 2000)), max_size=40),
)
def test_every_packet_offered_has_one_fate(
    loss: float, duplication: float, rate: float, jitter: float, seed: int, offers: list[tuple[int, int]]
) -> None:
    config = dataclasses.replace(
        BAD, loss=loss, duplication=duplication, rate_bytes_per_s=rate, jitter_s=jitter, seed=seed, queue_bytes=3000
    )
    link: Link[int] = Link(config)
    now_ns, received = 0, 0
    for pause_ns, size in offers:
        now_ns += pause_ns
        link.send(now_ns, size, size)
        received += len(link.receive(now_ns))
    received += len(link.receive(FOREVER_NS * 10**6))
    assert received == link.packets["delivered"]
    assert link.packets["offered"] == len(offers)
    for counts in (link.packets, link.size_bytes):
        assert counts["offered"] + counts["duplicated"] == sum(counts[fate] for fate in FATES)


@pytest.mark.parametrize(
    "wrong",
    [
        {"rate_bytes_per_s": -1.0},
        {"loss": 1.1},
        {"loss": float("nan")},
        {"duplication": -0.1},
        {"delay_s": -0.1},
        {"blackouts": (2.0, 1.0)},
        {"blackouts": (3.0, 4.0, 5.0)},
    ],
)
def test_an_impossible_link_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        LinkConfig(**wrong)
