# SPDX-License-Identifier: Apache-2.0
"""Which of a peer's landmarks is which of ours while its map frame is not known; one link a peer.

Not aligned: nothing is shared until the evidence is thick enough for `align`. Aligned: each packet is aligned anew;
where its evidence is thin, what fits the known frame is shared as well, for nothing has to be searched any more. The
frame is forgotten when the peer starts again, and when matches keep contradicting it.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.alignment import MIN_INLIERS, Alignment, Refusal, align, follow
from uav_vslam.cooperation.common_landmarks import look_alikes
from uav_vslam.cooperation.point_pairs import PointPairs
from uav_vslam.types import LandmarkPacket

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]

MISFITS = 3  # packets in a row that contradict the frame


class FrameLink:
    """What is known of one peer's map frame.

    Attributes:
        alignment: the newest one; None while there is none.
        reason: why there is none, or why the last packet could not renew it; empty if it did.
        found: how often a frame was found where none was known.
    """

    def __init__(self) -> None:
        self.alignment: Alignment | None = None
        self.reason = "no packet yet"
        self.found = 0
        self._session: int | None = None
        self._misfits = 0

    def find_common(
        self,
        positions: Array,
        covariance: Array,
        descriptors: NDArray[np.uint8],
        packet: LandmarkPacket,
        *,
        config: FusionConfig,
    ) -> Pairs:
        """Match own landmarks with a packet's, and renew the alignment; as `common_landmarks.find_common` otherwise.

        Args:
            positions: (N, 3) own landmarks in the own frame [m].
            covariance: (3N, 3N) their joint covariance [m^2].
            descriptors: (N, D) as extracted.
            packet: the peer's.
            config: ratio, floor and the smallest number of pairs that is believed.

        Returns:
            (K, 2) rows of own landmarks and of the packet; none without an alignment.
        """
        if packet.session != self._session:
            self._forget()
            self._session = packet.session
        pairs = look_alikes(descriptors, packet, config.ratio)
        points = PointPairs.of(positions, covariance, packet, pairs, config.floor_sigma_m)
        return pairs[self._inliers(points, config.min_common)]

    def _inliers(self, points: PointPairs, min_common: int) -> Pairs:
        aligned = align(points)
        if isinstance(aligned, Refusal):
            self.reason = aligned.reason
            return self._followed(points, min_common)
        self.found += self.alignment is None
        self.alignment, self.reason, self._misfits = aligned, "", 0
        return aligned.inliers

    def _followed(self, points: PointPairs, min_common: int) -> Pairs:
        """Return the rows that fit the known frame; forget it when enough matches contradict it too often."""
        nothing = np.zeros(0, np.intp)
        if self.alignment is None or len(points) < min_common:
            return nothing
        followed = follow(points, self.alignment.T_own_peer)
        if followed is not None and len(followed.inliers) >= min_common:
            self._misfits = 0
            return followed.inliers
        self._misfits += len(points) >= MIN_INLIERS
        if self._misfits == MISFITS:
            self._forget()
        return nothing

    def _forget(self) -> None:
        self.alignment, self._misfits = None, 0
