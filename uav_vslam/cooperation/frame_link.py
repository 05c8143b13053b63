# SPDX-License-Identifier: Apache-2.0
"""Which of a peer's landmarks is which of ours while its map frame is not known; one link a peer.

Not aligned: nothing is shared until the evidence is thick enough for `align`. Aligned: with each packet it is aligned
anew, by what was heard lately; where that is thin, what fits the known frame is shared as well, for nothing has to be
searched any more. The frame is forgotten when the peer starts again, and when matches keep contradicting it.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.alignment import MIN_INLIERS, Alignment, Refusal, align, follow
from uav_vslam.cooperation.common_landmarks import comparable, descriptor_matches
from uav_vslam.cooperation.point_pairs import PointPairs
from uav_vslam.cooperation.received_map import ReceivedMap, heard
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
        self._newest = (0, 0)  # stamp and sequence of the newest packet
        self._heard: ReceivedMap | None = None
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
        """Match as `common_landmarks.find_common`, with landmarks in the own frame, and renew the alignment.

        Without an alignment nothing matches.
        """
        if packet.session != self._session:
            self._forget("no frame found since it started")
            self._session = packet.session
        if not comparable(descriptors, packet):
            return np.zeros((0, 2), np.intp)
        self._heard = heard(packet, self._heard)
        pairs = descriptor_matches(descriptors, self._heard, config.ratio)
        points = PointPairs.of(positions, covariance, self._heard, pairs, config.floor_sigma_m)
        now = np.flatnonzero(pairs[:, 1] < len(packet))  # the others are of packets before: evidence, not to be fused
        is_new, self._newest = packet.order != self._newest, packet.order
        rows = self._inliers(points, now, config.min_common, is_new=is_new)
        return pairs[rows]

    def agreeing(self, points: PointPairs) -> Pairs:
        """Return the rows of pairs that fit the known frame and each other; none where there is none."""
        followed = follow(points, self.alignment.T_own_peer) if self.alignment else None
        return followed.inliers if followed else np.zeros(0, np.intp)

    def _inliers(self, points: PointPairs, now: Pairs, min_common: int, *, is_new: bool) -> Pairs:
        """Renew the alignment; return the rows of the newest packet, of those in `now`, that fit."""
        found, nothing = align(points), now[:0]
        if isinstance(found, Refusal):
            self.reason = found.reason
            rows = now[self.agreeing(points.take(now))]
        else:
            rows = np.intersect1d(found.inliers, now)
        if len(rows) < min_common and len(now) >= MIN_INLIERS:
            if is_new:  # an epoch without news looks at the same packet again
                self._contradicted()
            return nothing
        if len(rows) >= min_common:
            self._misfits = 0
        if isinstance(found, Alignment):
            self.found += self.alignment is None
            self.alignment, self.reason = found, ""
        return rows if len(rows) >= min_common else nothing

    def _contradicted(self) -> None:
        """Forget the frame, and what it rested on, when packets with enough matches don't fit it too often."""
        self._misfits += self.alignment is not None
        if self._misfits == MISFITS:
            self._forget("its landmarks contradicted the frame found before")

    def _forget(self, reason: str) -> None:
        self.alignment, self._heard, self._misfits, self.reason = None, None, 0, reason
