# SPDX-License-Identifier: Apache-2.0
"""What a vehicle sends, relays and refuses, over the links of the offline twin; test_exchange_transports has DDS."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.exchange import Exchange
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.cooperation.inbox import KEPT_PER_PEER, Inbox
from uav_vslam.errors import InvalidMessage
from uav_vslam.fleet import Air, LinkTransport, Sent
from uav_vslam.slam.packet import PacketPolicy, make_packet, payload_bytes
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket

RELAY = FusionConfig(relay=True, feedback=True)
VEHICLES = ("uav1", "uav2", "uav3", "uav4")


class Listener:
    """A peer that only listens."""

    def __init__(self) -> None:
        self.received: list[tuple[str, LandmarkPacket]] = []

    def on_packet(self, sender: str, packet: LandmarkPacket, _: int) -> None:
        self.received.append((sender, packet))

    def on_feedback(self, packet: LandmarkPacket, size_bytes: int) -> None:
        raise AssertionError("no feedback was to be sent")


class Exchanging:
    """uav1 among peers that only listen."""

    def __init__(self, settings: FusionConfig, vehicles: tuple[str, ...] = VEHICLES) -> None:
        self.air = Air(vehicles)
        self.fusion = Fusion("uav1", settings)
        self.exchange = Exchange(self.fusion, vehicles[1:], LinkTransport(self.air, "uav1"), settings)
        self.exchange.configure(settings)
        self.listeners = {name: Listener() for name in vehicles[1:]}
        self.air.receivers |= self.listeners

    def epoch(self, joint: JointInformation) -> None:
        self.fusion.fuse(joint)
        self.exchange.send()
        self.air.deliver(self.air.now_ns)

    def comes(self, sender: str, packet: LandmarkPacket, *, feedback: bool = False) -> set[str]:
        """Deliver something from a peer; return who receives a packet afterwards."""
        before = {name: len(listener.received) for name, listener in self.listeners.items()}
        self.air.send(sender, "uav1", Sent(packet, feedback))
        for _ in ("to uav1", "from uav1"):
            self.air.deliver(self.air.now_ns)
        return {name for name, listener in self.listeners.items() if len(listener.received) > before[name]}


def garbled(packet: LandmarkPacket) -> LandmarkPacket:
    return dataclasses.replace(packet, checksum=packet.checksum ^ 1)


Maker = Callable[..., LandmarkPacket]


def test_a_relay_sends_unchanged_to_all_but_the_sender_and_the_origin(make_small_packet: Maker) -> None:
    vehicle, packet = Exchanging(RELAY), make_small_packet(1)
    assert vehicle.comes("uav2", packet) == {"uav3", "uav4"}
    assert vehicle.listeners["uav4"].received == [("uav1", packet)]
    assert vehicle.comes("uav3", packet) == set()  # no news
    assert vehicle.comes("uav3", make_small_packet(2)) == {"uav4"}


def test_a_relay_without_further_receivers_spends_nothing(make_small_packet: Maker) -> None:
    vehicle = Exchanging(RELAY, VEHICLES[:2])
    assert vehicle.comes("uav2", make_small_packet(1)) == set()
    assert vehicle.exchange.outbox.bytes_sent == 0


def test_a_relayed_duplicate_is_no_drop_but_a_damaged_packet_is(make_small_packet: Maker) -> None:
    vehicle = Exchanging(FusionConfig())
    for packet in (make_small_packet(1), make_small_packet(1), make_small_packet(1, vehicle="uav1")):
        vehicle.comes("uav3", packet)
    assert not vehicle.exchange.dropped
    assert vehicle.fusion.inbox.peers["uav2"].dropped == {"duplicate": 1}
    assert vehicle.fusion.inbox.refused == {"own": 1}
    vehicle.comes("uav3", garbled(make_small_packet(2)))
    vehicle.comes("uav2", make_small_packet(1))
    assert vehicle.exchange.dropped == {"checksum": 1, "duplicate": 1}


TRAFFIC = st.lists(
    st.tuples(
        st.sampled_from(VEHICLES), st.integers(1, 12), st.integers(1, 2), st.sampled_from(("sent", "empty", "bad"))
    ),
    min_size=5,
    max_size=60,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40, deadline=None)
@given(TRAFFIC)
def test_every_packet_received_is_used_dropped_or_waiting(
    make_joint: Callable[..., JointInformation], make_small_packet: Maker, traffic: list[tuple[str, int, int, str]]
) -> None:
    """Whatever comes, from whom, how often and in what order, over restarts of senders and of the own fusion."""
    vehicle = Exchanging(FusionConfig())
    for second, (sender, sequence, session, kind) in enumerate(traffic, start=1):
        packet = make_small_packet(sequence, vehicle=sender, session=session)
        if kind == "empty":
            joint = make_joint(np.zeros((0, 3)), np.eye(6), vehicle=sender, session=session, stamp_ns=packet.stamp_ns)
            packet = make_packet(joint, sequence=sequence, policy=PacketPolicy())
        vehicle.exchange.on_packet("uav2", garbled(packet) if kind == "bad" else packet, 100)
        if second % 2:
            vehicle.epoch(make_joint([[1.0 + 5 * (sequence % 2), 2, 0]], np.eye(9), stamp_ns=second * NS_PER_S))
        if second % 20 == 0:
            vehicle.fusion.restart()
        records = vehicle.fusion.inbox.peers.values()
        assert all(r.received == r.used + r.dropped.total() + r.waiting for r in records)
        assert all(r.waiting <= 2 * KEPT_PER_PEER for r in records)
        assert sum(r.received for r in records) + vehicle.fusion.inbox.refused.total() == second


def test_strangers_and_feedback_among_packets_are_refused_and_not_relayed(make_small_packet: Maker) -> None:
    vehicle, packet = Exchanging(RELAY), make_small_packet(1)
    assert vehicle.comes("uav2", make_small_packet(1, vehicle="uav9")) == set()
    assert vehicle.comes("uav2", dataclasses.replace(packet, sources=(packet.source, "uav1/1"))) == set()
    vehicle.comes("uav2", make_small_packet(1, vehicle="uav9"), feedback=True)
    vehicle.comes("uav2", make_small_packet(1, vehicle="uav1"), feedback=True)
    assert vehicle.exchange.dropped == {"sender": 3, "sources": 1}
    assert vehicle.fusion.inbox.peers == vehicle.fusion.returned.peers == {}


@pytest.mark.parametrize("mode", ["none", "narrowband", "wideband"])
def test_each_mode_receives_only_its_own_channels(make_small_packet: Maker, mode: str) -> None:
    vehicle = Exchanging(FusionConfig(mode=mode, feedback=True))
    vehicle.comes("uav2", make_small_packet(1))
    vehicle.comes("uav3", make_small_packet(1, vehicle="uav3"), feedback=True)
    assert set(vehicle.fusion.inbox.peers) == ({"uav2"} if mode != "none" else set())
    assert set(vehicle.fusion.returned.peers) == ({"uav3"} if mode == "wideband" else set())
    assert bool(vehicle.exchange.received_bytes) == (mode != "none")


def test_a_relay_that_the_budget_has_no_room_for_is_held_back(make_small_packet: Maker) -> None:
    vehicle = Exchanging(dataclasses.replace(RELAY, budget_bytes_per_s=100))
    assert vehicle.comes("uav2", make_small_packet(1)) == set()
    assert vehicle.exchange.dropped == {"budget": 1}
    assert vehicle.fusion.inbox.newest("uav2", 10**18) is not None


def test_a_packet_shrinks_to_what_the_budget_has_room_for(make_joint: Callable[..., JointInformation]) -> None:
    vehicle = Exchanging(FusionConfig(budget_bytes_per_s=1000))
    vehicle.epoch(make_joint(np.arange(18.0).reshape(6, 3), np.eye(24)))
    (_, packet), *more = vehicle.listeners["uav2"].received
    assert 0 < len(packet) < 6
    assert not more
    assert not vehicle.exchange.dropped


def test_a_vehicle_that_receives_a_peer_leaves_no_epoch_to_discovery(
    make_joint: Callable[..., JointInformation], make_small_packet: Maker
) -> None:
    sent, late = {}, {}
    for clock_s in (0, -60, None):  # a peer's clock; None: no peer
        vehicle = Exchanging(FusionConfig(mode="narrowband", budget_bytes_per_s=5000))
        for second in range(100, 115):
            if clock_s is not None:
                vehicle.comes("uav2", make_small_packet(second + clock_s))
            vehicle.epoch(make_joint([[1.0, 2.0, 0.0]], np.eye(9), stamp_ns=second * NS_PER_S))
            late[clock_s] = {peer: vehicle.fusion.inbox.silent_s(peer) for peer in vehicle.fusion.inbox.peers}
        sent[clock_s] = len(vehicle.listeners["uav2"].received)
    assert sent[0] == sent[-60] == 15 > sent[None]
    assert late == {0: {"uav2": 1.0}, -60: {"uav2": 1.0}, None: {}}


def test_after_a_restart_of_the_clock_packets_are_sent_within_the_same_budget(
    make_joint: Callable[..., JointInformation],
) -> None:
    vehicle = Exchanging(FusionConfig())
    for begin in (100, 50):
        for second in range(begin, begin + 3):
            vehicle.epoch(make_joint([[1.0, 2.0, 0.0]], np.eye(9), session=200 - begin, stamp_ns=second * NS_PER_S))
        vehicle.fusion.restart()
        vehicle.exchange.restart()
    assert len(vehicle.listeners["uav2"].received) == 6
    assert vehicle.exchange.outbox.sent_bytes_per_s == pytest.approx(vehicle.exchange.outbox.bytes_sent / 5.0)


@pytest.mark.parametrize("own_epochs", [0, 3])
def test_a_vehicle_without_epochs_relays_what_its_budget_earns(
    make_joint: Callable[..., JointInformation], make_small_packet: Maker, own_epochs: int
) -> None:
    """It only relays, or its back end has stopped. The sender's clock is a minute behind: no stamp is too far ahead."""
    size = payload_bytes(make_small_packet(1))
    vehicle = Exchanging(dataclasses.replace(RELAY, budget_bytes_per_s=size))
    for second in range(100, 160):
        vehicle.air.now_ns = second * NS_PER_S
        if second < 100 + own_epochs:
            vehicle.epoch(make_joint([[1.0, 2.0, 0.0]], np.eye(9), stamp_ns=second * NS_PER_S))
        vehicle.comes("uav2", make_small_packet(second - 60))
    relayed = sum(packet.vehicle == "uav2" for _, packet in vehicle.listeners["uav3"].received)
    assert 50 <= relayed <= 60
    assert vehicle.exchange.outbox.bytes_sent <= size * (60 + 1)
    assert vehicle.exchange.outbox.sent_bytes_per_s == pytest.approx(size, rel=0.2)


@pytest.mark.parametrize("reset", [False, True])
def test_while_the_own_back_end_is_silent_a_peer_is_relayed_and_found_when_it_goes_on(
    make_joint: Callable[..., JointInformation], make_small_packet: Maker, reset: bool
) -> None:
    """The peer's process starts again in between; its new session is taken, and nothing seems to be ahead."""
    vehicle, joint = Exchanging(dataclasses.replace(RELAY, budget_bytes_per_s=10_000)), make_joint
    for second in range(100, 160):
        vehicle.air.now_ns = second * NS_PER_S
        if second < 103 or second >= 150:
            session = 1 + (reset and second >= 150)
            if reset and second == 150:
                vehicle.fusion.restart()
                vehicle.exchange.restart()
            vehicle.epoch(joint([[1.0, 2.0, 0.0]], np.eye(9), session=session, stamp_ns=second * NS_PER_S))
            newest = vehicle.fusion.inbox.newest("uav2", second * NS_PER_S) if second > 100 else None
            assert newest is None or newest.stamp_ns == (second - 1) * NS_PER_S
        if not 120 <= second < 130:
            vehicle.comes("uav2", make_small_packet(second, session=1 + (second >= 130)))
    relayed = [packet.session for _, packet in vehicle.listeners["uav3"].received if packet.vehicle == "uav2"]
    assert relayed == [1] * 20 + [2] * 30
    inbox = vehicle.fusion.inbox
    assert not vehicle.exchange.dropped
    assert inbox.peers["uav2"].ahead_ns == 0
    assert inbox.silent_s("uav2") == 0.0


def test_a_second_session_takes_over_neither_while_own_epochs_pause_nor_when_they_go_on(
    make_small_packet: Maker,
) -> None:
    inbox, reasons = Inbox("uav1"), set()
    own_s = [*range(100, 103), *[None] * 8, *range(103, 110)]  # it works off what has waited
    for second, own in enumerate(own_s, start=100):
        if own is not None:
            inbox.advance(own * NS_PER_S, session=1)
        inbox.go_on(second * NS_PER_S)
        if second > 100:
            with pytest.raises(InvalidMessage) as refused:
                inbox.add(make_small_packet(second, session=2))
            reasons.add(refused.value.reason)
        inbox.add(make_small_packet(second))
    assert reasons == {"other_session"}


@pytest.mark.parametrize("reset", [False, True])
def test_the_first_epoch_after_relayed_packets_does_not_refill_the_budget(
    make_joint: Callable[..., JointInformation], make_small_packet: Maker, reset: bool
) -> None:
    vehicle, joint = Exchanging(dataclasses.replace(RELAY, budget_bytes_per_s=10_000)), make_joint
    if reset:
        vehicle.epoch(joint([[1.0, 2.0, 0.0]], np.eye(9), stamp_ns=10**18))
        vehicle.fusion.restart()
        vehicle.exchange.restart()
    assert vehicle.comes("uav2", make_small_packet(1)) == {"uav3", "uav4"}
    vehicle.epoch(joint([[1.0, 2.0, 0.0]], np.eye(9), stamp_ns=10**18))
    outbox = vehicle.exchange.outbox
    assert outbox.packets_sent == 2 + reset
    assert outbox.available(10**18) == 10_000 - outbox.bytes_sent
