# SPDX-License-Identifier: Apache-2.0
"""Packet policy: form, number of landmarks, descriptors and bytes."""

from dataclasses import dataclass

from uav_vslam.config import MODE_BUDGETS, FusionConfig
from uav_vslam.vision.compact_descriptors import COMPACT, RAW

DENSE, ANCHOR = "dense", "anchor"
NARROWBAND_PACKET_BYTES = 1340  # plus 132 of RTPS and 28 of UDP and IP: not fragmented at an MTU of 1500
NARROWBAND_OFFERED = 3  # of 22; 2 to 6 do as well. Of wideband's 64 some are others anyhow: room costs 0.5 % of ATE


@dataclass(frozen=True, slots=True)
class PacketPolicy:
    """How a packet is made.

    Attributes:
        form: DENSE or ANCHOR, see geometry.coded_points.
        max_landmarks: largest number of landmarks.
        offered: room for landmarks that are not known to be shared. Where shared ones fill all packets, two vehicles
            share no further landmark, and less and less of what they see.
        descriptor_basis: RAW, or the number of a basis in vision.compact_descriptors.
        max_bytes: of the payload; None for no limit.
        tag_bytes: bytes reserved for the authentication tag.
    """

    form: str = DENSE
    max_landmarks: int = 64
    offered: int = 0
    descriptor_basis: int = RAW
    max_bytes: int | None = None
    tag_bytes: int = 0

    def __post_init__(self) -> None:
        if self.form not in (DENSE, ANCHOR):
            raise ValueError(f"packet form {self.form!r} is not known; use {DENSE} or {ANCHOR}")


def packet_policy(config: FusionConfig, *, tag_bytes: int = 0) -> PacketPolicy:
    """Return the policy of the configured communication mode.

    A wideband packet is at most one epoch's share of the budget; narrowband packets are as large as possible and less
    frequent, because a larger one carries more information per byte.
    """
    if config.mode == "narrowband":
        return PacketPolicy(
            form=ANCHOR,
            max_landmarks=config.max_packet_landmarks,
            offered=NARROWBAND_OFFERED,
            descriptor_basis=COMPACT,
            max_bytes=NARROWBAND_PACKET_BYTES,
            tag_bytes=tag_bytes,
        )
    share = int((config.budget_bytes_per_s or MODE_BUDGETS[config.mode]) * config.epoch_s)
    return PacketPolicy(max_landmarks=config.max_packet_landmarks, max_bytes=share, tag_bytes=tag_bytes)
