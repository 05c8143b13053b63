# SPDX-License-Identifier: Apache-2.0
"""What the budget has no room for isn't sent, whatever the mode, and all is counted."""

import pytest

from uav_vslam.config import MODE_BUDGETS, FusionConfig
from uav_vslam.cooperation.outbox import Outbox
from uav_vslam.types import NS_PER_S

FRAME_NS = 140_056_022  # 7.14 Hz: epochs come after 7 or 8 frames


def epochs(count: int) -> list[int]:
    """Stamps of the frames that first pass each second."""
    return [-(-k * NS_PER_S // FRAME_NS) * FRAME_NS for k in range(1, count + 1)]


@pytest.mark.parametrize("mode", ["wideband", "narrowband"])
def test_packets_as_large_as_the_budget_on_average_all_leave_although_epochs_are_uneven(mode: str) -> None:
    outbox = Outbox(FusionConfig(mode=mode))
    assert all(outbox.take(stamp_ns, MODE_BUDGETS[mode]) for stamp_ns in epochs(100))
    assert outbox.over_budget == 0
    assert outbox.sent_bytes_per_s == pytest.approx(MODE_BUDGETS[mode], rel=0.01)


def test_larger_packets_are_held_back_until_the_budget_has_earned_them() -> None:
    outbox = Outbox(FusionConfig(mode="narrowband"))
    sent = [outbox.take(stamp_ns, 1350) for stamp_ns in epochs(90)]
    assert sent.count(True) == outbox.packets_sent
    assert sent.count(False) == outbox.over_budget
    assert 45 <= outbox.packets_sent <= 61  # two of three have been earned, but no more than two epochs' are saved
    assert outbox.bytes_sent == 1350 * outbox.packets_sent
    assert not outbox.take(10**15, 1801)  # more than two epochs earn, however long one waits


def test_a_budget_of_ones_own_replaces_the_modes() -> None:
    assert Outbox(FusionConfig(mode="narrowband", budget_bytes_per_s=5000)).available(0) == 10_000
    assert Outbox(FusionConfig(mode="narrowband", budget_bytes_per_s=5000, epoch_s=0.5)).available(0) == 5000


def test_another_mode_brings_its_budget_and_keeps_the_counts() -> None:
    outbox = Outbox(FusionConfig(mode="wideband"))
    assert outbox.take(0, 80_000)
    outbox.configure(FusionConfig(mode="narrowband"))
    assert not outbox.take(NS_PER_S, 80_000)
    assert outbox.take(NS_PER_S, 900)
    assert (outbox.packets_sent, outbox.bytes_sent, outbox.over_budget) == (2, 80_900, 1)


def test_nothing_leaves_a_vehicle_that_does_not_cooperate() -> None:
    outbox = Outbox(FusionConfig(mode="none"))
    assert not outbox.take(10**15, 1)


def test_before_the_first_packet_the_rate_is_zero() -> None:
    assert Outbox(FusionConfig()).sent_bytes_per_s == 0.0


def turns(outbox: Outbox, seconds: range) -> list[bool]:
    return [outbox.is_turn(second * NS_PER_S) for second in seconds]


def test_while_nobody_is_heard_a_narrow_radio_is_left_to_discovery() -> None:
    outbox = Outbox(FusionConfig(mode="narrowband", silent_after_s=2.0))
    assert turns(outbox, range(101, 109)) == [True, True, True, True, False, False, True, False]
    outbox.hear(108 * NS_PER_S)
    outbox.hear(99 * NS_PER_S)  # a late packet makes nobody silent
    assert turns(outbox, range(109, 118)) == [True] * 6 + [False, False, True]


@pytest.mark.parametrize(("mode", "expected"), [("wideband", True), ("none", False)])
def test_other_modes_send_at_every_epoch_or_at_none(mode: str, expected: bool) -> None:
    assert turns(Outbox(FusionConfig(mode=mode)), range(5)) == [expected] * 5


def test_a_stamp_from_the_future_does_not_pass_for_a_peer_that_is_heard_for_ever() -> None:
    outbox = Outbox(FusionConfig(mode="narrowband"))
    turns(outbox, range(100, 101))
    outbox.hear(10**18)
    assert turns(outbox, range(101, 104)) == [True, True, True]
    assert turns(outbox, range(120, 126)) == [True, True, True, True, False, False]
