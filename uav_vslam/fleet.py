# SPDX-License-Identifier: Apache-2.0
"""The offline twin of the node graph: several vehicles, their packets and their fusion in one process.

Own-only tracks know nothing of the network, so they can be computed first, one process a vehicle; the exchange of
packets and the fusion follow in stamp order, exactly as in lock-step replay.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from uav_vslam.config import VehicleConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.cooperation.link import Link, LinkConfig
from uav_vslam.cooperation.outbox import Outbox
from uav_vslam.errors import InvalidMessage
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.slam.packet import payload_bytes
from uav_vslam.types import LandmarkPacket, PoseEstimate

PacketLink = Link[LandmarkPacket]


@dataclass(slots=True)
class CooperativeTrack:
    """A whole flight of one vehicle with its peers' help.

    Attributes:
        fusion: the fusion core; it knows what was received, used and dropped.
        outbox: it knows what was sent, and what the budget held back.
        poses: fused pose at every own-only frame.
        common_ns: epochs at which landmarks were shared with a peer.
    """

    fusion: Fusion
    outbox: Outbox
    poses: list[PoseEstimate] = field(default_factory=list)
    common_ns: list[int] = field(default_factory=list)


def cooperate(
    tracks: dict[str, VehicleTrack],
    configs: dict[str, VehicleConfig],
    links: Callable[[str, str], PacketLink] | None = None,
    on_packet: Callable[[Fusion, LandmarkPacket, int], None] = lambda *_: None,
) -> dict[str, CooperativeTrack]:
    """Exchange packets and fuse.

    Args:
        tracks: own-only tracks by vehicle.
        configs: their configurations; a vehicle whose `fusion.mode` is none neither sends nor listens.
        links: makes the radio link from a sender to a receiver; without it all arrives at once.
        on_packet: shown every packet that is sent, who made it, and its size [byte].

    Returns:
        A cooperative track for each vehicle.
    """
    fleet = {
        name: CooperativeTrack(Fusion(name, configs[name].fusion), Outbox(configs[name].fusion)) for name in tracks
    }
    on_air = [name for name in tracks if configs[name].fusion.mode != "none"]
    air: dict[tuple[str, str], PacketLink] = {
        (sender, receiver): links(sender, receiver) if links else Link(LinkConfig())
        for sender in on_air
        for receiver in on_air
        if sender != receiver
    }
    frames = [(output.report.pose.stamp_ns, name, output) for name, track in tracks.items() for output in track.outputs]
    for stamp_ns, name, output in sorted(frames, key=lambda frame: frame[:2]):
        member = fleet[name]
        if output.joint is not None:
            _deliver(air, fleet, configs, stamp_ns)
            epoch = member.fusion.fuse(output.joint)
            member.common_ns += [stamp_ns] if any(epoch.common.values()) else []
            if member.outbox.is_turn(stamp_ns):
                packet = member.fusion.packet(output.joint, byte_limit=member.outbox.available(stamp_ns))
                size = payload_bytes(packet)
                if member.outbox.take(packet.stamp_ns, size):
                    on_packet(member.fusion, packet, size)
                    for (sender, _), link in air.items():
                        if sender == name:
                            link.send(stamp_ns, size, packet)
        member.poses.append(member.fusion.carry(output.report.pose))
    if frames:
        _deliver(air, fleet, configs, max(stamp_ns for stamp_ns, _, _ in frames))
    return fleet


def _deliver(
    air: dict[tuple[str, str], PacketLink],
    fleet: dict[str, CooperativeTrack],
    configs: dict[str, VehicleConfig],
    now_ns: int,
) -> None:
    """Hand over what has arrived; what an inbox refuses, it counts, and what is news, a relay sends on as it came."""
    for (sender, receiver), link in air.items():
        for packet in link.receive(now_ns):
            try:
                fleet[receiver].fusion.inbox.add(packet)
            except InvalidMessage:
                continue
            fleet[receiver].outbox.hear(packet.stamp_ns)
            size = payload_bytes(packet)
            if configs[receiver].fusion.relay and fleet[receiver].outbox.take(now_ns, size):
                for (relay, other), onward in air.items():
                    if relay == receiver and other not in (sender, packet.vehicle):
                        onward.send(now_ns, size, packet)
