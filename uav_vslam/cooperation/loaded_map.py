# SPDX-License-Identifier: Apache-2.0
"""A loaded map as a source of evidence: like a peer that surveyed the ground before and never changes its mind.

Each epoch, the section that shares most landmarks with the own belief is fused as a packet would be. Sections are never
combined within an epoch: their errors are correlated to an unknown degree. Between epochs nothing is retained, so the
same section may be used again and again. A vehicle that started in the map depends on it, and intersects.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.peer_frame import PeerFrame
from uav_vslam.slam.packet.covariance import code_dense
from uav_vslam.slam.saved_map import MapSection, SavedMap
from uav_vslam.types import LandmarkPacket
from uav_vslam.vision.compact_descriptors import RAW

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]

REACH_M = 200.0  # of sections from the own landmarks' middle
TRIED_SECTIONS = 3  # the nearest


class LoadedMap:
    """The sections of a saved map as packets."""

    def __init__(self, saved: SavedMap) -> None:
        self._saved = saved
        self._anchors = np.array([section.anchor for section in saved.sections]).reshape(-1, 3)
        self._packets: dict[int, LandmarkPacket] = {}  # of the nearest sections

    def common(self, own: OwnLandmarks, frame: PeerFrame) -> tuple[LandmarkPacket, Pairs] | None:
        """Return the section with most common landmarks, and the (K, 2) pairs of own rows and its; None without any.

        Args:
            own: landmarks of the own belief, as fused so far.
            frame: the map's, common with the own.
        """
        best: tuple[LandmarkPacket, Pairs] | None = None
        self._packets = {row: self._packet(row) for row in self._nearest(own.positions)}
        for packet in self._packets.values():
            pairs = frame.find_common(own, packet)
            if len(pairs) > (0 if best is None else len(best[1])):
                best = packet, pairs
        return best

    def _nearest(self, positions: Array) -> list[int]:
        if len(positions) == 0 or len(self._anchors) == 0:
            return []
        distance_m = np.linalg.norm((self._anchors - np.median(positions, axis=0))[:, :2], axis=1)
        order = np.argsort(distance_m, kind="stable")[:TRIED_SECTIONS]
        return [int(row) for row in order[distance_m[order] <= REACH_M]]

    def _packet(self, row: int) -> LandmarkPacket:
        known = self._packets.get(row)
        return known if known is not None else _packet(self._saved, self._saved.sections[row], row)


def _packet(saved: SavedMap, section: MapSection, row: int) -> LandmarkPacket:
    origin = np.round(section.anchor).astype(np.int32)
    points, scale = code_dense(section.positions - origin, section.covariance)
    return LandmarkPacket(
        stamp_ns=saved.origin.stamp_ns,
        vehicle=saved.origin.vehicle,
        session=saved.origin.session,
        sequence=row,
        sources=saved.origin.sources,
        prior_id=saved.hash,
        ids=section.ids,
        origin=origin,
        points=points,
        covariance_scale=scale,
        descriptor_basis=RAW,
        descriptors=section.descriptors,
        checksum=0,
    )
