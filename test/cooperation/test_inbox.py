# SPDX-License-Identifier: Apache-2.0
"""At most one packet of a vehicle counts; loss, repetition and disorder on the radio are harmless."""

import dataclasses

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uav_vslam.cooperation.authentication import FleetKey
from uav_vslam.cooperation.inbox import KEPT_PER_PEER, MAX_PEERS, Inbox
from uav_vslam.errors import InvalidMessage
from uav_vslam.slam.packet import PacketPolicy, checksum, make_packet
from uav_vslam.types import LandmarkPacket

END_NS = 10**15


def keys(inbox: Inbox, peer: str = "uav2") -> list[tuple[int, int]]:
    return [(p.session, p.sequence) for p in inbox.peers[peer].packets]


def offer(inbox: Inbox, packet) -> str:
    """Add a packet and return why it was refused, or ""."""
    try:
        inbox.add(packet)
    except InvalidMessage as error:
        return error.reason
    return ""


def test_a_newer_packet_replaces_an_older_one(make_small_packet) -> None:
    inbox = Inbox("uav1")
    for sequence in (1, 2, 3):
        inbox.add(make_small_packet(sequence))
        assert inbox.newest("uav2", END_NS).sequence == sequence


def test_an_epoch_gets_the_newest_packet_that_is_old_enough(make_small_packet) -> None:
    inbox = Inbox("uav1")
    for sequence in (1, 2, 3):
        inbox.add(make_small_packet(sequence))
    assert inbox.newest("uav2", 2_000_000_000).sequence == 2
    assert inbox.newest("uav2", 1_999_999_999).sequence == 1
    assert inbox.newest("uav2", 999_999_999) is None
    assert inbox.newest("uav9", END_NS) is None


def test_a_restarted_peer_withdraws_its_earlier_packets(make_small_packet) -> None:
    inbox = Inbox("uav1")
    inbox.add(make_small_packet(7))
    inbox.add(make_small_packet(1, session=2, stamp_ns=9_000_000_000))
    assert keys(inbox) == [(2, 1)]
    assert inbox.newest("uav2", 8_000_000_000) is None  # the older session's number is not fallen back on
    assert offer(inbox, make_small_packet(8)) == "stale_session"


def test_each_refusal_is_counted_by_its_reason(make_small_packet) -> None:
    inbox = Inbox("uav1")
    packet = make_small_packet(5)
    assert offer(inbox, packet) == ""
    assert offer(inbox, packet) == "duplicate"
    assert offer(inbox, packet) == "duplicate"
    assert offer(inbox, dataclasses.replace(packet, checksum=packet.checksum ^ 1)) == "checksum"
    for sequence in (6, 7, 8):
        inbox.add(make_small_packet(sequence))
    assert offer(inbox, make_small_packet(4)) == "late"
    record = inbox.peers["uav2"]
    assert record.received == 8
    assert dict(record.dropped) == {"duplicate": 2, "checksum": 1, "late": 1}


def test_own_packets_that_come_back_are_refused(make_small_packet) -> None:
    inbox = Inbox("uav1")
    assert offer(inbox, make_small_packet(1, vehicle="uav1")) == "own"
    assert inbox.newest("uav1", END_NS) is None


def test_peers_do_not_disturb_each_other(make_small_packet) -> None:
    inbox = Inbox("uav1")
    inbox.add(make_small_packet(1))
    inbox.add(make_small_packet(1, vehicle="uav3", session=9))
    assert keys(inbox) == [(1, 1)]
    assert keys(inbox, "uav3") == [(9, 1)]


def test_a_packet_without_landmarks_withdraws_nothing(make_small_packet, make_joint) -> None:
    def empty(sequence: int, session: int = 1) -> LandmarkPacket:
        joint = make_joint(np.zeros((0, 3)), np.eye(6), vehicle="uav2", session=session, stamp_ns=10**9 * sequence)
        return make_packet(joint, sequence=sequence, policy=PacketPolicy())

    inbox = Inbox("uav1")
    for packet in (empty(1), make_small_packet(2), *map(empty, range(3, 9))):
        inbox.add(packet)
    assert inbox.newest("uav2", END_NS).sequence == 2
    assert offer(inbox, empty(8)) == "duplicate"
    inbox.add(empty(1, session=2))  # but a restart does
    assert inbox.newest("uav2", END_NS) is None
    assert inbox.peers["uav2"].arrived[-1].session == 2


def test_a_restarted_fusion_node_that_counts_from_the_beginning_is_received(make_small_packet) -> None:
    inbox = Inbox("uav1")
    for sequence in range(1, 9):
        inbox.add(make_small_packet(sequence))
    inbox.add(make_small_packet(1, stamp_ns=9 * 10**9))
    assert inbox.newest("uav2", END_NS).stamp_ns == 9 * 10**9
    assert offer(inbox, make_small_packet(8)) == "duplicate"


def test_nobody_without_the_key_makes_a_receiver_compute(make_small_packet) -> None:
    packet = dataclasses.replace(make_small_packet(1), covariance_scale=np.nan)  # contents are wrong as well
    packet = dataclasses.replace(packet, checksum=checksum(packet))
    assert offer(Inbox("uav1", authentication=FleetKey(b"k" * 32)), packet) == "signature"
    assert offer(Inbox("uav1"), packet) == "not_finite"


def test_strangers_whose_packets_are_bad_get_no_record(make_small_packet) -> None:
    inbox = Inbox("uav1")
    for vehicle in ("mallory", "uav7"):
        packet = make_small_packet(1, vehicle=vehicle)
        assert offer(inbox, dataclasses.replace(packet, checksum=packet.checksum ^ 1)) == "checksum"
    assert inbox.peers == {}
    assert dict(inbox.refused) == {"checksum": 2}


def test_forged_names_do_not_fill_the_memory(make_small_packet) -> None:
    inbox = Inbox("uav0")
    reasons = [offer(inbox, make_small_packet(1, vehicle=f"uav{k + 1}")) for k in range(MAX_PEERS + 3)]
    assert reasons == [""] * MAX_PEERS + ["too_many_peers"] * 3
    assert offer(inbox, make_small_packet(2, vehicle="uav1")) == ""  # who is known stays welcome


def test_without_the_fleets_tag_nothing_comes_in_and_nothing_is_withdrawn(make_small_packet) -> None:
    key = FleetKey(b"k" * 32)
    inbox = Inbox("uav1", authentication=key)
    assert offer(inbox, key.sign(make_small_packet(1))) == ""
    assert offer(inbox, make_small_packet(2)) == "signature"
    assert offer(inbox, FleetKey(b"x" * 32).sign(make_small_packet(1, session=9))) == "signature"
    assert keys(inbox) == [(1, 1)]
    assert dict(inbox.peers["uav2"].dropped) == {"signature": 2}


def test_recorded_packets_that_are_sent_again_are_refused(make_small_packet) -> None:
    key = FleetKey(b"k" * 32)
    inbox = Inbox("uav1", authentication=key)
    recorded = [key.sign(make_small_packet(k, session=s)) for s in (1, 2) for k in range(1, 8)]
    assert [offer(inbox, packet) for packet in recorded] == [""] * 14
    before = keys(inbox)
    reasons = [offer(inbox, packet) for packet in recorded]
    assert reasons == ["stale_session"] * 7 + ["late"] * 3 + ["duplicate"] * 4
    assert keys(inbox) == before


ARRIVALS = st.lists(st.tuples(st.integers(1, 3), st.integers(1, 7)), min_size=1, max_size=25)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(ARRIVALS, st.data())
def test_what_is_kept_depends_on_what_came_and_not_on_its_order(make_small_packet, arrivals, data) -> None:
    expected = sorted({key for key in arrivals if key[0] == max(a[0] for a in arrivals)})[-KEPT_PER_PEER:]
    for order in (arrivals, data.draw(st.permutations(arrivals)), arrivals + arrivals[::-1]):
        inbox = Inbox("uav1")
        for session, sequence in order:
            offer(inbox, make_small_packet(sequence, session=session))
        assert keys(inbox) == expected
        assert inbox.newest("uav2", END_NS).sequence == expected[-1][1]
        assert inbox.peers["uav2"].received == len(order)
