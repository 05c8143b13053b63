# SPDX-License-Identifier: Apache-2.0
"""The offline twin of the node graph: several vehicles, their packets and their fusion in one process.

Own-only tracks know nothing of the network, so they can be computed first, one process a vehicle; the exchange of
packets and the fusion follow in stamp order, exactly as in lock-step replay.
"""

from dataclasses import dataclass, field

from uav_vslam.config import VehicleConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.types import PoseEstimate


@dataclass(slots=True)
class CooperativeTrack:
    """A whole flight of one vehicle with its peers' help.

    Attributes:
        fusion: the fusion core; it knows what was sent, received, used and dropped.
        poses: fused pose at every own-only frame.
    """

    fusion: Fusion
    poses: list[PoseEstimate] = field(default_factory=list)


def cooperate(tracks: dict[str, VehicleTrack], configs: dict[str, VehicleConfig]) -> dict[str, CooperativeTrack]:
    """Exchange packets and fuse.

    Args:
        tracks: own-only tracks by vehicle.
        configs: their configurations; a vehicle whose `fusion.mode` is none neither sends nor listens.

    Returns:
        A cooperative track for each vehicle.
    """
    fleet = {name: CooperativeTrack(Fusion(name, configs[name].fusion)) for name in tracks}
    on_air = [name for name in tracks if configs[name].fusion.mode != "none"]
    frames = [(output.report.pose.stamp_ns, name, output) for name, track in tracks.items() for output in track.outputs]
    for _, name, output in sorted(frames, key=lambda frame: frame[:2]):
        member = fleet[name]
        if output.joint is not None:
            member.fusion.fuse(output.joint)
            if name in on_air:
                packet = member.fusion.packet(output.joint)
                for peer in on_air:
                    if peer != name:
                        fleet[peer].fusion.inbox.add(packet)
        member.poses.append(member.fusion.carry(output.report.pose))
    return fleet
