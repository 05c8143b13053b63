# SPDX-License-Identifier: Apache-2.0
"""The offline twin of the node graph: several vehicles, their packets and their fusion in one process.

Own-only tracks do not depend on the network, so they can be computed elsewhere, ahead or beforehand; the exchange of
packets and the fusion follow in stamp order, exactly as in lock-step replay.
"""

import heapq
import itertools
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from uav_vslam.config import FusionConfig, LinkConfig, VehicleConfig
from uav_vslam.cooperation.exchange import Exchange, Receiver
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.cooperation.link import Link
from uav_vslam.cooperation.peer_faults import contradictions
from uav_vslam.errors import FilterDivergence
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.packet import payload_bytes
from uav_vslam.slam.saved_map import load_map
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket, LinkEpoch, PoseEstimate


@dataclass(frozen=True, slots=True)
class Sent:
    """A packet in transit; `feedback` if it estimates the receiver's landmarks."""

    packet: LandmarkPacket
    feedback: bool = False


PacketLink = Link[Sent]


@dataclass(slots=True)
class CooperativeTrack:
    """The cooperative flight of one vehicle.

    Attributes:
        fusion: the fusion core, which counts packets received, used and dropped.
        exchange: counts packets sent, refused and held back.
        poses: fused pose at every own-only frame.
        epochs: traffic up to each fusion epoch.
        fusion_s: processor time of fusion and packet [s], by the epoch's stamp [ns].
        failures: why epochs could not be fused, by their stamp [ns].
        contradictions: at how many epochs landmarks of others contradicted the own estimate, by what that means.
    """

    fusion: Fusion
    exchange: Exchange
    poses: list[PoseEstimate] = field(default_factory=list)
    epochs: list[LinkEpoch] = field(default_factory=list)
    fusion_s: dict[int, float] = field(default_factory=dict)
    failures: dict[int, str] = field(default_factory=dict)
    contradictions: Counter[str] = field(default_factory=Counter)

    @property
    def warnings(self) -> list[str]:
        """What failures and contradictions amount to, a line each; normally none."""
        epochs = len(self.failures) + len(self.epochs)
        texts = [f"{text}; at {count} of {epochs} epochs" for text, count in sorted(self.contradictions.items())]
        if self.failures:
            first_ns, reason = next(iter(self.failures.items()))
            texts.append(
                f"{len(self.failures)} of {epochs} epochs could not be fused, and the fused pose went on by the own "
                f"motion; the first time at {first_ns} ns: {reason}"
            )
        return texts


class Fleet:
    """Exchanges packets and fuses while the vehicles fly.

    Attributes:
        members: the cooperative flight of each vehicle so far.
    """

    def __init__(
        self,
        vehicles: Collection[str],
        configs: dict[str, VehicleConfig],
        links: Callable[[str, str], PacketLink] | None = None,
        on_packet: Callable[[Fusion, LandmarkPacket, int], None] = lambda *_: None,
        *,
        goes_on: bool = False,
    ) -> None:
        """Prepare.

        Args:
            vehicles: their names.
            configs: their configurations; a vehicle whose `fusion.mode` is none neither sends nor receives.
            links: makes the radio link from a sender to a receiver; without it packets arrive at once.
            on_packet: called with the maker of each packet sent, the packet and its size [byte]; not for relayed ones.
            goes_on: an epoch whose fusion diverges is recorded, and the flight goes on, as that of the nodes does.
        """
        self._goes_on = goes_on
        self.members: dict[str, CooperativeTrack] = {}
        self._air = Air(vehicles, links)
        for name in vehicles:
            settings = configs[name].fusion
            loaded = load_map(configs[name].start.map) if configs[name].start.map else None
            fusion, peers = Fusion(name, settings, loaded), [peer for peer in vehicles if peer != name]
            transport = LinkTransport(self._air, name, partial(on_packet, fusion))
            exchange = Exchange(fusion, peers, transport, settings)
            self.members[name] = CooperativeTrack(fusion, exchange)
            exchange.configure(settings)

    def add(self, vehicle: str, output: FrameOutput) -> None:
        """Take the next frame of the fleet, by stamp and vehicle; fuse and send if it is an epoch.

        Raises:
            FilterDivergence, LinAlgError: the fusion diverges, and the flight does not go on.
        """
        member, stamp_ns = self.members[vehicle], output.report.pose.stamp_ns
        if output.joint is not None:
            try:
                self._run_epoch(member, output.joint)
            except (FilterDivergence, np.linalg.LinAlgError) as error:
                if not self._goes_on:
                    raise
                member.failures[stamp_ns] = str(error)
        member.poses.append(member.fusion.propagate(output.report.pose))

    def _run_epoch(self, member: CooperativeTrack, joint: JointInformation) -> None:
        self._air.deliver(joint.stamp_ns)
        began_s = time.process_time()
        epoch = member.fusion.fuse(joint)
        member.exchange.send()
        member.fusion_s[joint.stamp_ns] = time.process_time() - began_s
        member.epochs.append(link_epoch(member, joint.stamp_ns))
        member.contradictions.update(contradictions(epoch).values())

    def land(self) -> None:
        """Deliver what has arrived by the last frame."""
        poses = [member.poses[-1] for member in self.members.values() if member.poses]
        if poses:
            self._air.deliver(max(pose.stamp_ns for pose in poses))


def cooperate(
    tracks: dict[str, VehicleTrack],
    configs: dict[str, VehicleConfig],
    links: Callable[[str, str], PacketLink] | None = None,
    on_packet: Callable[[Fusion, LandmarkPacket, int], None] = lambda *_: None,
) -> dict[str, CooperativeTrack]:
    """Fly a `Fleet`, which takes the same arguments, along own-only tracks that keep their joint information."""
    fleet = Fleet(tracks, configs, links, on_packet)
    for vehicle, output in in_stamp_order(named(name, track.outputs) for name, track in tracks.items()):
        fleet.add(vehicle, output)
    fleet.land()
    return fleet.members


def named(vehicle: str, outputs: Iterable[FrameOutput]) -> Iterator[tuple[str, FrameOutput]]:
    """Yield each output with the name of its vehicle."""
    return zip(itertools.repeat(vehicle), outputs)


def in_stamp_order(flights: Iterable[Iterable[tuple[str, FrameOutput]]]) -> Iterator[tuple[str, FrameOutput]]:
    """Yield the named outputs of several flights, each in this order already, by stamp and vehicle."""
    return heapq.merge(*flights, key=lambda frame: (frame[1].report.pose.stamp_ns, frame[0]))


def never_together(tracks: dict[str, VehicleTrack], configs: dict[str, VehicleConfig]) -> list[str]:
    """Return, in a line each, which cooperating vehicles were never in flight at the same time by their stamps."""
    spans = {
        name: (track.outputs[0].report.pose.stamp_ns, track.outputs[-1].report.pose.stamp_ns)
        for name, track in tracks.items()
        if track.outputs and configs[name].fusion.mode != "none"
    }
    ordered = sorted(spans, key=lambda name: spans[name])
    return [
        f"{later} begins {(spans[later][0] - spans[earlier][1]) / NS_PER_S:.0f} s after the end of {earlier}, by their "
        "stamps, so they exchange next to nothing; if they flew together, their clocks differ: shift the stamps of one"
        for earlier, later in itertools.combinations(ordered, 2)
        if spans[later][0] > spans[earlier][1]
    ]


def link_epoch(member: CooperativeTrack, stamp_ns: int) -> LinkEpoch:
    """Return the traffic of a vehicle up to now, as of an epoch."""
    peers = member.fusion.inbox.peers.values()
    return LinkEpoch(
        stamp_ns=stamp_ns,
        packets_sent=member.exchange.outbox.packets_sent,
        bytes_sent=member.exchange.outbox.bytes_sent,
        packets_received=sum(record.received for record in peers),
        bytes_received=sum(member.exchange.received_bytes.values()),
        packets_used=sum(record.used for record in peers),
    )


class Air:
    """The links between the vehicles, one per direction.

    Attributes:
        receivers: of arriving packets, by vehicle.
        now_ns: time of the last delivery.
    """

    def __init__(self, vehicles: Iterable[str], links: Callable[[str, str], PacketLink] | None = None) -> None:
        """Make a link from each vehicle to each other by `links`; without it packets arrive at once."""
        self.receivers: dict[str, Receiver] = {}
        self.now_ns = 0
        self._links = {
            pair: links(*pair) if links else Link(LinkConfig()) for pair in itertools.permutations(vehicles, 2)
        }

    def send(self, sender: str, receiver: str, sent: Sent) -> None:
        """Put a packet on the link between two vehicles."""
        self._links[sender, receiver].send(self.now_ns, payload_bytes(sent.packet), sent)

    def deliver(self, now_ns: int) -> None:
        """Deliver the packets that have arrived."""
        self.now_ns = now_ns
        for (sender, name), link in self._links.items():
            for sent in link.receive(now_ns):
                size, receiver = payload_bytes(sent.packet), self.receivers[name]
                if sent.feedback:
                    receiver.on_feedback(sent.packet, size)
                else:
                    receiver.on_packet(sender, sent.packet, size)


class LinkTransport:
    """A vehicle's end of the links: the `cooperation.exchange.Transport` of the offline twin.

    Together the links are one broadcast radio: a packet costs its size once, however many peers receive it.
    """

    copies = expected_copies = 1

    def __init__(
        self, air: Air, vehicle: str, on_packet: Callable[[LandmarkPacket, int], None] = lambda *_: None
    ) -> None:
        """Join; `on_packet` is called with each own packet sent and its size [byte]."""
        self._air, self._vehicle, self._on_packet = air, vehicle, on_packet

    @property
    def now_ns(self) -> int:
        """Time of the last delivery [ns]."""
        return self._air.now_ns

    def tune(self, settings: FusionConfig, receiver: Receiver) -> None:
        """Deliver arriving packets to a receiver, which ignores them in the mode none."""
        self._air.receivers[self._vehicle] = receiver

    def send(self, packet: LandmarkPacket, to: Collection[str]) -> None:
        """Send a packet over the links to some peers."""
        if packet.vehicle == self._vehicle:
            self._on_packet(packet, payload_bytes(packet))
        for peer in to:
            self._air.send(self._vehicle, peer, Sent(packet))

    def send_feedback(self, packet: LandmarkPacket, peer: str) -> None:
        """Send feedback over the link to one peer."""
        self._air.send(self._vehicle, peer, Sent(packet, feedback=True))
