# SPDX-License-Identifier: Apache-2.0
"""A packet's bytes: its size on the radio, and the canonical bytes under checksum and signature."""

import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.coded_points import COMMON_NUMBERS, OWN_NUMBERS, AnchoredPoints, DensePoints
from uav_vslam.types import LandmarkPacket

VERSION = 3  # of the layout, as in LandmarkInformation.msg

ENCAPSULATION = 4  # bytes of DDS's header of a serialised message


def payload_bytes(packet: LandmarkPacket) -> int:
    """Return the length of the packet's message as DDS serialises it [bytes]."""
    return payload_size(
        len(packet),
        anchored=isinstance(packet.points, AnchoredPoints),
        vehicle=packet.vehicle,
        sources=packet.other_sources,
        prior_id=packet.prior_id,
        descriptor_size=packet.descriptors.shape[1],
        tag_size=len(packet.tag),
    )


def payload_size(
    landmarks: int,
    *,
    anchored: bool,
    vehicle: str,
    sources: Sequence[str],
    prior_id: str,
    descriptor_size: int,
    tag_size: int,
) -> int:
    """Return the serialised length of a LandmarkInformation message, field by field in its order [bytes]."""
    n = landmarks
    dense = 3 * n * (3 * n + 1) // 2
    cdr = _CdrSize()
    cdr.numbers(4, 2)  # stamp
    cdr.numbers(1, 2)  # version, form
    cdr.numbers(2)  # descriptor_size
    cdr.numbers(4)  # sequence
    cdr.numbers(8)  # session
    cdr.numbers(4)  # covariance_scale
    cdr.numbers(4, 3)  # origin
    cdr.numbers(1)  # descriptor_basis
    cdr.text(vehicle)
    cdr.numbers(4)  # number of sources
    for source in sources:
        cdr.text(source)
    cdr.text(prior_id)
    cdr.sequence(4, n)  # ids
    cdr.sequence(4, 0 if anchored else 3 * n)  # offsets
    cdr.sequence(4, COMMON_NUMBERS if anchored else dense)  # covariance_factor
    cdr.sequence(2, 3 * n if anchored else 0)  # anchored_offsets
    cdr.sequence(1, OWN_NUMBERS * n if anchored else 0)  # own_factors
    cdr.sequence(2, n if anchored else 0)  # own_sizes
    cdr.sequence(1, n * descriptor_size)  # descriptors
    cdr.numbers(4)  # checksum
    cdr.sequence(1, tag_size)  # tag
    return ENCAPSULATION + cdr.size


class _CdrSize:
    """Size in the Common Data Representation (version 1): each number is aligned to its own width."""

    def __init__(self) -> None:
        self.size = 0

    def numbers(self, width: int, count: int = 1) -> None:
        if count:
            self.size += -self.size % width + width * count

    def text(self, text: str) -> None:
        self.numbers(4)
        self.size += len(_encoded(text)) + 1

    def sequence(self, width: int, count: int) -> None:
        self.numbers(4)
        self.numbers(width, count)


def canonical_bytes(packet: LandmarkPacket) -> bytes:
    """Return every field but checksum and tag. Parts are length-prefixed, so no two packets have the same bytes."""
    points = packet.points
    others = packet.other_sources
    numbers = (VERSION, packet.stamp_ns, packet.session, packet.sequence, packet.covariance_scale)
    parts = [struct.pack("<BqQIdBI", *numbers, packet.descriptor_basis, len(others)), type(points).__name__.encode()]
    parts += [_encoded(text) for text in (packet.vehicle, packet.prior_id, *others)]
    arrays: list[NDArray[Any]] = [packet.ids, packet.origin, packet.descriptors]
    if isinstance(points, DensePoints):
        arrays += [points.offsets, points.factor]
    else:
        arrays += [points.offsets, points.common_factor, points.own_factors, points.own_sizes]
    parts += [np.ascontiguousarray(a, a.dtype.newbyteorder("<")).tobytes() for a in arrays]
    return b"".join(struct.pack("<I", len(part)) + part for part in parts)


def _encoded(text: str) -> bytes:
    return text.encode(errors="surrogatepass")  # invalid text is refused later and must not fail here


def checksum(packet: LandmarkPacket) -> int:
    """Return the CRC-32 of the canonical bytes: it detects accidents, not attacks."""
    return zlib.crc32(canonical_bytes(packet))
