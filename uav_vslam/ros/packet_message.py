# SPDX-License-Identifier: Apache-2.0
"""Conversion of landmark packets to the radio's message, and back."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from uav_vslam.datasets.messages import time_ns_of
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.coded_points import OWN_NUMBERS, AnchoredPoints, CodedPoints, DensePoints
from uav_vslam.ros.convert import flat, rows_of, stamp_from_ns
from uav_vslam.slam.packet import VERSION
from uav_vslam.types import LandmarkPacket, source_of
from uav_vslam_msgs.msg import LandmarkInformation


def packet_to_msg(packet: LandmarkPacket) -> LandmarkInformation:
    """Return the message."""
    message = LandmarkInformation(
        stamp=stamp_from_ns(packet.stamp_ns),
        version=VERSION,
        descriptor_size=packet.descriptors.shape[1],
        sequence=packet.sequence,
        session=packet.session,
        covariance_scale=packet.covariance_scale,
        origin=packet.origin,
        descriptor_basis=packet.descriptor_basis,
        vehicle=packet.vehicle,
        sources=list(packet.other_sources),
        prior_id=packet.prior_id,
        ids=flat(packet.ids),
        descriptors=flat(packet.descriptors),
        checksum=packet.checksum,
        tag=packet.tag,
    )
    points = packet.points
    if isinstance(points, DensePoints):
        message.form = LandmarkInformation.FORM_DENSE
        message.offsets = flat(points.offsets)
        message.covariance_factor = flat(points.factor)
    else:
        message.form = LandmarkInformation.FORM_ANCHOR
        message.covariance_factor = flat(points.common_factor)
        message.anchored_offsets = flat(points.offsets)
        message.own_factors = flat(points.own_factors)
        message.own_sizes = flat(points.own_sizes)
    return message


def decoded(data: bytes) -> LandmarkInformation:
    """Return the message in serialised bytes.

    Raises:
        InvalidMessage: there is none.
    """
    try:
        return deserialize_message(data, LandmarkInformation)
    except Exception as error:  # rclpy names no class for it
        raise InvalidMessage("undecodable", f"{len(data)} bytes are no packet: {error}") from None


def packet_from_msg(message: LandmarkInformation) -> LandmarkPacket:
    """Return a packet; its contents are checked later by `slam.packet.validate`.

    Raises:
        InvalidMessage: its version or form is unknown, or its arrays don't form rows.
    """
    if message.version != VERSION:
        raise InvalidMessage("version", f"packet version {message.version}; this one reads {VERSION}")
    vehicle, session = message.vehicle, int(message.session)
    return LandmarkPacket(
        stamp_ns=time_ns_of(message.stamp),
        vehicle=vehicle,
        session=session,
        sequence=int(message.sequence),
        sources=(source_of(vehicle, session), *message.sources),
        prior_id=message.prior_id,
        ids=np.array(message.ids, dtype=np.uint32),
        origin=np.array(message.origin, dtype=np.int32),
        points=_points(message),
        covariance_scale=float(message.covariance_scale),
        descriptor_basis=int(message.descriptor_basis),
        descriptors=_descriptors(message),
        checksum=int(message.checksum),
        tag=bytes(message.tag),
    )


def _descriptors(message: LandmarkInformation) -> NDArray[np.uint8]:
    """Return (N, D); in feedback D is 0."""
    if message.descriptor_size == 0 and len(message.descriptors) == 0:
        return np.zeros((len(message.ids), 0), np.uint8)
    return rows_of(message.descriptors, np.uint8, message.descriptor_size, "descriptors")


def _points(message: LandmarkInformation) -> CodedPoints:
    factor: NDArray[Any] = np.array(message.covariance_factor, dtype=np.float32)
    if message.form == LandmarkInformation.FORM_DENSE:
        _require_empty(message, "anchored_offsets", "own_factors", "own_sizes")
        return DensePoints(rows_of(message.offsets, np.float32, 3, "offsets"), factor)
    if message.form == LandmarkInformation.FORM_ANCHOR:
        _require_empty(message, "offsets")
        return AnchoredPoints(
            offsets=rows_of(message.anchored_offsets, np.int16, 3, "anchored_offsets"),
            common_factor=factor,
            own_factors=rows_of(message.own_factors, np.int8, OWN_NUMBERS, "own_factors"),
            own_sizes=np.array(message.own_sizes, dtype=np.uint16),
        )
    raise InvalidMessage("form", f"packet form {message.form} is unknown")


def _require_empty(message: LandmarkInformation, *fields: str) -> None:
    """Refuse fields of the other form: the checksum does not cover them."""
    for field in fields:
        if len(getattr(message, field)):
            raise InvalidMessage("shape", f"a packet of form {message.form} has no {field}")
