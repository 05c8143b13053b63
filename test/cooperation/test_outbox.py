# SPDX-License-Identifier: Apache-2.0
"""Packets that exceed the budget are not sent, whatever the mode, and all are counted."""

import pytest

from uav_vslam.config import MODE_BUDGETS, FusionConfig
from uav_vslam.cooperation.outbox import Outbox
from uav_vslam.slam.packet import NARROWBAND_PACKET_BYTES
from uav_vslam.types import NS_PER_S

FRAME_NS = 140_056_022  # 7.14 Hz: epochs come after 7 or 8 frames


def epochs(count: int) -> list[int]:
    """Stamps of the frames that first pass each second."""
    return [-(-k * NS_PER_S // FRAME_NS) * FRAME_NS for k in range(1, count + 1)]


def test_packets_as_large_as_the_budget_on_average_all_leave_although_epochs_are_uneven() -> None:
    outbox = Outbox(FusionConfig(mode="wideband"))
    stamps = epochs(100)
    assert not outbox.try_reserve(stamps[0], MODE_BUDGETS["wideband"] + 1)
    sent = [outbox.try_reserve(stamp_ns, MODE_BUDGETS["wideband"]) for stamp_ns in stamps]
    assert sent.count(True) >= 98  # the budget starts with one share and saves two at most
    assert outbox.sent_bytes_per_s == pytest.approx(MODE_BUDGETS["wideband"], rel=0.02)


def test_narrowband_saves_for_large_packets_and_uses_up_its_budget() -> None:
    outbox, sizes = Outbox(FusionConfig(mode="narrowband")), []
    for stamp_ns in epochs(90):
        if outbox.should_send(stamp_ns):
            sizes.append(min(outbox.available(stamp_ns), NARROWBAND_PACKET_BYTES))
            assert outbox.try_reserve(stamp_ns, sizes[-1])
            assert outbox.bytes_sent <= 900 * (stamp_ns / NS_PER_S + 1)  # from the very first epoch on
        outbox.on_packet()
    assert 55 <= len(sizes) <= 65  # two epochs of three
    assert min(sizes) >= 1125
    assert max(sizes) == NARROWBAND_PACKET_BYTES
    assert outbox.sent_bytes_per_s == pytest.approx(900, rel=0.02)
    assert not outbox.try_reserve(10**15, 1801)  # more than two epochs earn, however long one waits


def test_where_every_peer_costs_a_copy_narrowband_saves_for_all_of_them() -> None:
    outbox, sent = Outbox(FusionConfig(mode="narrowband")), 0
    outbox.configure(FusionConfig(mode="narrowband"), copies=5)
    for stamp_ns in epochs(90):
        if outbox.should_send(stamp_ns, copies=5):
            assert outbox.available(stamp_ns) // 5 >= 1125
            assert outbox.try_reserve(stamp_ns, 5 * 1125)
            sent += 1
        outbox.on_packet()
    assert 13 <= sent <= 15


@pytest.mark.parametrize(("rate", "first"), [(300, [False, True, False]), (5000, [True, True, True])])
def test_a_narrowband_of_ones_own_waits_for_its_own_share(rate: int, first: list[bool]) -> None:
    outbox, turns_taken = Outbox(FusionConfig(mode="narrowband", budget_bytes_per_s=rate)), []
    for stamp_ns in (0, NS_PER_S, 2 * NS_PER_S):
        turns_taken.append(outbox.should_send(stamp_ns))
        if turns_taken[-1]:
            assert outbox.try_reserve(stamp_ns, min(outbox.available(stamp_ns), NARROWBAND_PACKET_BYTES))
    assert turns_taken == first


def test_a_budget_of_ones_own_replaces_the_modes() -> None:
    assert Outbox(FusionConfig(mode="narrowband", budget_bytes_per_s=5000)).available(0) == 5000
    assert Outbox(FusionConfig(mode="narrowband", budget_bytes_per_s=5000, epoch_s=0.5)).available(0) == 2500


def test_another_mode_brings_its_budget_and_keeps_the_counts() -> None:
    outbox = Outbox(FusionConfig(mode="wideband"))
    assert outbox.try_reserve(0, 80_000)
    outbox.configure(FusionConfig(mode="narrowband"))
    assert not outbox.try_reserve(NS_PER_S, 80_000)
    assert outbox.try_reserve(NS_PER_S, 900)
    assert (outbox.packets_sent, outbox.bytes_sent) == (2, 80_900)


def test_nothing_leaves_a_vehicle_that_does_not_cooperate() -> None:
    outbox = Outbox(FusionConfig(mode="none"))
    assert not outbox.try_reserve(10**15, 1)


def test_before_the_first_packet_the_rate_is_zero() -> None:
    assert Outbox(FusionConfig()).sent_bytes_per_s == 0.0


def turns(outbox: Outbox, seconds: range) -> list[bool]:
    return [outbox.should_send(second * NS_PER_S) for second in seconds]


def test_narrowband_without_peers_leaves_the_radio_to_discovery() -> None:
    outbox = Outbox(FusionConfig(mode="narrowband", silent_after_s=2.0))
    assert turns(outbox, range(100, 101)) == [False]  # nothing saved yet
    assert turns(outbox, range(101, 108)) == [True] * 4 + [False] * 3
    outbox.on_packet()
    assert turns(outbox, range(108, 119)) == [True] * 7 + [False] * 3 + [True]


@pytest.mark.parametrize(("mode", "expected"), [("wideband", True), ("none", False)])
def test_other_modes_send_at_every_epoch_or_at_none(mode: str, expected: bool) -> None:
    assert turns(Outbox(FusionConfig(mode=mode)), range(5)) == [expected] * 5


def test_what_is_relayed_before_the_first_epoch_counts_in_the_mean_rate_and_its_time_does_not() -> None:
    outbox = Outbox(FusionConfig(mode="narrowband"))
    assert outbox.try_reserve(outbox.now_ns, 500)
    begin_ns = 1_700_000_000 * NS_PER_S
    for stamp_ns in (begin_ns + each for each in epochs(60)):
        outbox.on_packet()
        if outbox.should_send(stamp_ns):
            assert outbox.try_reserve(stamp_ns, min(outbox.available(stamp_ns), NARROWBAND_PACKET_BYTES))
    assert outbox.sent_bytes_per_s == pytest.approx(900, rel=0.05)


def test_a_clock_set_again_before_anything_was_sent_leaves_the_mean_rate() -> None:
    outbox = Outbox(FusionConfig(mode="narrowband"))
    begin_ns = 1_700_000_000 * NS_PER_S
    for stamp_ns in (begin_ns + each for each in epochs(60)):
        if outbox.should_send(stamp_ns):
            assert outbox.try_reserve(stamp_ns, 900)
    rate = outbox.sent_bytes_per_s
    for _ in range(2):
        outbox.restart_clock()
        outbox.should_send(begin_ns)
    assert outbox.sent_bytes_per_s == rate > 0
