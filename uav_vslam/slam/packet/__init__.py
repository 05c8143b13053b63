# SPDX-License-Identifier: Apache-2.0
"""The landmark information packet: made from the sender's estimate, checked by the receiver.

The sender marginalises its pose and chooses landmarks. Their joint covariance is coded so that R, what the receiver
decodes, bounds the exact P: `lambda_max(R^-1 P) <= 1` makes `R - P` positive semidefinite, so a packet is never
over-confident.
"""

from uav_vslam.slam.packet.checks import check_contents, check_form, validate
from uav_vslam.slam.packet.choice import choose_landmarks
from uav_vslam.slam.packet.making import make_packet
from uav_vslam.slam.packet.policy import ANCHOR, DENSE, NARROWBAND_PACKET_BYTES, PacketPolicy, packet_policy
from uav_vslam.slam.packet.wire import VERSION, canonical_bytes, checksum, payload_bytes

__all__ = [
    "ANCHOR",
    "DENSE",
    "NARROWBAND_PACKET_BYTES",
    "VERSION",
    "PacketPolicy",
    "canonical_bytes",
    "check_contents",
    "check_form",
    "checksum",
    "choose_landmarks",
    "make_packet",
    "packet_policy",
    "payload_bytes",
    "validate",
]
