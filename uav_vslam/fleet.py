# SPDX-License-Identifier: Apache-2.0
"""The offline twin of the node graph: several vehicles, their packets and their fusion in one process.

Own-only tracks know nothing of the network, so they can be computed first, one process a vehicle; the exchange of
packets and the fusion follow in stamp order, exactly as in lock-step replay.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

from uav_vslam.config import FusionConfig, LinkConfig, VehicleConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.cooperation.link import Link
from uav_vslam.cooperation.outbox import Outbox
from uav_vslam.errors import InvalidMessage
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.slam.packet import payload_bytes
from uav_vslam.types import JointInformation, LandmarkPacket, PoseEstimate


@dataclass(frozen=True, slots=True)
class Sent:
    """A packet on the air; `returned` if it is feedback to the receiver on what it told."""

    packet: LandmarkPacket
    returned: bool = False


PacketLink = Link[Sent]


@dataclass(slots=True)
class CooperativeTrack:
    """A whole flight of one vehicle with its peers' help.

    Attributes:
        fusion: the fusion core; it knows what was received, used and dropped.
        outbox: it knows what was sent, and what the budget held back.
        poses: fused pose at every own-only frame.
    """

    fusion: Fusion
    outbox: Outbox
    poses: list[PoseEstimate] = field(default_factory=list)


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
    air = _Air(fleet, {name: config.fusion for name, config in configs.items()}, links, on_packet)
    frames = [(output.report.pose.stamp_ns, name, output) for name, track in tracks.items() for output in track.outputs]
    for stamp_ns, name, output in sorted(frames, key=lambda frame: frame[:2]):
        member = fleet[name]
        if output.joint is not None:
            air.deliver(stamp_ns)
            member.fusion.fuse(output.joint)
            air.send(name, output.joint)
        member.poses.append(member.fusion.carry(output.report.pose))
    if frames:
        air.deliver(max(stamp_ns for stamp_ns, _, _ in frames))
    return fleet


class _Air:
    """The links between the vehicles that cooperate."""

    def __init__(
        self,
        fleet: dict[str, CooperativeTrack],
        configs: dict[str, FusionConfig],
        links: Callable[[str, str], PacketLink] | None,
        on_packet: Callable[[Fusion, LandmarkPacket, int], None],
    ) -> None:
        self._fleet, self._configs, self._on_packet = fleet, configs, on_packet
        on_air = [name for name in fleet if configs[name].mode != "none"]
        self._links: dict[tuple[str, str], PacketLink] = {
            (sender, receiver): links(sender, receiver) if links else Link(LinkConfig())
            for sender, receiver in itertools.permutations(on_air, 2)
        }

    def send(self, name: str, joint: JointInformation) -> None:
        """Let a vehicle send what it has to say at an epoch, as far as its budget goes."""
        member, stamp_ns = self._fleet[name], joint.stamp_ns
        if not member.outbox.should_send(stamp_ns):
            return
        packet = member.fusion.packet(joint, byte_limit=member.outbox.available(stamp_ns))
        size = payload_bytes(packet)
        if member.outbox.try_reserve(stamp_ns, size):
            self._on_packet(member.fusion, packet, size)
            for link in self._from(name).values():
                link.send(stamp_ns, size, Sent(packet))
        if self._configs[name].returns_feedback:
            for peer, link in self._from(name).items():
                feedback = member.fusion.feedback(peer)
                if feedback is not None and member.outbox.try_reserve(stamp_ns, size := payload_bytes(feedback)):
                    link.send(stamp_ns, size, Sent(feedback, returned=True))

    def deliver(self, now_ns: int) -> None:
        """Hand over what has arrived; an inbox counts what it refuses; what is news, a relay sends on as it came."""
        for (sender, receiver), link in self._links.items():
            for sent in link.receive(now_ns):
                member = self._fleet[receiver]
                try:
                    (member.fusion.returned if sent.returned else member.fusion.inbox).add(sent.packet)
                except InvalidMessage:
                    continue
                member.outbox.on_packet(sent.packet.stamp_ns)
                if self._configs[receiver].relay and not sent.returned:
                    self._relay(sent, receiver, now_ns, but_to={sender, sent.packet.vehicle})

    def _relay(self, sent: Sent, name: str, now_ns: int, *, but_to: set[str]) -> None:
        size = payload_bytes(sent.packet)
        if self._fleet[name].outbox.try_reserve(now_ns, size):
            for peer, link in self._from(name).items():
                if peer not in but_to:
                    link.send(now_ns, size, sent)

    def _from(self, name: str) -> dict[str, PacketLink]:
        """Return a sender's links by receiver."""
        return {receiver: link for (sender, receiver), link in self._links.items() if sender == name}
