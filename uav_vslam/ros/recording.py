# SPDX-License-Identifier: Apache-2.0
"""The messages of a fleet's bags that are replayed, as serialised bytes."""

import heapq
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from uav_vslam.config import InputConfig
from uav_vslam.config.input import image_names
from uav_vslam.datasets.bag import IMAGE_TOPICS
from uav_vslam.datasets.messages import header_stamp_ns
from uav_vslam.datasets.rosbag import RawMessage, iter_raw, topics_of
from uav_vslam.datasets.sensor_setup import SIDES
from uav_vslam.datasets.stereo_sync import default_tolerance_ns
from uav_vslam.errors import BagError
from uav_vslam.ros.pacing import Kind, Recorded

TF_STATIC = "/tf_static"
INITIAL_STATE = "initial_state"
KINDS = {"left": Kind.LEFT, "right": Kind.RIGHT, "left_info": Kind.INFO, "imu": Kind.IMU}  # by role
FIRST_FRAMES = 20  # that tell the frame period
# Outputs of the nodes: not replayed from the recording of a whole run.
OUTPUTS = ("odometry", "path", "landmarks", "stereo_features", "joint_information", "landmark_information")
OUTPUT_FOLDERS = ("ins/", "slam/", "fused/", "fusion/")


class Recording:
    """The bags of a fleet.

    Attributes:
        vehicles: names, in the order requested.
        topics: those replayed, by name.
        starts_ns: stamp of each vehicle's start state [ns]; absent if none is replayed.
        damage: errors that ended a bag early.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        vehicles: Sequence[str] = (),
        *,
        finding_start: Sequence[str] = (),
        inputs: Mapping[str, InputConfig] | None = None,
    ) -> None:
        """Index the bags; replay `vehicles`, or all that have images.

        Args:
            paths: the bags.
            vehicles: names.
            finding_start: those that estimate their start state: a recorded one would contradict it.
            inputs: topics by vehicle; the conventional ones of those that are absent.

        Raises:
            BagError: a bag is missing, unreadable, or lacks a topic that a vehicle needs.
        """
        if not paths:
            raise BagError("no recording to replay; set the parameter bags, or give --bag")
        self._paths, known = tuple(paths), topics_of(paths)
        self._finding_start = frozenset(finding_start)
        self._inputs = dict(inputs or {})
        self.vehicles = tuple(vehicles) or tuple(self._inputs) or _with_images(known)
        self._roles = {topic: (vehicle, role) for vehicle in self.vehicles for role, topic in self._named(vehicle)}
        self.topics = {topic: info for topic, info in known.items() if self._is_input(topic)}
        self.damage: list[str] = []
        for vehicle in self.vehicles:
            self._require(vehicle)
        self.latched = self._read_latched()
        self.starts_ns = {
            vehicle: header_stamp_ns(raw.data)
            for vehicle in self.vehicles
            for raw in self.latched
            if raw.topic == self.topic(vehicle, INITIAL_STATE)
        }

    def frames(self, vehicle: str) -> int:
        """Return the number of recorded left images."""
        return self._count(vehicle, Kind.LEFT)

    def classify(self, topic: str) -> tuple[str, Kind]:
        """Return the vehicle ("" for the fleet's own topics) and the topic's role in the pacing."""
        if topic in self._roles:
            vehicle, role = self._roles[topic]
            return vehicle, KINDS.get(role, Kind.OTHER)
        owner = next((vehicle for vehicle in self.vehicles if topic.startswith(f"/{vehicle}/")), "")
        return owner, Kind.OTHER

    def consumed(self, vehicle: str) -> list[str]:
        """Return the topics that need a subscriber before a vehicle can run."""
        roles = (*KINDS, "right_info")
        return [
            t for t, (owner, role) in self._roles.items() if owner == vehicle and role in roles and t in self.topics
        ]

    def has_infos(self, vehicle: str) -> bool:
        """Return whether the left images come with a camera_info; else calibration files replace it."""
        return self._count(vehicle, Kind.INFO) > 0

    def pair_tolerance_ns(self, vehicle: str) -> int:
        """Return the front end's default tolerance after the first images [ns]."""
        topics = [topic for topic in self.topics if self.classify(topic) == (vehicle, Kind.LEFT)]
        streams = itertools.chain.from_iterable(self._until_broken(path, topics) for path in self._paths)
        stamps = [header_stamp_ns(raw.data) for raw in itertools.islice(streams, FIRST_FRAMES)]
        self.damage.clear()  # the replay detects it again
        return default_tolerance_ns([later - earlier for earlier, later in itertools.pairwise(stamps)])

    def messages(self) -> Iterator[Recorded]:
        """Yield all but the latched messages in recorded order; a damaged bag ends early."""
        latched = {raw.topic for raw in self.latched}
        topics = [topic for topic in self.topics if topic not in latched]
        streams = [self._until_broken(path, topics) for path in self._paths]
        for raw in heapq.merge(*streams, key=lambda raw: raw.stamp_ns):
            vehicle, kind = self.classify(raw.topic)
            stamp_ns = raw.stamp_ns if kind is Kind.OTHER else header_stamp_ns(raw.data)
            yield Recorded(raw.topic, raw.msgtype, vehicle, kind, stamp_ns, raw.data)

    def _until_broken(self, path: Path, topics: Sequence[str]) -> Iterator[RawMessage]:
        try:
            yield from iter_raw([path], topics)
        except BagError as error:
            self.damage.append(str(error))

    def _read_latched(self) -> list[RawMessage]:
        topics = [topic for topic, info in self.topics.items() if info.latched or _is_latched(topic)]
        newest: dict[tuple[Path, str, bytes], RawMessage] = {}
        for path in self._paths:
            for raw in self._until_broken(path, topics):
                # Several nodes may each publish a part of /tf_static.
                newest[path, raw.topic, raw.data if raw.topic == TF_STATIC else b""] = raw
        self.damage.clear()  # the replay detects it again
        return list(newest.values())

    def topic(self, vehicle: str, role: str) -> str:
        """Return the name of a vehicle's input; `role` is a key of `input.topics`."""
        return self._inputs.get(vehicle, InputConfig()).topic(vehicle, role)

    def _named(self, vehicle: str) -> Iterator[tuple[str, str]]:
        """Yield role and topic of a vehicle's inputs; images under both names."""
        for role in (*KINDS, "right_info", INITIAL_STATE):
            topic = self.topic(vehicle, role)
            yield from ((role, name) for name in (image_names(topic) if role in SIDES else (topic,)))

    def _is_input(self, topic: str) -> bool:
        vehicle, _ = self.classify(topic)
        if topic in self._roles:
            return self._roles[topic][1] != INITIAL_STATE or vehicle not in self._finding_start
        name = topic.removeprefix(f"/{vehicle}/")
        return topic == TF_STATIC or (vehicle != "" and name not in OUTPUTS and not name.startswith(OUTPUT_FOLDERS))

    def _count(self, vehicle: str, kind: Kind) -> int:
        counts = [info.count for topic, info in self.topics.items() if self.classify(topic) == (vehicle, kind)]
        return max(counts, default=0)

    def _require(self, vehicle: str) -> None:
        bags = ", ".join(map(str, self._paths))
        recorded = {self.classify(topic) for topic in self.topics}
        for kind in (Kind.LEFT, Kind.RIGHT, Kind.IMU):
            if (vehicle, kind) not in recorded:
                names = " or ".join(t for t in self._roles if self.classify(t) == (vehicle, kind))
                held = ", ".join(_with_images(topics_of(self._paths))) or "none"
                raise BagError(f"{bags}: no {names} for vehicle {vehicle}; vehicles recorded: {held}")
        infos, images = self._count(vehicle, Kind.INFO), self.frames(vehicle)
        if infos and 2 * infos < images:
            raise BagError(
                f"{bags}: {infos} messages on {self.topic(vehicle, 'left_info')} for {images} left images; the nodes "
                "need one with each image, of the same stamp (uav-vslam run does not), or none and input.calibration"
            )


def _is_latched(topic: str) -> bool:
    return topic == TF_STATIC or topic.endswith(f"/{INITIAL_STATE}")


def _with_images(topics: Iterable[str]) -> tuple[str, ...]:
    endings = [f"/left/{image}" for image in IMAGE_TOPICS]
    names = {topic.removesuffix(end).strip("/") for topic in topics for end in endings if topic.endswith(end)}
    return tuple(sorted(names))
