# SPDX-License-Identifier: Apache-2.0
"""The frame of a peer's map, one object for each peer: common with ours, or unknown and estimated."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation import common_landmarks
from uav_vslam.cooperation.alignment import Alignment, align
from uav_vslam.cooperation.common_landmarks import descriptor_matches
from uav_vslam.cooperation.frame_link import FrameLink
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.peer_associators import associate
from uav_vslam.cooperation.point_pairs import PointPairs
from uav_vslam.cooperation.schemes import Evidence
from uav_vslam.cooperation.unknown_frame import FrameEstimate, UnknownFramePacket, eliminate_frame
from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.estimation.covariance_intersection import Fused
from uav_vslam.numerics import submatrix
from uav_vslam.types import LandmarkPacket

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]


class PeerFrame(Protocol):
    """Turns the packets of one peer into evidence about the own state."""

    @property
    def reason(self) -> str:
        """Why the peer's frame is unknown; empty if it is known."""

    @property
    def alignment(self) -> Alignment | None:
        """The newest alignment; None if not found yet, or not needed."""

    def find_common(self, own: OwnLandmarks, packet: LandmarkPacket) -> Pairs:
        """Return (K, 2) rows of own landmarks and of the packet, see `peer_associators.associate`."""

    def agreeing(self, own: OwnLandmarks, packet: LandmarkPacket, pairs: Pairs) -> Pairs:
        """Return those of (K, 2) pairs, matched by identifier, that pass the gate; none in an unknown frame."""

    def is_displaced(self, own: OwnLandmarks, packet: LandmarkPacket) -> bool:
        """Return whether landmarks that look alike agree with each other, but not with where both maps claim to be."""

    def framed(self, positions: Array, packet: LandmarkPacket, pairs: Pairs, *, dependent: bool) -> "FramedPacket":
        """Return a packet as a measurement of the own state, position, xi and (N, 3) landmarks, in the own frame."""


class FramedPacket(Protocol):
    """A packet expressed in the own frame."""

    @property
    def evidence(self) -> Evidence:
        """The measurement of the own state."""

    def frame(self, fused: Fused) -> FrameEstimate | None:
        """Return the estimate of the peer's frame after `evidence` was fused; None for a common frame."""


@dataclass(frozen=True, slots=True)
class CommonFramePacket:
    """A packet that is already in the own frame."""

    evidence: Evidence

    def frame(self, fused: Fused) -> None:
        """See `FramedPacket`."""


class CommonFrame:
    """Both maps have a known common origin."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config

    @property
    def reason(self) -> str:
        """Always empty."""
        return ""

    @property
    def alignment(self) -> None:
        """Always None."""

    def find_common(self, own: OwnLandmarks, packet: LandmarkPacket) -> Pairs:
        """See `PeerFrame`."""
        return associate(own, packet, config=self._config)

    def agreeing(self, own: OwnLandmarks, packet: LandmarkPacket, pairs: Pairs) -> Pairs:
        """See `PeerFrame`."""
        maps = own.positions, own.covariance, packet.positions, packet.covariance
        return pairs[common_landmarks.gated(pairs, *maps, self._config)]

    def is_displaced(self, own: OwnLandmarks, packet: LandmarkPacket) -> bool:
        """See `PeerFrame`: as if the frame were unknown, the same landmarks are found wherever they are."""
        pairs = descriptor_matches(own.descriptors, packet, self._config.ratio)
        found = align(PointPairs.of(own, packet, pairs, self._config.floor_sigma_m))
        return isinstance(found, Alignment) and found.contradicts_common_frame

    def framed(self, positions: Array, packet: LandmarkPacket, pairs: Pairs, *, dependent: bool) -> CommonFramePacket:
        """See `PeerFrame`."""
        evidence = Evidence.of_landmarks(
            positions,
            pairs[:, 0],
            packet.positions[pairs[:, 1]],
            submatrix(packet.covariance, landmark_rows(0, pairs[:, 1])),
            floor_sigma_m=self._config.floor_sigma_m,
            dependent=dependent,
        )
        return CommonFramePacket(evidence)


class UnknownFrame:
    """The peer's map has an unknown yaw and translation against ours."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._link = FrameLink()

    @property
    def reason(self) -> str:
        """See `PeerFrame`."""
        return self._link.reason if self._link.alignment is None else ""

    @property
    def alignment(self) -> Alignment | None:
        """See `PeerFrame`."""
        return self._link.alignment

    def find_common(self, own: OwnLandmarks, packet: LandmarkPacket) -> Pairs:
        """See `PeerFrame`; updates the alignment."""
        return self._link.find_common(own, packet, config=self._config)

    def agreeing(self, own: OwnLandmarks, packet: LandmarkPacket, pairs: Pairs) -> Pairs:
        """See `PeerFrame`; at least two, because one pair alone cannot confirm a frame."""
        points = PointPairs.of(own, packet, pairs, self._config.floor_sigma_m)
        return pairs[self._link.agreeing(points)]

    def is_displaced(self, own: OwnLandmarks, packet: LandmarkPacket) -> bool:
        """See `PeerFrame`: an unknown frame may be anywhere."""
        return False

    def framed(self, positions: Array, packet: LandmarkPacket, pairs: Pairs, *, dependent: bool) -> UnknownFramePacket:
        """See `PeerFrame`; the evidence does not depend on the frame's estimate."""
        assert self._link.alignment is not None  # there are pairs
        T_own_peer, floor_m = self._link.alignment.T_own_peer, self._config.floor_sigma_m
        return eliminate_frame(positions, packet, pairs, T_own_peer, floor_sigma_m=floor_m, dependent=dependent)
