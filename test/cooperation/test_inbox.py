# SPDX-License-Identifier: Apache-2.0
"""At most one packet of a vehicle counts; loss, repetition and disorder on the radio are harmless."""

import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uav_vslam.cooperation.authentication import FleetKey
from uav_vslam.cooperation.inbox import (
    AHEAD,
    KEPT_PER_PEER,
    MAX_PEERS,
    MIN_DELAY_S,
    MOST_AHEAD,
    NOTHING_COMMON,
    RECENTLY_USED,
    SESSION_ENDED,
    SUPERSEDED,
    Inbox,
)
from uav_vslam.cooperation.sessions import FUTURE_S, HANDOVER_S
from uav_vslam.errors import InvalidMessage
from uav_vslam.slam.packet import PacketPolicy, checksum, make_packet
from uav_vslam.types import LandmarkPacket

END_NS = 10**15
OWN_SESSION = 1
S_NS = 10**9
PAUSE_NS = round(HANDOVER_S * S_NS)


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
    inbox.advance(8 * S_NS, OWN_SESSION)
    inbox.add(make_small_packet(7))
    inbox.advance(8 * S_NS + PAUSE_NS, OWN_SESSION)
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


def test_each_packet_is_used_dropped_for_one_reason_or_waiting(make_small_packet) -> None:
    inbox = Inbox("uav1")
    for sequence in range(1, 4):
        inbox.add(make_small_packet(sequence))
    record = inbox.peers["uav2"]
    record.record_use(record.packets[0], 3)
    record.record_use(record.packets[0], 2)  # at the next epoch again
    record.record_use(record.packets[1], 0)
    assert (record.waiting, record.used, dict(record.dropped)) == (2, 1, {})
    for sequence in range(4, 8):
        inbox.add(make_small_packet(sequence))
    assert dict(record.dropped) == {NOTHING_COMMON: 1, SUPERSEDED: 1}
    record.withdraw()
    assert (record.received, record.waiting, record.used) == (7, 0, 1)
    assert dict(record.dropped) == {NOTHING_COMMON: 1, SUPERSEDED: 1, SESSION_ENDED: 4}


def test_a_record_takes_no_more_memory_however_many_packets_were_used(make_small_packet) -> None:
    inbox, sizes = Inbox("uav1"), []
    for sequence in range(1, 3 * RECENTLY_USED):
        packet = make_small_packet(sequence)
        inbox.advance(packet.stamp_ns, OWN_SESSION)
        inbox.add(packet)
        inbox.peers["uav2"].record_use(packet, 3)
        sizes.append(len(pickle.dumps(inbox)))
    record = inbox.peers["uav2"]
    assert record.used == 3 * RECENTLY_USED - 1
    assert record.recently_used[-1] == (1, 3 * RECENTLY_USED - 1)
    assert max(sizes) < 1.05 * sizes[RECENTLY_USED + 100]


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
    inbox.advance(10 * S_NS, OWN_SESSION)
    inbox.add(make_small_packet(10))
    inbox.advance(10 * S_NS + PAUSE_NS, OWN_SESSION)
    inbox.add(empty(11, session=2))  # but a restart does
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
    packet = dataclasses.replace(packet, checksum=checksum(packet), tag=bytes(16))
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
    assert offer(inbox, make_small_packet(2)) == "unsigned"
    assert offer(inbox, FleetKey(b"x" * 32).sign(make_small_packet(1, session=9))) == "signature"
    assert keys(inbox) == [(1, 1)]
    assert dict(inbox.peers["uav2"].dropped) == {"unsigned": 1, "signature": 1}


def test_recorded_packets_that_are_sent_again_are_refused(make_small_packet) -> None:
    key = FleetKey(b"k" * 32)
    inbox = Inbox("uav1", authentication=key)
    recorded = [key.sign(make_small_packet(7 * (s - 1) + k, session=s)) for s in (1, 2) for k in range(1, 8)]
    for packet in recorded:
        assert offer(inbox, packet) == ""
        inbox.advance(packet.stamp_ns + (packet.sequence == 7) * PAUSE_NS, OWN_SESSION)
    before = keys(inbox)
    inbox.advance(30 * S_NS, OWN_SESSION)  # long after
    reasons = [offer(inbox, packet) for packet in recorded]
    assert reasons == ["stale_session"] * 7 + ["late"] * 3 + ["duplicate"] * 4
    assert keys(inbox) == before


ARRIVALS = st.lists(st.integers(1, 7), min_size=1, max_size=25)


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(ARRIVALS, st.data())
def test_what_is_kept_depends_on_what_came_and_not_on_its_order(make_small_packet, arrivals, data) -> None:
    expected = sorted({(1, sequence) for sequence in arrivals})[-KEPT_PER_PEER:]
    for order in (arrivals, data.draw(st.permutations(arrivals)), arrivals + arrivals[::-1]):
        inbox = Inbox("uav1")
        for sequence in order:
            offer(inbox, make_small_packet(sequence))
        assert keys(inbox) == expected
        assert inbox.newest("uav2", END_NS).sequence == expected[-1][1]
        assert inbox.peers["uav2"].received == len(order)


def hear(inbox: Inbox, packet: LandmarkPacket, now_ns: int) -> str:
    """Offer a packet during an own epoch."""
    inbox.advance(now_ns, OWN_SESSION)
    return offer(inbox, packet)


def rival_of(inbox: Inbox, peer: str = "uav2") -> int | None:
    return inbox.peers[peer].sessions.contradicting(inbox.now_ns)


def test_one_forged_session_ends_nothing_and_is_named(make_small_packet) -> None:
    inbox, forged = Inbox("uav1"), 2**63
    for second in range(1, 4):
        assert hear(inbox, make_small_packet(second), second * S_NS) == ""
    assert hear(inbox, make_small_packet(9, session=forged, stamp_ns=4 * S_NS), 4 * S_NS) == "other_session"
    assert rival_of(inbox) is None  # it may be a restart
    assert hear(inbox, make_small_packet(5), 5 * S_NS) == ""
    assert rival_of(inbox) == forged
    for second in range(6, 12):
        assert hear(inbox, make_small_packet(second), second * S_NS) == ""
        assert inbox.newest("uav2", END_NS).session == 1
    assert rival_of(inbox) is None  # it was one packet, long ago


def test_a_forged_session_that_comes_first_gives_way_to_the_one_that_goes_on(make_small_packet) -> None:
    inbox = Inbox("uav1")
    assert hear(inbox, make_small_packet(1, session=2**63, stamp_ns=S_NS), S_NS) == ""
    reasons = [hear(inbox, make_small_packet(k), k * S_NS) for k in range(2, 9)]
    assert reasons == ["stale_session"] * 4 + [""] * 3
    assert inbox.newest("uav2", END_NS).session == 1


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40)
@given(st.lists(st.tuples(st.booleans(), st.integers(2, 5)), min_size=6, max_size=20))
def test_of_two_vehicles_with_one_name_the_one_heard_first_counts_and_the_other_is_named(
    make_small_packet, turns
) -> None:
    inbox = Inbox("uav1")
    hear(inbox, make_small_packet(1, session=5), S_NS)
    second = 1
    for other_is_later, session in turns:
        second += 1
        other = 5 + session if other_is_later else 5 - session + 1
        if other != 5:
            reason = hear(inbox, make_small_packet(second, session=other, stamp_ns=second * S_NS), second * S_NS)
            assert reason in ("other_session", "stale_session")
        second += 1
        assert hear(inbox, make_small_packet(second, session=5), second * S_NS) == ""
        assert other == 5 or rival_of(inbox) == other
        assert inbox.newest("uav2", END_NS).session == 5


def test_a_restart_contradicts_nothing_even_if_old_packets_come_late(make_small_packet) -> None:
    inbox = Inbox("uav1")
    for second in range(1, 4):
        hear(inbox, make_small_packet(second), second * S_NS)
    assert hear(inbox, make_small_packet(1, session=2, stamp_ns=6 * S_NS), 6 * S_NS) == "other_session"
    assert hear(inbox, make_small_packet(4), 7 * S_NS) == ""  # made before the restart
    assert rival_of(inbox) is None
    assert hear(inbox, make_small_packet(2, session=2, stamp_ns=12 * S_NS), 12 * S_NS) == ""
    assert hear(inbox, make_small_packet(5), 12 * S_NS) == "stale_session"
    assert rival_of(inbox) is None
    assert keys(inbox) == [(2, 2)]


def test_with_a_key_an_earlier_session_never_comes_back(make_small_packet) -> None:
    key = FleetKey(b"k" * 32)
    inbox = Inbox("uav1", authentication=key)
    assert hear(inbox, key.sign(make_small_packet(1, session=2)), S_NS) == ""
    for second in range(2, 40):
        assert hear(inbox, key.sign(make_small_packet(second)), second * S_NS) == "stale_session"
    assert keys(inbox) == [(2, 1)]
    assert rival_of(inbox) == 1  # a second vehicle of that name, with a key


def test_a_restarted_peer_is_received_as_soon_as_the_own_time_has_stepped_back(make_small_packet) -> None:
    inbox = Inbox("uav1")
    assert hear(inbox, make_small_packet(1, stamp_ns=1000 * S_NS), 1000 * S_NS) == ""
    assert hear(inbox, make_small_packet(1, session=2), 1001 * S_NS) == "other_session"  # its time steps back first
    reasons = [hear(inbox, make_small_packet(k, session=2), k * S_NS) for k in range(2, 8)]
    assert reasons == [""] * 6
    assert rival_of(inbox) is None


def test_with_a_key_a_stepped_time_brings_no_earlier_session_back(make_small_packet) -> None:
    key = FleetKey(b"k" * 32)
    inbox = Inbox("uav1", authentication=key)
    assert hear(inbox, key.sign(make_small_packet(1, session=2, stamp_ns=1000 * S_NS)), 1000 * S_NS) == ""
    assert hear(inbox, key.sign(make_small_packet(9)), S_NS) == "stale_session"
    assert hear(inbox, key.sign(make_small_packet(1, session=3)), 2 * S_NS) == ""


def test_a_stamp_far_ahead_is_refused(make_small_packet) -> None:
    inbox = Inbox("uav1")
    assert hear(inbox, make_small_packet(1), S_NS) == ""
    ahead_ns = round(FUTURE_S * S_NS)
    assert offer(inbox, make_small_packet(2, stamp_ns=S_NS + ahead_ns + 1)) == "future"
    assert offer(inbox, make_small_packet(2, stamp_ns=S_NS + ahead_ns)) == ""


@pytest.mark.parametrize("ahead_s", [60, -60, 10**8])
def test_a_peer_whose_clock_is_far_off_is_used_as_it_arrives(make_small_packet, ahead_s: int) -> None:
    inbox, began_s = Inbox("uav1"), 2 * 10**8
    for sequence in range(1, 40):
        now_ns = (began_s + sequence) * S_NS
        assert hear(inbox, make_small_packet(sequence, stamp_ns=now_ns + ahead_s * S_NS), now_ns) == ""
        assert sequence == 1 or inbox.newest("uav2", now_ns - S_NS).sequence == sequence - (ahead_s > 0)
    farther_ns = (ahead_s + 12 if ahead_s > 0 else 12) * S_NS
    assert offer(inbox, make_small_packet(40, stamp_ns=now_ns + farther_ns)) == "future"


def test_packets_from_before_the_own_start_count_by_the_clock_of_those_after_it(make_small_packet) -> None:
    inbox, ahead_s = Inbox("uav1"), 3600
    assert [offer(inbox, make_small_packet(k, stamp_ns=(k + ahead_s) * S_NS)) for k in (1, 2)] == ["", ""]
    assert hear(inbox, make_small_packet(3, stamp_ns=(3 + ahead_s) * S_NS), 3 * S_NS) == ""
    assert inbox.newest("uav2", 2 * S_NS).sequence == 2
    assert inbox.newest("uav2", 3 * S_NS).sequence == 3


def test_a_peer_whose_clock_is_set_in_flight_is_used_again_after_a_silence(make_small_packet) -> None:
    inbox, ahead_s = Inbox("uav1"), 0
    reasons = []
    for second in range(1, 20):
        ahead_s = 60 if second > 5 else 0
        reasons.append(hear(inbox, make_small_packet(second, stamp_ns=(second + ahead_s) * S_NS), second * S_NS))
    silent = round(HANDOVER_S) - 1
    assert reasons == [""] * 5 + ["future"] * silent + [""] * (14 - silent)


def test_a_peer_is_used_on_when_the_own_clock_is_set_back(make_small_packet) -> None:
    inbox = Inbox("uav1")
    for second in (101, 102, 103):
        assert hear(inbox, make_small_packet(second, stamp_ns=second * S_NS), second * S_NS) == ""
    for second in (104, 105, 106):
        now_ns = (second - 90) * S_NS
        assert hear(inbox, make_small_packet(second, stamp_ns=second * S_NS), now_ns) == ""
        assert inbox.newest("uav2", now_ns).sequence == second


def test_packets_of_a_peer_that_is_ahead_are_kept_until_their_time_comes(make_small_packet) -> None:
    inbox, ahead_s = Inbox("uav1"), 8
    for sequence in range(1, 30):
        packet = make_small_packet(sequence, stamp_ns=(sequence + ahead_s) * S_NS)
        assert hear(inbox, packet, sequence * S_NS) == ""
        newest = inbox.newest("uav2", sequence * S_NS)
        if sequence > ahead_s:
            assert newest.sequence == sequence - ahead_s
    assert len(inbox.peers["uav2"].packets) == ahead_s + 2  # that of this very moment is not old enough either


@pytest.mark.parametrize(("epoch_s", "ahead_s"), [(0.1, 1.0), (0.1, 4.0), (0.25, 4.0), (0.5, 9.0)])
def test_short_epochs_too_find_a_packet_of_a_peer_that_is_ahead(make_small_packet, epoch_s, ahead_s) -> None:
    inbox, epochs, found = Inbox("uav1"), round(3 * ahead_s / epoch_s), []
    for sequence in range(1, epochs + 1):
        now_ns = round(sequence * epoch_s * S_NS)
        offer(inbox, make_small_packet(sequence, stamp_ns=now_ns + round(ahead_s * S_NS)))
        inbox.advance(now_ns, OWN_SESSION)
        found.append(inbox.newest("uav2", now_ns - round(MIN_DELAY_S * S_NS)))
    begun = found[round((ahead_s + MIN_DELAY_S) / epoch_s) + 1 :]
    assert None not in begun
    assert begun[-1].sequence > begun[0].sequence
    record = inbox.peers["uav2"]
    assert record.waiting <= MOST_AHEAD + 1
    assert (record.dropped[AHEAD] > 0) == ((ahead_s + MIN_DELAY_S) / epoch_s > MOST_AHEAD)


def test_another_vehicle_of_the_own_name_is_told_from_an_own_packet_that_comes_back(make_small_packet) -> None:
    inbox = Inbox("uav2")
    inbox.advance(3 * S_NS, 7)
    assert offer(inbox, make_small_packet(3, session=7)) == "own"
    assert offer(inbox, make_small_packet(2, session=6)) == "own"  # from before the restart, relayed
    assert inbox.namesakes == {}
    assert offer(inbox, make_small_packet(4, session=6)) == "namesake"
    assert inbox.namesakes == {6: 3 * S_NS}
    inbox.advance(30 * S_NS, 7)
    assert inbox.namesakes == {}


def test_with_a_key_nobody_outside_passes_for_a_namesake(make_small_packet) -> None:
    inbox = Inbox("uav2", authentication=FleetKey(b"k" * 32))
    inbox.advance(3 * S_NS, 7)
    assert offer(inbox, make_small_packet(4, session=6)) == "unsigned"
    assert offer(inbox, FleetKey(b"x" * 32).sign(make_small_packet(4, session=6))) == "signature"
    assert inbox.namesakes == {}


def test_keys_that_differ_are_told_on_both_sides(make_small_packet) -> None:
    plain, one, other = make_small_packet(1), FleetKey(b"k" * 32), FleetKey(b"x" * 32)
    heard = {"none": plain, "one": one.sign(plain), "other": other.sign(plain)}
    told = {}
    for mine, authentication in (("none", None), ("one", one)):
        for theirs, packet in heard.items():
            inbox = Inbox("uav1", authentication=authentication)
            offer(inbox, packet)
            told[mine, theirs] = inbox.key_faults.get("uav2", "")
    assert told["none", "none"] == told["one", "one"] == ""
    assert "uav2 does not sign its packets, and this vehicle has a key" in told["one", "none"]
    assert "uav2 signs its packets, but this vehicle has no key" in told["none", "one"]
    assert "uav2 has another key" in told["one", "other"]


def test_a_fault_of_keys_ends_with_the_next_good_packet(make_small_packet) -> None:
    key = FleetKey(b"k" * 32)
    inbox = Inbox("uav1", authentication=key)
    offer(inbox, make_small_packet(1))
    assert inbox.key_faults
    offer(inbox, key.sign(make_small_packet(2)))
    assert inbox.key_faults == {}
