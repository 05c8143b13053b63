# SPDX-License-Identifier: Apache-2.0
"""A packet comes back from its message as it was, in exactly the predicted number of bytes."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.serialization import deserialize_message, serialize_message
from same_records import assert_same

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.datasets.messages import header_stamp_ns
from uav_vslam.errors import InvalidMessage
from uav_vslam.ros.packet_message import packet_from_msg, packet_to_msg
from uav_vslam.slam.packet import ANCHOR, VERSION, PacketPolicy, checksum, make_packet, payload_bytes, validate
from uav_vslam.types import LandmarkPacket
from uav_vslam_msgs.msg import LandmarkInformation

STAMP_NS = 1_283_212_800_123_456_789
DENSE = PacketPolicy(max_landmarks=20)
COMPACT = PacketPolicy(form=ANCHOR, max_landmarks=20, descriptor_basis=1)
NAN = float("nan")

Maker = Callable[..., LandmarkPacket]


@pytest.fixture
def packet_of(make_joint) -> Maker:
    """Return a maker of packets with so many landmarks."""

    def make(policy: PacketPolicy, count: int, *, vehicle: str = "uav1", prior_id: str = "") -> LandmarkPacket:
        points = np.random.default_rng(4).uniform(-40, 40, (count, 3))
        joint = make_joint(points, np.eye(6 + 3 * count), stamp_ns=STAMP_NS, vehicle=vehicle)
        return make_packet(joint, sequence=7, policy=policy, prior_id=prior_id)

    return make


def travelled(message: LandmarkInformation) -> LandmarkInformation:
    """Return the message as a subscriber gets it."""
    return deserialize_message(serialize_message(message), LandmarkInformation)


@pytest.mark.parametrize("policy", [DENSE, COMPACT], ids=lambda p: p.form)
@pytest.mark.parametrize("count", [0, 1, 5])
@pytest.mark.parametrize("tag", [b"", bytes(range(16))])
def test_a_packet_comes_back_and_its_checksum_still_fits(packet_of: Maker, policy, count, tag) -> None:
    sent = dataclasses.replace(packet_of(policy, count), tag=tag)
    got = packet_from_msg(travelled(packet_to_msg(sent)))
    assert_same(got, sent)
    validate(got)


def test_feedback_comes_back_though_it_has_no_descriptors(make_joint) -> None:
    points = np.column_stack([np.linspace(-20, 20, 6), np.linspace(5, -9, 6) ** 2, np.zeros(6)])
    own, peer = (
        make_joint(points, np.eye(24), vehicle=name, stamp_ns=second * 10**9)
        for name, second in (("uav2", 3), ("uav1", 2))
    )
    fusion = Fusion("uav2", FusionConfig())
    fusion.inbox.add(make_packet(peer, sequence=1, policy=PacketPolicy()))
    fusion.fuse(own)
    sent = fusion.feedback("uav1")
    assert sent is not None
    got = packet_from_msg(travelled(packet_to_msg(sent)))
    assert_same(got, sent)
    Fusion("uav1", FusionConfig()).returned.add(got)


def test_only_the_sources_of_others_are_sent(packet_of: Maker) -> None:
    sent = dataclasses.replace(packet_of(DENSE, 1), sources=("uav1/1", "uav2/8"))
    message = packet_to_msg(sent)
    assert message.sources == ["uav2/8"]
    assert packet_from_msg(travelled(message)).sources == ("uav1/1", "uav2/8")


@pytest.mark.parametrize("policy", [DENSE, COMPACT], ids=lambda p: p.form)
@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 20])
@pytest.mark.parametrize(
    ("vehicle", "prior_id", "others", "tag"),
    [("uav1", "", (), 0), ("u", "5f2a", ("uav2/17", "uav3/9"), 16), ("höhenflieger", "a", ("x/1",), 64)],
)
def test_the_payload_is_known_to_the_byte(packet_of: Maker, policy, count, vehicle, prior_id, others, tag) -> None:
    packet = packet_of(policy, count, vehicle=vehicle, prior_id=prior_id)
    packet = dataclasses.replace(packet, sources=packet.sources + others, tag=bytes(tag))
    assert payload_bytes(packet) == len(serialize_message(packet_to_msg(packet)))


def test_the_stamp_comes_first_as_in_a_header(packet_of: Maker) -> None:
    assert header_stamp_ns(serialize_message(packet_to_msg(packet_of(DENSE, 1)))) == STAMP_NS


def test_code_and_definition_are_of_one_version() -> None:
    assert VERSION == LandmarkInformation.VERSION


def refusal(message: LandmarkInformation, *, reseal: bool = False) -> str:
    """Return the reason why a message is refused; the receiver recomputes the checksum if `reseal`."""

    def read() -> None:
        packet = packet_from_msg(travelled(message))
        validate(dataclasses.replace(packet, checksum=checksum(packet)) if reseal else packet)

    with pytest.raises(InvalidMessage) as refused:
        read()
    return refused.value.reason


BOTH = [
    ("version", 2, "version"),
    ("version", 255, "version"),
    ("form", 2, "form"),
    ("form", 255, "form"),
    ("descriptor_size", 0, "shape"),
    ("ids", [1, 2], "shape"),
    ("descriptors", bytes(31), "shape"),
    ("covariance_factor", [1.0] * 44, "shape"),
    ("origin", np.array([0, 0, 1], np.int32), "checksum"),
    ("sequence", 8, "checksum"),
    ("session", 8, "checksum"),
    ("sources", ["uav2/1"], "checksum"),
    ("descriptor_basis", 9, "descriptors"),
]


@pytest.mark.parametrize(
    ("policy", "field", "value", "reason"),
    [
        *((DENSE, *case) for case in BOTH),
        (DENSE, "form", 1, "shape"),
        (DENSE, "covariance_factor", [NAN] * 45, "checksum"),
        (DENSE, "offsets", [0.0] * 8, "shape"),
        (DENSE, "offsets", [0.0] * 6, "shape"),
        (DENSE, "offsets", [0.0] * 9, "checksum"),
        (DENSE, "anchored_offsets", [0] * 9, "shape"),
        (DENSE, "own_factors", [1] * 18, "shape"),
        (DENSE, "own_sizes", [1] * 3, "shape"),
        *((COMPACT, *case) for case in BOTH),
        (COMPACT, "form", 0, "shape"),
        (COMPACT, "offsets", [0.0] * 9, "shape"),
        (COMPACT, "anchored_offsets", [0] * 8, "shape"),
        (COMPACT, "own_factors", [1] * 17, "shape"),
        (COMPACT, "own_sizes", [1] * 2, "shape"),
        (COMPACT, "own_sizes", [1] * 3, "checksum"),
        (COMPACT, "covariance_factor", [NAN] * 28, "checksum"),
    ],
)
def test_a_packet_that_is_refused(packet_of: Maker, policy, field: str, value: Any, reason: str) -> None:
    message = packet_to_msg(packet_of(policy, 3))
    setattr(message, field, value)
    assert refusal(message) == reason


def test_numbers_that_are_not_finite_are_refused_even_with_a_valid_checksum(packet_of: Maker) -> None:
    for policy, count in ((DENSE, 45), (COMPACT, 28)):
        message = packet_to_msg(packet_of(policy, 3))
        message.covariance_factor = [NAN] * count
        assert refusal(message, reseal=True) == "not_finite"
