# SPDX-License-Identifier: Apache-2.0
"""A peer's recently received landmarks: one small packet may have too few common landmarks for an alignment."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.numerics import submatrix
from uav_vslam.types import LandmarkPacket

Array = NDArray[np.float64]

RECEIVED_LANDMARKS = 64  # one wideband packet, or the last few narrowband ones


@dataclass(frozen=True, slots=True)
class ReceivedMap:
    """Landmarks of one session's newest packet, then of earlier ones; of a repeated landmark the newest counts.

    Attributes:
        ids: (N,) the peer's identifiers.
        positions: (N, 3) in the peer's map frame [m].
        covariance: (3N, 3N); cross-covariances between packets are omitted, so that their relative errors are
            overestimated [m^2].
        descriptors, descriptor_basis: as in the packets.
    """

    ids: NDArray[np.uint32]
    positions: Array
    covariance: Array
    descriptors: NDArray[np.uint8]
    descriptor_basis: int

    def __len__(self) -> int:
        return len(self.ids)


PeerLandmarks = LandmarkPacket | ReceivedMap


def updated_map(packet: LandmarkPacket, before: ReceivedMap | None) -> ReceivedMap:
    """Prepend a packet to the landmarks received before; its rows stay the first ones."""
    if before is None or _kind(before) != _kind(packet):
        before = ReceivedMap(packet.ids[:0], np.zeros((0, 3)), np.zeros((0, 0)), packet.descriptors[:0], 0)
    old = np.flatnonzero(~np.isin(before.ids, packet.ids))[: max(RECEIVED_LANDMARKS - len(packet), 0)]
    return ReceivedMap(
        ids=np.concatenate([packet.ids, before.ids[old]]),
        positions=np.vstack([packet.positions, before.positions[old]]),
        covariance=block_diag(packet.covariance, submatrix(before.covariance, landmark_rows(0, old))),
        descriptors=np.vstack([packet.descriptors, before.descriptors[old]]),
        descriptor_basis=packet.descriptor_basis,
    )


def _kind(landmarks: PeerLandmarks) -> tuple[int, int]:
    """Return basis and size of the descriptors, which must be equal within one array."""
    return landmarks.descriptor_basis, landmarks.descriptors.shape[1]
