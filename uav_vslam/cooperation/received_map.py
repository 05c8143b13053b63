# SPDX-License-Identifier: Apache-2.0
"""What a peer told of its map lately: a small packet alone may show too few common landmarks to find the frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.types import LandmarkPacket

Array = NDArray[np.float64]

RECEIVED_LANDMARKS = 64  # a wideband packet fills it; of narrowband ones it holds the last few


@dataclass(frozen=True, slots=True)
class ReceivedMap:
    """Landmarks of one session's newest packet, then of those before; of one told again the newest counts.

    Attributes:
        ids: (N,) the peer's identifiers.
        positions: (N, 3) in the peer's map frame [m].
        covariance: (3N, 3N); what different packets have in common is left out, so that their errors relative to each
            other look larger than they are [m^2].
        descriptors, descriptor_basis: as in the packets.
    """

    ids: NDArray[np.uint32]
    positions: Array
    covariance: Array
    descriptors: NDArray[np.uint8]
    descriptor_basis: int

    def __len__(self) -> int:
        return len(self.ids)


Told = LandmarkPacket | ReceivedMap  # what a peer's landmarks can be read from


def heard(packet: LandmarkPacket, before: ReceivedMap | None) -> ReceivedMap:
    """Put a packet before what was heard already; its rows stay the first ones."""
    if before is None or _kind(before) != _kind(packet):
        before = ReceivedMap(packet.ids[:0], np.zeros((0, 3)), np.zeros((0, 0)), packet.descriptors[:0], 0)
    old = np.flatnonzero(~np.isin(before.ids, packet.ids))[: max(RECEIVED_LANDMARKS - len(packet), 0)]
    coordinates = landmark_rows(0, old)
    return ReceivedMap(
        ids=np.concatenate([packet.ids, before.ids[old]]),
        positions=np.vstack([packet.positions, before.positions[old]]),
        covariance=block_diag(packet.covariance, before.covariance[np.ix_(coordinates, coordinates)]),
        descriptors=np.vstack([packet.descriptors, before.descriptors[old]]),
        descriptor_basis=packet.descriptor_basis,
    )


def _kind(told: Told) -> tuple[int, int]:
    """Return what descriptors must have in common to stand in one array."""
    return told.descriptor_basis, told.descriptors.shape[1]
