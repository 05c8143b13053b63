# SPDX-License-Identifier: Apache-2.0
"""Data association with a peer whose map frame is unknown; one link per peer.

Not aligned: no matches until the evidence suffices for `align`. Aligned: each packet updates the alignment from the
recently received landmarks; if these do not suffice, inliers of the known frame are still returned, since no search is
needed. The frame is reset when the peer restarts, and after several packets that contradict it.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.alignment import MIN_INLIERS, Alignment, Refusal, align, follow
from uav_vslam.cooperation.common_landmarks import comparable, descriptor_matches
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.point_pairs import PointPairs
from uav_vslam.cooperation.received_map import ReceivedMap, updated_map
from uav_vslam.types import LandmarkPacket

Pairs = NDArray[np.intp]

MISFITS = 3  # packets in a row that contradict the frame
LEAST = 2  # landmarks of a packet: a single one has nothing to say about more than the frame


class FrameLink:
    """Alignment with one peer's map frame.

    Attributes:
        alignment: the latest; None while there is none.
        reason: why there is none, or why the last packet could not update it; empty if it did.
    """

    def __init__(self) -> None:
        self.alignment: Alignment | None = None
        self.reason = "no packet yet"
        self._session: int | None = None
        self._newest = (0, 0)  # stamp and sequence of the newest packet
        self._received: ReceivedMap | None = None
        self._misfits = 0

    def find_common(self, own: OwnLandmarks, packet: LandmarkPacket, *, config: FusionConfig) -> Pairs:
        """Match as `common_landmarks.find_common`, with landmarks in the own frame, and update the alignment.

        Without an alignment nothing matches.
        """
        if packet.session != self._session:
            self._reset("no frame found since it started")
            self._session = packet.session
        if not comparable(own.descriptors, packet):
            return np.zeros((0, 2), np.intp)
        self._received = updated_map(packet, self._received)
        pairs = descriptor_matches(own.descriptors, self._received, config.ratio)
        points = PointPairs.of(own, self._received, pairs, config.floor_sigma_m)
        now = np.flatnonzero(pairs[:, 1] < len(packet))  # landmarks of earlier packets only align the frames
        is_new, self._newest = packet.order != self._newest, packet.order
        rows = self._inliers(points, now, max(config.min_common, LEAST), is_new=is_new)
        return pairs[rows]

    def agreeing(self, points: PointPairs) -> Pairs:
        """Return the rows of pairs that fit the known frame and each other; none without a known frame."""
        followed = follow(points, self.alignment.T_own_peer) if self.alignment else None
        return followed.inliers if followed else np.zeros(0, np.intp)

    def _inliers(self, points: PointPairs, now: Pairs, min_common: int, *, is_new: bool) -> Pairs:
        """Update the alignment; return those rows of `now`, the newest packet's, that fit."""
        found, nothing = align(points), now[:0]
        if isinstance(found, Refusal):
            self.reason = found.reason
            rows = now[self.agreeing(points.take(now))]
        else:
            rows = np.intersect1d(found.inliers, now)
        if len(rows) < min_common and len(now) >= MIN_INLIERS:
            if is_new:  # an epoch without a new packet processes the same one again
                self._contradicted()
            return nothing
        if len(rows) >= min_common:
            self._misfits = 0
        if isinstance(found, Alignment):
            self.alignment, self.reason = found, ""
        return rows if len(rows) >= min_common else nothing

    def _contradicted(self) -> None:
        """Reset frame and received map after MISFITS packets with enough matches that do not fit."""
        self._misfits += self.alignment is not None
        if self._misfits == MISFITS:
            self._reset("its landmarks contradicted the frame found before")

    def _reset(self, reason: str) -> None:
        self.alignment, self._received, self._misfits, self.reason = None, None, 0, reason
