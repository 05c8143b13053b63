# SPDX-License-Identifier: Apache-2.0
"""Corrupted and invalid packets are refused with a reason."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.config import MAX_PACKET_LANDMARKS
from uav_vslam.errors import InvalidMessage
from uav_vslam.slam.packet import ANCHOR, PacketPolicy, check_form, checksum, make_packet, validate
from uav_vslam.types import LandmarkPacket


def packet_of(make_joint, policy: PacketPolicy) -> LandmarkPacket:
    rng = np.random.default_rng(8)
    return make_packet(make_joint(rng.uniform(-40, 40, (5, 3)), np.eye(21)), sequence=3, policy=policy)


@pytest.fixture(scope="module")
def dense(make_joint) -> LandmarkPacket:
    return packet_of(make_joint, PacketPolicy())


@pytest.fixture(scope="module")
def anchored(make_joint) -> LandmarkPacket:
    return packet_of(make_joint, PacketPolicy(form=ANCHOR, descriptor_basis=1))


def resealed(packet: LandmarkPacket, **changes) -> LandmarkPacket:
    """Return the packet with changed fields (its points' included) and a valid checksum."""
    inside = {k: changes.pop(k) for k in list(changes) if hasattr(packet.points, k)}
    changed = dataclasses.replace(packet, points=dataclasses.replace(packet.points, **inside), **changes)
    return dataclasses.replace(changed, checksum=checksum(changed))


def with_entry(array: NDArray, place: tuple[int, ...], value: float) -> NDArray:
    out = array.copy()
    out[place] = value
    return out


COMMON = {
    "too_many": ("shape", lambda p: {"ids": np.arange(MAX_PACKET_LANDMARKS + 1, dtype=np.uint32)}),
    "ids_without_offsets": ("shape", lambda p: {"ids": p.ids[:-1]}),
    "flat_offsets": ("shape", lambda p: {"offsets": p.points.offsets.ravel()}),
    "missing_descriptor": ("shape", lambda p: {"descriptors": p.descriptors[:-1]}),
    "origin_of_two": ("shape", lambda p: {"origin": p.origin[:2]}),
    "nan_scale": ("not_finite", lambda p: {"covariance_scale": float("nan")}),
    "infinite_scale": ("not_finite", lambda p: {"covariance_scale": float("inf")}),
    "deflated": ("covariance", lambda p: {"covariance_scale": 0.5}),
    "inflated_beyond_sense": ("covariance", lambda p: {"covariance_scale": 1e30}),
    "repeated_id": ("duplicate_id", lambda p: {"ids": with_entry(p.ids, (0,), p.ids[1])}),
    "nameless": ("name", lambda p: {"vehicle": "", "sources": ("/1",)}),
    "endless_name": ("name", lambda p: {"vehicle": "u" * 101, "sources": ("u" * 101 + "/1",)}),
    "endless_prior": ("name", lambda p: {"prior_id": "p" * 101}),
    "without_its_own_source": ("sources", lambda p: {"sources": ("uav9/1",)}),
    "too_many_sources": ("sources", lambda p: {"sources": (p.source, *(f"u/{k}" for k in range(100)))}),
    "endless_source": ("sources", lambda p: {"sources": (p.source, "u" * 201)}),
    "unknown_basis": ("descriptors", lambda p: {"descriptor_basis": 77}),
    "damaged": ("checksum", None),
}
DENSE_ONLY = {
    "short_factor": ("shape", lambda p: {"factor": p.points.factor[:-1]}),
    "infinite_offset": ("not_finite", lambda p: {"offsets": with_entry(p.points.offsets, (0, 2), np.inf)}),
    "nan_factor": ("not_finite", lambda p: {"factor": with_entry(p.points.factor, (4,), np.nan)}),
    "far_offset": ("position", lambda p: {"offsets": with_entry(p.points.offsets, (0, 2), 1e30)}),
    "zero_diagonal": ("covariance", lambda p: {"factor": with_entry(p.points.factor, (5,), 0.0)}),
    "negative_diagonal": ("covariance", lambda p: {"factor": with_entry(p.points.factor, (0,), -1.0)}),
    "absurd_covariance": ("covariance", lambda p: {"factor": with_entry(p.points.factor, (3,), 1e30)}),
    "singular_in_double_precision": (
        "covariance",
        lambda p: {"factor": with_entry(with_entry(p.points.factor, (1,), 1e5), (2,), 1e-6)},
    ),
    "descriptors_not_of_the_basis": ("descriptors", lambda p: {"descriptor_basis": 1}),
}
ANCHORED_ONLY = {
    "short_common_factor": ("shape", lambda p: {"common_factor": p.points.common_factor[:-1]}),
    "short_own_factors": ("shape", lambda p: {"own_factors": p.points.own_factors[:-1]}),
    "short_own_sizes": ("shape", lambda p: {"own_sizes": p.points.own_sizes[:-1]}),
    "nan_common_factor": ("not_finite", lambda p: {"common_factor": with_entry(p.points.common_factor, (4,), np.nan)}),
    "zero_diagonal": ("covariance", lambda p: {"own_factors": with_entry(p.points.own_factors, (2, 5), 0)}),
    "negative_diagonal": ("covariance", lambda p: {"own_factors": with_entry(p.points.own_factors, (2, 0), -3)}),
    "absurd_common": ("covariance", lambda p: {"common_factor": with_entry(p.points.common_factor, (9,), -1e6)}),
    "absurd_own": ("covariance", lambda p: {"own_sizes": with_entry(p.points.own_sizes, (1,), 65535)}),
    "singular_in_double_precision": (
        "covariance",
        lambda p: {"common_factor": p.points.common_factor + np.float32(9e4), "own_sizes": 0 * p.points.own_sizes},
    ),
    "descriptors_not_of_the_basis": ("descriptors", lambda p: {"descriptors": p.descriptors[:, :31]}),
}


@pytest.mark.parametrize(
    ("form", "kind"),
    [("dense", k) for k in COMMON | DENSE_ONLY] + [("anchored", k) for k in COMMON | ANCHORED_ONLY],
)
def test_invalid_content_with_a_valid_checksum_is_refused_with_its_reason(request, form: str, kind: str) -> None:
    packet = request.getfixturevalue(form)
    validate(packet)
    reason, change = (COMMON | (DENSE_ONLY if form == "dense" else ANCHORED_ONLY))[kind]
    bad = resealed(packet, **change(packet)) if change else dataclasses.replace(packet, checksum=packet.checksum ^ 1)
    with pytest.raises(InvalidMessage) as caught:
        validate(bad)
    assert caught.value.reason == reason


def test_an_unknown_basis_of_no_descriptors_is_harmless(make_joint) -> None:
    empty = make_packet(make_joint(np.zeros((0, 3)), np.eye(6)), sequence=1, policy=PacketPolicy())
    validate(resealed(empty, descriptor_basis=77))


def test_more_landmarks_than_allowed_are_refused_however_well_formed(anchored) -> None:
    def repeated(count: int) -> LandmarkPacket:
        rows = np.arange(count) % len(anchored)
        points = {name: getattr(anchored.points, name)[rows] for name in ("offsets", "own_factors", "own_sizes")}
        return resealed(
            anchored, ids=np.arange(count, dtype=np.uint32), descriptors=anchored.descriptors[rows], **points
        )

    check_form(repeated(MAX_PACKET_LANDMARKS))
    with pytest.raises(InvalidMessage, match="at most"):
        check_form(repeated(MAX_PACKET_LANDMARKS + 1))
