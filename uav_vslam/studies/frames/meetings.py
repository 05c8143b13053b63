# SPDX-License-Identifier: Apache-2.0
"""Vehicles that exchange and fuse packets; the matches and alignment of each packet are recorded."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.alignment import Alignment
from uav_vslam.cooperation.epoch_fusion import EpochFusion
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.studies.engine.separate_frames import OwnOnlyTracks
from uav_vslam.types import JointInformation, LandmarkPacket, PoseEstimate

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Meeting:
    """A received packet and its matches.

    Attributes:
        joint: the own belief.
        packet: the peer's.
        pairs: (K, 2) matched rows of both.
        alignment: of the peer's frame; None where it is not known, or not needed.
    """

    joint: JointInformation
    packet: LandmarkPacket
    pairs: Pairs
    alignment: Alignment | None = None


class RecordingFusion(Fusion):
    """A fusion that records its meetings."""

    def __init__(self, vehicle: str, config: FusionConfig) -> None:
        super().__init__(vehicle, config)
        self.meetings: list[Meeting] = []

    def _common(self, fusing: EpochFusion, packet: LandmarkPacket) -> Pairs:
        pairs = super()._common(fusing, packet)
        alignment = self.frame(packet.vehicle).alignment
        self.meetings.append(Meeting(fusing.joint, packet, pairs, alignment))
        return pairs


def meet(flown: OwnOnlyTracks, fusions: Mapping[str, Fusion]) -> dict[str, Trajectory]:
    """Exchange packets and fuse, as `fleet.cooperate` does over perfect links; return the fused trajectories."""
    outputs = [(o.report.pose.stamp_ns, name, o) for name, track in flown.tracks.items() for o in track.outputs]
    poses: dict[str, list[PoseEstimate]] = {name: [] for name in fusions}
    for _, name, output in sorted(outputs, key=lambda item: item[:2]):
        if output.joint is not None:
            fusions[name].fuse(output.joint)
            packet = fusions[name].packet()
            for other in fusions:
                if other != name:
                    fusions[other].inbox.add(packet)
        poses[name].append(fusions[name].propagate(output.report.pose))
    return {name: Trajectory.from_estimates(estimates) for name, estimates in poses.items()}
