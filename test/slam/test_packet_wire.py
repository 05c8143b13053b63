# SPDX-License-Identifier: Apache-2.0
"""Every field is under the checksum, and sizes are known without serialising (test/ros/test_packet_message.py)."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.geometry.coded_points import AnchoredPoints, DensePoints
from uav_vslam.slam.packet import ANCHOR, PacketPolicy, canonical_bytes, make_packet, payload_bytes
from uav_vslam.types import LandmarkPacket


@pytest.fixture(params=[PacketPolicy(max_landmarks=3), PacketPolicy(form=ANCHOR, max_landmarks=3, descriptor_basis=1)])
def packet(request: pytest.FixtureRequest, make_joint) -> LandmarkPacket:
    positions = np.random.default_rng(0).uniform(-40, 40, (3, 3))
    return make_packet(make_joint(positions, np.eye(15)), sequence=3, policy=request.param, prior_id="survey")


def test_every_bit_of_every_array_counts(packet: LandmarkPacket) -> None:
    def changed(record, name: str):
        data = np.ascontiguousarray(getattr(record, name))
        for place in range(data.nbytes):
            damaged = data.copy()
            damaged.view(np.uint8).reshape(-1)[place] ^= 1 << (place % 8)
            yield dataclasses.replace(record, **{name: damaged})

    points = packet.points
    variants = [p for name in ("ids", "origin", "descriptors") for p in changed(packet, name)]
    for name in (field.name for field in dataclasses.fields(points)):
        variants += [dataclasses.replace(packet, points=p) for p in changed(points, name)]
    assert len(variants) > 200
    seen = {canonical_bytes(packet)} | {canonical_bytes(p) for p in variants}
    assert len(seen) == len(variants) + 1


@pytest.mark.parametrize(
    "change",
    [
        {"stamp_ns": 10_000_000_001},
        {"vehicle": "uav3"},
        {"session": 2},
        {"sequence": 4},
        {"sources": ("uav1/1", "uav2/1")},
        {"prior_id": ""},
        {"covariance_scale": 1.5},
        {"descriptor_basis": 2},
        {"vehicle": "uav1survey", "prior_id": ""},
        {"vehicle": "uav1s", "prior_id": "urvey"},
        {"vehicle": "", "prior_id": "uav1survey"},
    ],
    ids=str,
)
def test_every_other_field_counts_and_none_can_pass_for_another(packet: LandmarkPacket, change: dict) -> None:
    own = {"sources": (f"{change.get('vehicle', 'uav1')}/{change.get('session', 1)}",)}
    assert canonical_bytes(dataclasses.replace(packet, **(own | change))) != canonical_bytes(packet)


def test_the_form_counts() -> None:
    empty = np.zeros((0, 3))
    dense = DensePoints(empty.astype(np.float32), np.zeros(21, np.float32))
    anchored = AnchoredPoints(
        empty.astype(np.int16), np.zeros(28, np.float32), np.zeros((0, 6), np.int8), np.zeros(0, np.uint16)
    )
    one, other = (
        LandmarkPacket(1, "a", 1, 1, ("a/1",), "", *(np.zeros(0, np.uint32), np.zeros(3, np.int32)), p, 1.0, 0, *rest)
        for p, rest in ((dense, (np.zeros((0, 0), np.uint8), 0)), (anchored, (np.zeros((0, 0), np.uint8), 0)))
    )
    assert canonical_bytes(one) != canonical_bytes(other)


def test_neither_checksum_nor_tag_counts(packet: LandmarkPacket) -> None:
    assert canonical_bytes(dataclasses.replace(packet, checksum=0, tag=b"x" * 16)) == canonical_bytes(packet)


def test_the_payload_grows_linearly_with_landmarks(make_joint) -> None:
    joint = make_joint(np.random.default_rng(1).uniform(-40, 40, (30, 3)), np.eye(96))

    def sizes(policy: PacketPolicy, *counts: int) -> list[int]:
        return [
            payload_bytes(make_packet(joint, sequence=1, policy=dataclasses.replace(policy, max_landmarks=n)))
            for n in counts
        ]

    none, one, two = sizes(PacketPolicy(), 0, 1, 2)
    assert one - none == 4 + 12 + 6 * 4 + 128
    assert two - none == 2 * (4 + 12 + 128) + 21 * 4
    four, eight, twelve = sizes(PacketPolicy(form=ANCHOR, descriptor_basis=1), 4, 8, 12)
    assert twelve - eight == eight - four == 4 * (18 + 32)
