# SPDX-License-Identifier: Apache-2.0
"""The offline twin of the node graph: several vehicles, their packets and their fusion in one process.

Own-only tracks know nothing of the network, so they can be computed first, one process a vehicle; the exchange of
packets and the fusion follow in stamp order, exactly as in lock-step replay.
"""

from dataclasses import dataclass, field

from uav_vslam.config import VehicleConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.slam.packet import make_packet, payload_bytes
from uav_vslam.types import PoseEstimate


@dataclass(slots=True)
class CooperativeTrack:
    """A whole flight of one vehicle with its peers' help.

    Attributes:
        poses: fused pose at every own-only frame.
        packets_sent, bytes_sent: what this vehicle put on the radio.
        fusion: the fusion core, whose inbox knows what was received, used and dropped.
    """

    fusion: Fusion
    poses: list[PoseEstimate] = field(default_factory=list)
    packets_sent: int = 0
    bytes_sent: int = 0


def cooperate(tracks: dict[str, VehicleTrack], configs: dict[str, VehicleConfig]) -> dict[str, CooperativeTrack]:
    """Exchange packets and fuse.

    Args:
        tracks: own-only tracks by vehicle.
        configs: their configurations; a vehicle whose `fusion.mode` is none neither sends nor listens.

    Returns:
        A cooperative track for each vehicle.
    """
    fleet = {name: CooperativeTrack(Fusion(name, configs[name].fusion)) for name in tracks}
    frames = [(output.report.pose.stamp_ns, name, output) for name, track in tracks.items() for output in track.outputs]
    for _, name, output in sorted(frames, key=lambda frame: frame[:2]):
        member = fleet[name]
        if output.joint is not None:
            member.fusion.fuse(output.joint)
            _broadcast(name, output.joint, fleet, configs)
        member.poses.append(member.fusion.carry(output.report.pose))
    return fleet


def _broadcast(name, joint, fleet, configs):  # type: ignore[no-untyped-def]
    if configs[name].fusion.mode == "none":
        return
    sender = fleet[name]
    packet = make_packet(
        joint, sequence=sender.packets_sent + 1, max_landmarks=configs[name].fusion.max_packet_landmarks
    )
    sender.packets_sent += 1
    sender.bytes_sent += payload_bytes(packet)
    for peer, member in fleet.items():
        if peer != name and configs[peer].fusion.mode != "none":
            member.fusion.inbox.add(packet)
