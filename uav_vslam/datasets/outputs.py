# SPDX-License-Identifier: Apache-2.0
"""Reads a fleet's recorded estimates, and the ground truth from the replayed bags."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uav_vslam.datasets.cdr import RawMessage, decode
from uav_vslam.datasets.messages import stamp_ns_of, truth_of
from uav_vslam.datasets.rosbag import iter_raw, topics_of
from uav_vslam.errors import BagError
from uav_vslam.types import FrameQuality, LinkEpoch, PoseEstimate

POSES = {
    "odometry": "own_only",
    "slam/smoothed": "smoothed",
    "fused/odometry": "fused",
    "ins/dead_reckoning": "dead_reckoning",
    "ground_truth/odometry": "truth",
}
STATUS = "fusion/status"
QUALITY = "slam/quality"
CALIBRATION = ("time_offset_s", "time_offset_sigma_s", "disparity_error_px", "disparity_error_sigma_px")
FRAMES = "left/camera_info"


@dataclass(frozen=True, slots=True)
class LinkRecord:
    """The last status of a vehicle's fusion node.

    Attributes:
        mode: communication mode.
        packets_sent: since the start.
        sent_bytes_per_s: mean rate since the first packet [B/s].
        packets_received, packets_used, packets_waiting: over all peers.
        dropped: packets dropped, by reason, over all peers; "budget" counts own ones that were not sent.
        peers: names of the peers that packets came from.
    """

    mode: str
    packets_sent: int
    sent_bytes_per_s: float
    packets_received: int
    packets_used: int
    packets_waiting: int
    dropped: dict[str, int]
    peers: tuple[str, ...]


@dataclass(slots=True)
class RecordedOutputs:
    """What the bags hold of one vehicle.

    Attributes:
        own_only, smoothed, fused, dead_reckoning, truth: pose estimates in recording order.
        link: the last fusion status, or None.
        epochs: traffic up to each fusion epoch, in recording order.
        frames: how each frame went, in recording order; empty if not recorded.
        frames_in: image pairs replayed, or None if the bags have none.
    """

    own_only: list[PoseEstimate] = field(default_factory=list)
    smoothed: list[PoseEstimate] = field(default_factory=list)
    fused: list[PoseEstimate] = field(default_factory=list)
    dead_reckoning: list[PoseEstimate] = field(default_factory=list)
    truth: list[PoseEstimate] = field(default_factory=list)
    link: LinkRecord | None = None
    epochs: list[LinkEpoch] = field(default_factory=list)
    frames: list[FrameQuality] = field(default_factory=list)
    frames_in: int | None = None


def read_outputs(paths: Sequence[Path]) -> tuple[dict[str, RecordedOutputs], BagError | None]:
    """Read every vehicle that has an own-only track.

    Args:
        paths: bags with the estimates and, if available, the ground truth.

    Returns:
        The outputs by vehicle, sorted by name; and the error if a bag is damaged: the outputs then end at the
        damage.

    Raises:
        BagError: a path is missing or not a bag, a message can't be decoded, no bag has an own-only track, or they hold
            several passes of one recording.
    """
    topics = topics_of(paths)
    names = sorted({topic.split("/")[1] for topic in topics if topic.count("/") == 2 and topic.endswith("/odometry")})
    if not names:
        held = ", ".join(sorted(topics)) or "nothing"
        raise BagError(
            f"{', '.join(map(str, paths))} hold no /<vehicle>/odometry but {held}; give the bag of the estimates"
        )
    outputs = {name: RecordedOutputs() for name in names}
    for name in names:
        if f"/{name}/{FRAMES}" in topics:
            outputs[name].frames_in = topics[f"/{name}/{FRAMES}"].count
    wanted = [f"/{name}/{ending}" for name in names for ending in (*POSES, STATUS, QUALITY)]
    messages = _Readable(iter_raw(paths, wanted))
    for raw in messages:
        _, name, ending = raw.topic.split("/", 2)
        _store(outputs[name], ending, raw)
    for name, recorded in outputs.items():
        _check_passes(name, recorded)
    return outputs, messages.error


def _check_passes(name: str, recorded: RecordedOutputs) -> None:
    """Refuse several passes of one recording: their estimates of a stamp are not those of one flight."""
    times = Counter(estimate.stamp_ns for estimate in recorded.own_only)
    if sum(count > 1 for count in times.values()) > len(times) / 2:  # a node that was restarted repeats a few
        raise BagError(
            f"/{name}/odometry holds most stamps {max(times.values())} times: several passes of a recording, as with "
            "a looped bag, or several runs; record each into a bag of its own, and evaluate them one by one"
        )


class _Readable:
    """The messages before the damage, and the error that it raised."""

    def __init__(self, messages: Iterator[RawMessage]) -> None:
        self._messages = messages
        self.error: BagError | None = None

    def __iter__(self) -> Iterator[RawMessage]:
        try:
            yield from self._messages
        except BagError as error:
            self.error = error


def _store(outputs: RecordedOutputs, ending: str, raw: RawMessage) -> None:
    built = decode(raw)
    if ending == STATUS:
        outputs.link = _link(built)
        outputs.epochs.append(_epoch(built))
        return
    if ending == QUALITY:
        outputs.frames.append(_frame_quality(built))
        return
    track: list[PoseEstimate] = getattr(outputs, POSES[ending])
    track.append(_pose_estimate(built, raw.topic))


def _pose_estimate(built: Any, topic: str) -> PoseEstimate:
    covariance = np.array(built.pose.covariance, dtype=float).reshape(6, 6)
    try:
        pose = truth_of(built).T_world_body
    except ValueError as error:
        raise BagError(f"{topic} at {stamp_ns_of(built)} ns holds no pose: {error}") from None
    return PoseEstimate(stamp_ns_of(built), pose, covariance)


def _frame_quality(built: Any) -> FrameQuality:
    return FrameQuality(
        stamp_ns=stamp_ns_of(built),
        features=int(built.features),
        tracked=int(built.tracked),
        associated=int(built.associated),
        downweighted=int(built.downweighted),
        landmarks=int(built.landmarks),
        coasted=bool(built.coasted),
        relocalised=bool(built.relocalised),
        restarted=bool(built.restarted),
        closures=int(built.closures),
        nis=float(built.nis),
        dof=int(built.dof),
        gate_probability=float(built.gate_probability),
        events=tuple(built.events),
        **{name: float(getattr(built, name, 0.0)) for name in CALIBRATION},  # older bags lack it
    )


def _link(built: Any) -> LinkRecord:
    dropped = {"budget": int(built.packets_held_back)} if built.packets_held_back else {}
    for peer in built.peers:
        for reason, count in zip(peer.drop_reasons, peer.drop_counts, strict=True):
            dropped[reason] = dropped.get(reason, 0) + int(count)
    return LinkRecord(
        mode=built.mode,
        packets_sent=int(built.packets_sent),
        sent_bytes_per_s=float(built.sent_bytes_per_s),
        packets_received=sum(int(peer.packets_received) for peer in built.peers),
        packets_used=sum(int(peer.packets_used) for peer in built.peers),
        packets_waiting=sum(int(getattr(peer, "packets_waiting", 0)) for peer in built.peers),  # older bags lack it
        dropped=dropped,
        peers=tuple(peer.peer for peer in built.peers),
    )


def _epoch(built: Any) -> LinkEpoch:
    return LinkEpoch(
        stamp_ns=stamp_ns_of(built),
        packets_sent=int(built.packets_sent),
        bytes_sent=int(built.bytes_sent),
        packets_received=sum(int(peer.packets_received) for peer in built.peers),
        bytes_received=sum(int(peer.received_bytes) for peer in built.peers),
        packets_used=sum(int(peer.packets_used) for peer in built.peers),
    )
