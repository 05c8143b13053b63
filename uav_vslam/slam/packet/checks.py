# SPDX-License-Identifier: Apache-2.0
"""Validation of received packets. Authentication of the sender is separate: cooperation/authentication.py."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import MAX_PACKET_LANDMARKS
from uav_vslam.errors import FilterDivergence, InvalidMessage
from uav_vslam.geometry.coded_points import COMMON_NUMBERS, OWN_NUMBERS, AnchoredPoints, DensePoints, size_m
from uav_vslam.numerics import cholesky
from uav_vslam.slam.packet.wire import checksum
from uav_vslam.types import LandmarkPacket
from uav_vslam.vision.compact_descriptors import RAW, load_basis

MAX_SOURCES = 100
MAX_TEXT = 100  # characters of a name
MAX_OFFSET_M = 1e6  # numbers beyond these would break the receiver's numerics
MAX_SIGMA_M = 1e5
MAX_SCALE = 1e6


def validate(packet: LandmarkPacket) -> None:
    """Check all of a packet; raises as `check_form` and `check_contents` do."""
    check_form(packet)
    check_contents(packet)


def check_form(packet: LandmarkPacket) -> None:
    """Cheap checks, before authentication.

    Raises:
        InvalidMessage: with reason shape, name, sources, descriptors or checksum.
    """
    _check_shapes(packet)
    _check_names(packet)
    _check_descriptors(packet)
    if checksum(packet) != packet.checksum:
        raise InvalidMessage("checksum", f"{_name(packet)} was corrupted in transit")


def check_contents(packet: LandmarkPacket) -> None:
    """Check the numbers of a packet of valid form.

    Raises:
        InvalidMessage: with reason not_finite, position, covariance or duplicate_id.
    """
    _check_numbers(packet)
    if len(np.unique(packet.ids)) != len(packet):
        raise InvalidMessage("duplicate_id", f"{_name(packet)} repeats a landmark")


def _check_shapes(packet: LandmarkPacket) -> None:
    n, points = len(packet.ids), packet.points
    if n > MAX_PACKET_LANDMARKS:
        raise InvalidMessage("shape", f"{n} landmarks; at most {MAX_PACKET_LANDMARKS} are accepted")
    arrays: list[tuple[str, NDArray[Any], tuple[int, ...]]] = [
        ("origin", packet.origin, (3,)),
        ("offsets", points.offsets, (n, 3)),
    ]
    if isinstance(points, DensePoints):
        arrays += [("covariance factor", points.factor, (3 * n * (3 * n + 1) // 2,))]
    else:
        arrays += [
            ("common factor", points.common_factor, (COMMON_NUMBERS,)),
            ("own factors", points.own_factors, (n, OWN_NUMBERS)),
            ("own sizes", points.own_sizes, (n,)),
        ]
    for what, array, shape in arrays:
        if array.shape != shape:
            raise InvalidMessage("shape", f"{what} of shape {array.shape}; {n} landmarks need {shape}")
    if packet.descriptors.ndim != 2 or len(packet.descriptors) != n:
        raise InvalidMessage("shape", f"{n} landmarks but descriptors of shape {packet.descriptors.shape}")


def _check_names(packet: LandmarkPacket) -> None:
    if not packet.vehicle or max(len(packet.vehicle), len(packet.prior_id)) > MAX_TEXT:
        raise InvalidMessage("name", f"vehicle and prior must have names of at most {MAX_TEXT} characters")
    if len(packet.sources) > MAX_SOURCES or any(len(source) > 2 * MAX_TEXT for source in packet.sources):
        raise InvalidMessage("sources", f"at most {MAX_SOURCES} sources of {2 * MAX_TEXT} characters are accepted")
    if packet.source not in packet.sources:
        raise InvalidMessage("sources", f"{_name(packet)} does not name its own sender")


def _check_descriptors(packet: LandmarkPacket) -> None:
    if packet.descriptor_basis != RAW and len(packet):
        expected, size = load_basis(packet.descriptor_basis).bytes, packet.descriptors.shape[1]
        if size != expected:
            raise InvalidMessage("descriptors", f"{size} bytes; basis {packet.descriptor_basis} makes {expected}")


def _check_numbers(packet: LandmarkPacket) -> None:
    points = packet.points
    own: NDArray[Any]  # diagonals that must be positive; the common error's covariance may be singular
    if isinstance(points, AnchoredPoints):
        factor, own = points.common_factor, points.own_factors[:, [0, 2, 5]]
        largest = size_m(points.own_sizes).max(initial=0.0)
    else:
        factor, own = points.factor, points.factor[np.cumsum(np.arange(1, 3 * len(packet) + 1)) - 1]
        largest = 0.0
    if not all(np.isfinite(a).all() for a in (points.offsets, factor, packet.covariance_scale)):
        raise InvalidMessage("not_finite", f"{_name(packet)} holds NaN or infinity")
    if not (np.abs(points.offsets_m) <= MAX_OFFSET_M).all():
        raise InvalidMessage("position", f"{_name(packet)} has landmarks over {MAX_OFFSET_M} m from its origin")
    if not (own > 0).all() or not 1.0 <= packet.covariance_scale <= MAX_SCALE:
        raise InvalidMessage("covariance", f"{_name(packet)} is not positive definite, or its scale is out of range")
    if max(np.abs(factor).max(initial=0.0), largest) > MAX_SIGMA_M:
        raise InvalidMessage("covariance", f"{_name(packet)} has a sigma above {MAX_SIGMA_M} m")
    try:
        cholesky(packet.covariance, "covariance")
    except FilterDivergence as error:
        raise InvalidMessage("covariance", f"{_name(packet)}: {error}") from None


def _name(packet: LandmarkPacket) -> str:
    return f"packet {packet.sequence} of {packet.source}"
