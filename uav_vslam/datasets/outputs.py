# SPDX-License-Identifier: Apache-2.0
"""Reads a fleet's recorded estimates, and the ground truth from the replayed bags."""

import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uav_vslam.datasets.cdr import RawMessage, decode
from uav_vslam.datasets.messages import TRUTH_TYPES, stamp_ns_of, truth_of
from uav_vslam.datasets.rosbag import TopicInfo, UpToDamage, iter_raw, names_of, topics_of
from uav_vslam.datasets.truth import left_out_text, unread_text
from uav_vslam.errors import BagError, InvalidMessage
from uav_vslam.evaluation.result import LinkCounters
from uav_vslam.types import FrameQuality, LinkEpoch, PoseEstimate

ODOMETRY, SMOOTHED, TRUTH = "odometry", "slam/smoothed", "ground_truth/odometry"
ESTIMATE_TYPES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped")
POSES = {
    ODOMETRY: "own_only",
    SMOOTHED: "smoothed",
    "fused/odometry": "fused",
    "ins/dead_reckoning": "dead_reckoning",
    TRUTH: "truth",
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
        peers: names of the peers that packets came from.
        counters: since the start; the dropped ones by "budget" are own ones that were not sent.
    """

    mode: str
    peers: tuple[str, ...]
    counters: LinkCounters


@dataclass(slots=True)
class RecordedOutputs:
    """What the bags hold of one vehicle.

    Attributes:
        own_only, smoothed, fused, dead_reckoning, truth: pose estimates in recording order.
        link: the last fusion status, or None.
        epochs: traffic up to each fusion epoch, in recording order.
        frames: how each frame went, in recording order; empty if not recorded.
        frames_in: image pairs replayed, or None if the bags have none.
        warnings: why the ground truth serves less than it seems to.
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
    warnings: list[str] = field(default_factory=list)


def messages_to_read(paths: Sequence[Path]) -> int:
    """Return how many messages `read_outputs` reads.

    Raises:
        BagError: a path is missing or not a bag.
    """
    topics = topics_of(paths)
    wanted = _wanted(_vehicles(topics))
    return sum(info.count for topic, info in topics.items() if topic in wanted)


def read_outputs(
    paths: Sequence[Path], *, on_message: Callable[[], None] = lambda: None
) -> tuple[dict[str, RecordedOutputs], BagError | None]:
    """Read every vehicle that has an own-only track.

    Args:
        paths: bags with the estimates and, if available, the ground truth.
        on_message: called after each message, for a progress bar.

    Returns:
        The outputs by vehicle, sorted by name; and the error if a bag is damaged: the outputs then end at the
        damage.

    Raises:
        BagError: a path is missing or not a bag, an estimate can't be decoded, no bag has an own-only track, or they
            hold several passes of one recording.
    """
    topics = topics_of(paths)
    names = _vehicles(topics)
    if not names:
        raise BagError(
            f"no /<vehicle>/odometry of {ESTIMATE_TYPES[0]} in {names_of(paths)}; give the bag of the estimates, or "
            f"make them of the sensors' data: uav-vslam run {shlex.join(map(str, paths))}; {_held(topics)}"
        )
    outputs = {name: RecordedOutputs() for name in names}
    for name in names:
        if f"/{name}/{FRAMES}" in topics:
            outputs[name].frames_in = topics[f"/{name}/{FRAMES}"].count
    messages, left_out = UpToDamage(iter_raw(paths, _wanted(names))), Counter[str]()
    for raw in messages:
        _, name, ending = raw.topic.split("/", 2)
        if ending != TRUTH:
            _store(outputs[name], ending, raw)
        elif raw.msgtype in TRUTH_TYPES and not _store_truth(outputs[name], raw):
            left_out[name] += 1
        on_message()
    for name, recorded in outputs.items():
        recorded.warnings += _truth_warnings(topics, name, len(recorded.truth), left_out[name])
        _check_passes(name, recorded)
    return outputs, messages.error


def _vehicles(topics: dict[str, TopicInfo]) -> list[str]:
    """Return the names of the vehicles that have an own-only track, sorted."""
    found = {topic for topic, info in topics.items() if info.msgtype == ESTIMATE_TYPES[0]}
    return sorted(t.split("/")[1] for t in found if t.count("/") == 2 and t.endswith(f"/{ODOMETRY}"))


def _held(topics: dict[str, TopicInfo]) -> str:
    """Return the topics of recordings in words, a line for each type, estimates first."""
    types = sorted({info.msgtype for info in topics.values()}, key=lambda one: (one not in ESTIMATE_TYPES, one))
    names = {one: sorted(topic for topic, info in topics.items() if info.msgtype == one) for one in types}
    return "recorded:" + "".join(f"\n  {one}: {', '.join(names[one])}" for one in types) if types else "it is empty"


def _wanted(names: Sequence[str]) -> list[str]:
    """Return the topics of vehicles that are read."""
    return [f"/{name}/{ending}" for name in names for ending in (*POSES, STATUS, QUALITY)]


def _truth_warnings(topics: dict[str, TopicInfo], name: str, count: int, left_out: int) -> Iterator[str]:
    """Yield why a vehicle's ground truth serves less than it seems to, by its poses read and left out."""
    topic = f"/{name}/{TRUTH}"
    if topic in topics and topics[topic].msgtype not in TRUTH_TYPES:
        yield unread_text(topic, topics[topic].msgtype)
    if left_out:
        yield left_out_text(left_out, count)


def _check_passes(name: str, recorded: RecordedOutputs) -> None:
    """Refuse several passes of one recording: their estimates of a stamp are not those of one flight."""
    times = Counter(estimate.stamp_ns for estimate in recorded.own_only)
    if sum(count > 1 for count in times.values()) > len(times) / 2:  # a node that was restarted repeats a few
        raise BagError(
            f"/{name}/odometry holds most stamps {max(times.values())} times: several passes of a recording, as with "
            "a looped bag, or several runs; record each into a bag of its own, and evaluate them one by one"
        )


def _store(outputs: RecordedOutputs, ending: str, raw: RawMessage) -> None:
    built = decode(raw)
    if ending == STATUS:
        outputs.link = _link(built)
        outputs.epochs.append(_epoch(built))
        return
    if ending == QUALITY:
        outputs.frames.append(_frame_quality(built))
        return
    if raw.msgtype not in ESTIMATE_TYPES:
        raise BagError(f"{raw.topic} holds {raw.msgtype}, not {' or '.join(ESTIMATE_TYPES)}; give the recorder's bag")
    track: list[PoseEstimate] = getattr(outputs, POSES[ending])
    try:
        track.append(_pose_estimate(built))
    except InvalidMessage as error:
        raise BagError(f"{raw.topic} at {stamp_ns_of(built)} ns holds no pose: {error}") from None


def _store_truth(outputs: RecordedOutputs, raw: RawMessage) -> bool:
    """Add a true pose, unless it can't be used; return whether it can."""
    try:
        outputs.truth.append(_pose_estimate(decode(raw)))
    except (BagError, InvalidMessage):
        return False
    return True


def _pose_estimate(built: Any) -> PoseEstimate:
    """Return the pose of an estimate or of ground truth; its covariance is zero where the message has none."""
    recorded = getattr(getattr(built, "pose", None), "covariance", np.zeros(36))
    covariance = np.array(recorded, dtype=float).reshape(6, 6)
    return PoseEstimate(stamp_ns_of(built), truth_of(built).T_world_body, covariance)


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
    counters = LinkCounters(
        packets_sent=int(built.packets_sent),
        sent_bytes_per_s=float(built.sent_bytes_per_s),
        packets_received=sum(int(peer.packets_received) for peer in built.peers),
        packets_used=sum(int(peer.packets_used) for peer in built.peers),
        packets_waiting=sum(int(getattr(peer, "packets_waiting", 0)) for peer in built.peers),  # older bags lack it
        dropped=dropped,
    )
    return LinkRecord(built.mode, tuple(peer.peer for peer in built.peers), counters)


def _epoch(built: Any) -> LinkEpoch:
    return LinkEpoch(
        stamp_ns=stamp_ns_of(built),
        packets_sent=int(built.packets_sent),
        bytes_sent=int(built.bytes_sent),
        packets_received=sum(int(peer.packets_received) for peer in built.peers),
        bytes_received=sum(int(peer.received_bytes) for peer in built.peers),
        packets_used=sum(int(peer.packets_used) for peer in built.peers),
    )
