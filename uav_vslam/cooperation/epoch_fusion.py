# SPDX-License-Identifier: Apache-2.0
"""The fusion of one epoch: packets enter one by one; a packet is dependent if its sources are already fused."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.cooperation.fused_pose import LOADED_MAP, FusedEpoch, move
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.peer_frame import PeerFrame
from uav_vslam.cooperation.schemes import SCHEMES
from uav_vslam.cooperation.unknown_frame import FrameEstimate
from uav_vslam.estimation.covariance_intersection import Split
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.types import JointInformation, LandmarkPacket, PoseEstimate

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]


class EpochFusion:
    """Starts with the own belief alone; the configured scheme fuses packets into it.

    Attributes:
        joint: the own belief.
        positions: (N, 3) landmarks as fused so far [m].
        sources: "vehicle/session" whose measurements are fused so far.
        common: landmarks shared with each peer.
        matched: identifiers of own landmarks that some peer shares.
        map_landmarks: landmarks shared with the loaded map.
        contradicting, displaced: as of `FusedEpoch`.
    """

    def __init__(self, joint: JointInformation, *, scheme: str, weighing: str, prior_id: str) -> None:
        P = joint.covariance
        self._scheme, self._weighing = SCHEMES[scheme], weighing
        self._belief = Split(P, np.zeros_like(P))
        self._own_covariance, self._T_map_body = P[:POSE_DIM, :POSE_DIM], joint.T_map_body
        self._weight, self._priors = 1.0, {prior_id, joint.prior_id} - {""}
        self._frames: dict[str, FrameEstimate] = {}
        self.joint = joint
        self.positions: Array = joint.positions
        self.sources = set(joint.sources)
        self.common: dict[str, int] = {}
        self.matched: set[int] = set()
        self.map_landmarks = 0
        self.contradicting: set[str] = set()
        self.displaced: set[str] = set()

    @property
    def landmarks(self) -> OwnLandmarks:
        """The own landmarks as fused so far."""
        covariance = self._belief.total[POSE_DIM:, POSE_DIM:]
        return OwnLandmarks(self.positions, covariance, self.joint.descriptors)

    def add(self, packet: LandmarkPacket, pairs: Pairs, frame: PeerFrame, *, feedback: bool = False) -> None:
        """Fuse a packet through (K, 2) pairs of own landmarks and its own.

        A packet whose sources or prior are fused already is dependent; any other is independent. Feedback, which is
        dependent, has the floor of its pairs in common with the same peer's packet.
        """
        self.matched |= set(self.joint.ids[pairs[:, 0]].tolist())
        if len(pairs):
            self._fuse(packet, pairs, frame, packet.vehicle, feedback=feedback)
        elif not feedback and frame.is_displaced(OwnLandmarks.of(self.joint), packet):
            self.displaced.add(packet.vehicle)

    def add_map(self, packet: LandmarkPacket, pairs: Pairs, frame: PeerFrame) -> None:
        """Fuse landmarks of a loaded map likewise; it shares none with peers."""
        self.map_landmarks = len(pairs)
        if len(pairs):
            self._fuse(packet, pairs, frame, LOADED_MAP)

    def _fuse(
        self, packet: LandmarkPacket, pairs: Pairs, frame: PeerFrame, name: str, *, feedback: bool = False
    ) -> None:
        dependent = bool(self.sources & set(packet.sources)) or packet.prior_id in self._priors
        framed = frame.framed(self.positions, packet, pairs, dependent=dependent)
        evidence = framed.evidence.with_known_floor() if feedback else framed.evidence
        if self._contradicts(packet, pairs, frame, dependent=dependent):
            self.contradicting.add(name)
        fused = self._scheme(self._belief, evidence, self._weighing)
        estimate = framed.frame(fused)
        if estimate is not None:
            self._frames[packet.vehicle] = estimate
        self._belief = fused.P
        self._T_map_body, self.positions = move(self._T_map_body, self.positions, fused.delta)
        self._weight = min(self._weight, fused.weight)
        self.sources |= set(packet.sources)
        self._priors |= {packet.prior_id} - {""}

    def _contradicts(self, packet: LandmarkPacket, pairs: Pairs, frame: PeerFrame, *, dependent: bool) -> bool:
        """Return whether a packet contradicts the own belief alone: that fused so far may hold others' wrong pairs."""
        alone = frame.framed(self.joint.positions, packet, pairs, dependent=dependent).evidence
        return alone.contradicts(self.joint.covariance)

    def epoch(self) -> FusedEpoch:
        """Return the result."""
        joint, total = self.joint, self._belief.total
        return FusedEpoch(
            own=PoseEstimate(joint.stamp_ns, joint.T_map_body, self._own_covariance),
            pose=PoseEstimate(joint.stamp_ns, self._T_map_body, total[:POSE_DIM, :POSE_DIM]),
            positions=self.positions,
            covariance=total,
            weight=self._weight,
            common=self.common,
            sources=frozenset(self.sources),
            frames=self._frames,
            map_landmarks=self.map_landmarks,
            contradicting=frozenset(self.contradicting),
            displaced=frozenset(self.displaced),
        )
