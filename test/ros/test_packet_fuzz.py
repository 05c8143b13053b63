# SPDX-License-Identifier: Apache-2.0
"""Ten thousand corrupted packets: with a key none gets in, without one none gets in that could do harm.

They are corrupted as bytes, and as messages whose checksum an attacker has recomputed, and are received like any other:
from bytes to message to packet to inbox. rclpy's own decoding refuses bytes that make no sense with an RMWError.
"""

import contextlib
import dataclasses
from array import array
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.serialization import deserialize_message, serialize_message

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.authentication import Authentication, FleetKey, NoAuthentication
from uav_vslam.cooperation.common_landmarks import find_common
from uav_vslam.cooperation.inbox import Inbox
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.errors import InvalidMessage
from uav_vslam.ros.packet_message import packet_from_msg, packet_to_msg
from uav_vslam.slam.packet import ANCHOR, PacketPolicy, checksum, make_packet, validate
from uav_vslam.types import LandmarkPacket
from uav_vslam_msgs.msg import LandmarkInformation

COUNT = 10_000
PER_INBOX = 100  # a forged session that is far ahead must not keep all later packets out
UNDECODABLE = "undecodable"
Bytes = bytes
Rng = np.random.Generator

POLICIES = (PacketPolicy(max_landmarks=4), PacketPolicy(form=ANCHOR, max_landmarks=14, descriptor_basis=1))
FLOATS = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-38, 1e38, 1.0)
INTEGERS = (0, 1, 2, 127, -128, 255, 32767, -32768, 65535, 2**31 - 1, -(2**31), 2**32 - 1, 2**64 - 1)
TEXTS = ("", "uav1", "uav2", "uav3", "uav3\0", "u" * 5000, "\u20ac\ufffd", "uav2/1")
COUNTS = (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\x40", b"\0\x10\0\0", b"\0\0\0\0")


@pytest.fixture(scope="module")
def packets(make_joint) -> list[LandmarkPacket]:
    """Good packets of two peers in either form."""
    rng = np.random.default_rng(0)
    out = []
    for vehicle in ("uav2", "uav3"):
        for sequence in (1, 2, 3):
            joint = make_joint(rng.uniform(-40, 40, (14, 3)), np.eye(48), vehicle=vehicle, stamp_ns=10**9 * sequence)
            out += [make_packet(joint, sequence=2 * sequence + k, policy=p) for k, p in enumerate(POLICIES)]
    return out


def flip(data: Bytes, rng: Rng) -> Bytes:
    corrupted = bytearray(data)
    for place in rng.integers(len(data), size=rng.integers(1, 8)):
        corrupted[place] = rng.integers(256)
    return bytes(corrupted)


def truncate(data: Bytes, rng: Rng) -> Bytes:
    return data[: rng.integers(len(data))]


def garbage(data: Bytes, rng: Rng) -> Bytes:
    return (data[:4] if rng.random() < 0.5 else b"") + rng.bytes(int(rng.integers(400)))


def miscount(data: Bytes, rng: Rng) -> Bytes:
    """Write a wild number where lengths of arrays and strings may be."""
    place = 4 * rng.integers(len(data) // 4)
    return data[:place] + COUNTS[rng.integers(len(COUNTS))] + data[place + 4 :]


def replay(data: Bytes, rng: Rng) -> Bytes:
    return data


def scramble(message: LandmarkInformation, rng: Rng) -> None:
    """Set some fields to what they should never hold."""
    fields = message.get_fields_and_field_types()
    for name in rng.choice(list(fields), rng.integers(1, 4), replace=False):
        old = getattr(message, name)
        if isinstance(old, str):
            setattr(message, name, TEXTS[rng.integers(len(TEXTS))])
        elif isinstance(old, list):
            setattr(message, name, [TEXTS[k] for k in rng.integers(len(TEXTS), size=rng.integers(4))])
        elif isinstance(old, array | np.ndarray) and len(old):
            _spoil_array(old, rng)
        elif isinstance(old, int | float) and not isinstance(old, bool):
            setattr(message, name, _wild_number(fields[name], rng))


def _spoil_array(values: array | np.ndarray, rng: Rng) -> None:
    """Write a few wild numbers into an array, or change its length."""
    code = values.typecode if isinstance(values, array) else values.dtype.char
    kind = np.dtype(code)
    wild = FLOATS if kind.kind == "f" else [k for k in INTEGERS if np.iinfo(kind).min <= k <= np.iinfo(kind).max]
    for place in rng.integers(len(values), size=rng.integers(1, 4)):
        values[place] = wild[rng.integers(len(wild))]
    if isinstance(values, array) and rng.random() < 0.3:
        del values[int(rng.integers(len(values))) :]


def _wild_number(kind: str, rng: Rng) -> int | float:
    """Return a number that a field of that type can hold; unsigned ones are all there are beside floats."""
    if kind.startswith("float"):
        return FLOATS[rng.integers(len(FLOATS))]
    fitting = [k for k in INTEGERS if 0 <= k < 2 ** int(kind.removeprefix("uint"))]
    return fitting[rng.integers(len(fitting))]


def other_version(message: LandmarkInformation, rng: Rng) -> None:
    message.version = int(rng.choice([0, 1, 3, 255]))


def forge_sender(message: LandmarkInformation, rng: Rng) -> None:
    message.vehicle = (
        ("uav3" if message.vehicle == "uav2" else "uav2") if rng.random() < 0.5 else f"u{rng.integers(99)}"
    )
    message.sequence += int(rng.integers(100))


def from_the_future(message: LandmarkInformation, rng: Rng) -> None:
    message.session, message.sequence = int(rng.integers(1, 2**63)), int(rng.integers(2**32))


def swap(message: LandmarkInformation, rng: Rng) -> None:
    """Swap the contents of two fields of one type."""
    kinds = [("ids", "checksum"), ("sequence", "checksum"), ("own_sizes", "anchored_offsets"), ("tag", "descriptors")]
    kinds += [("offsets", "covariance_factor"), ("vehicle", "prior_id"), ("form", "version")]
    a, b = kinds[rng.integers(len(kinds))]
    one, other = getattr(message, a), getattr(message, b)
    if isinstance(one, array) and isinstance(other, array):
        one, other = (
            array(x.typecode, np.array(y).astype(x.typecode).tobytes()) for x, y in ((one, other), (other, one))
        )
        setattr(message, a, one)
        setattr(message, b, other)
    elif not isinstance(one, array):
        setattr(message, a, other)
        setattr(message, b, one)


AS_BYTES = (flip, truncate, garbage, miscount, replay)
AS_MESSAGE = (scramble, other_version, forge_sender, from_the_future, swap)


def corrupted(data: Bytes, rng: Rng) -> Bytes:
    """Return a corrupted packet; half of the corrupted messages get a checksum that fits."""
    way: Callable = (AS_BYTES + AS_MESSAGE)[rng.integers(len(AS_BYTES) + len(AS_MESSAGE))]
    if way in AS_BYTES:
        return way(data, rng)
    message = deserialize_message(data, LandmarkInformation)
    way(message, rng)
    if rng.random() < 0.5:
        with contextlib.suppress(InvalidMessage):
            message.checksum = checksum(packet_from_msg(message))
    return serialize_message(message)


def receive(inbox: Inbox, data: Bytes) -> tuple[str, LandmarkPacket | None]:
    """Return why a packet is refused, or the packet. Any other error is a bug."""
    try:
        message = deserialize_message(data, LandmarkInformation)
    except Exception as error:  # rclpy exports no name for it
        if type(error).__name__ != "RMWError":
            raise
        return UNDECODABLE, None
    try:
        packet = packet_from_msg(message)
        inbox.add(packet)
    except InvalidMessage as error:
        return error.reason, None
    return "", packet


def bombard(packets: list[LandmarkPacket], authentication: Authentication) -> tuple[Counter[str], list[LandmarkPacket]]:
    """Return how many corrupted packets were refused, by reason, and those that were taken in."""
    rng = np.random.default_rng(1)
    good = [serialize_message(packet_to_msg(authentication.sign(packet))) for packet in packets]
    reasons: Counter[str] = Counter()
    accepted = []
    for k in range(COUNT):
        if k % PER_INBOX == 0:
            inbox = Inbox("uav1", authentication=authentication)
            assert [receive(inbox, data)[0] for data in good] == [""] * len(good)
        reason, packet = receive(inbox, corrupted(good[rng.integers(len(good))], rng))
        reasons[reason] += 1
        if packet is not None:
            accepted.append(packet)
    assert reasons.total() == COUNT
    return reasons, accepted


@pytest.mark.slow
def test_with_a_fleet_key_none_gets_in(packets: list[LandmarkPacket], capfd) -> None:
    reasons, accepted = bombard(packets, FleetKey(b"k" * 32))
    assert accepted == []
    assert {UNDECODABLE, "version", "checksum", "signature", "duplicate", "late"} <= set(reasons)
    assert reasons["signature"] > 500
    capfd.readouterr()  # Fast CDR writes to stderr what it can't read


@pytest.mark.slow
def test_without_a_key_what_gets_in_can_be_computed_with(packets: list[LandmarkPacket], make_joint, capfd) -> None:
    reasons, accepted = bombard(packets, NoAuthentication())
    own = make_joint(np.random.default_rng(2).uniform(-40, 40, (10, 3)), np.eye(36))
    expected = {
        UNDECODABLE,
        "version",
        "form",
        "shape",
        "checksum",
        "covariance",
        "not_finite",
        "name",
        "sources",
        "own",
    }
    assert expected | {"duplicate", "late", "other_session", "descriptors"} <= set(reasons)
    assert len(accepted) > 200  # whoever can send can lie: that is what keys are for
    for packet in accepted:
        validate(packet)
        assert 1 <= len(packet.vehicle) <= 100
        assert len(packet) <= 14
        assert np.abs(packet.positions - packet.origin).max(initial=0.0) <= 1e6
        assert np.isfinite(packet.covariance).all()
        assert np.isfinite(np.linalg.cholesky(packet.covariance)).all()
        find_common(OwnLandmarks(own.positions, np.eye(30), own.descriptors), packet, config=FusionConfig())
    capfd.readouterr()


def test_the_fuzz_would_notice_a_receiver_that_believes_everything(packets: list[LandmarkPacket]) -> None:
    """A packet as `scramble` makes them does break algebra that it reaches unchecked."""
    packet = packets[0]
    broken = dataclasses.replace(packet.points, factor=np.full_like(packet.points.factor, np.nan))
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.eigvalsh(dataclasses.replace(packet, points=broken).covariance)
