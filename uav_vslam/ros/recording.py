# SPDX-License-Identifier: Apache-2.0
"""The messages of a fleet's bags that are replayed, as serialised bytes."""

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from uav_vslam.config import InputConfig
from uav_vslam.config.input import image_names
from uav_vslam.config.nodes import NODES
from uav_vslam.datasets.bag import unmoved_edges
from uav_vslam.datasets.bag import vehicles as vehicles_of
from uav_vslam.datasets.cdr import RawMessage, decode, encode
from uav_vslam.datasets.frame_tree import TF, TF_STATIC
from uav_vslam.datasets.message_builders import transforms_message
from uav_vslam.datasets.messages import header_stamp_ns
from uav_vslam.datasets.rosbag import TopicInfo, UpToDamage, iter_raw, iter_readable, names_of, topics_of
from uav_vslam.datasets.sensor_setup import SensorSetup
from uav_vslam.datasets.united_imu import united
from uav_vslam.errors import BagError
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.ros.recorded import FRAME_PARTS, FrameShape, Kind, Recorded
from uav_vslam.types import NS_PER_S

TF_TYPE = "tf2_msgs/msg/TFMessage"
INITIAL_STATE = "initial_state"
KINDS = {"left": Kind.LEFT, "right": Kind.RIGHT, "left_info": Kind.INFO, "imu": Kind.IMU}  # by role
LEAST_BYTES = 4  # of a serialised message
# Outputs of the nodes: not replayed from the recording of a whole run.
OUTPUTS = ("odometry", "path", "landmarks", "stereo_features", "joint_information", "landmark_information")
OUTPUT_FOLDERS = ("ins/", "slam/", "fused/", "map/", "received/", *(f"{node}/" for node in NODES))


class Recording:
    """The bags of a fleet.

    Attributes:
        vehicles: names, in the order requested.
        topics: those replayed, by name.
        starts_ns: stamp of each vehicle's start state [ns]; absent if none is replayed.
        damage: errors of damaged bags; of `messages`, once it is read.
        left_out: messages that can't be read, by topic, so far.
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
            inputs: settings by vehicle; the defaults for those that are absent.

        Raises:
            CalibrationError: a calibration file can't be read.
            BagError: a bag is missing, unreadable, or lacks a topic that a vehicle needs.
        """
        if not paths:
            raise BagError("no recording to replay; set the parameter bags (uav-vslam launch: --bag)")
        self._paths, known = tuple(paths), topics_of(paths)
        self._finding_start = frozenset(finding_start)
        inputs = dict(inputs or {})
        self.vehicles = tuple(vehicles) or tuple(inputs) or tuple(vehicles_of(paths))
        if not self.vehicles:
            none = "no <vehicle>/left/image_raw to replay; name other topics by the parameter inputs"
            raise BagError(f"{names_of(paths)}: {none}")
        self._setups = {name: SensorSetup.of(name, inputs.get(name, InputConfig())) for name in self.vehicles}
        self._gyro_topics = {  # by the accelerometer's, whose readings the gyroscope's messages get
            accel: gyro
            for vehicle, setup in self._setups.items()
            for accel, gyro in setup.config.gyro_topics(vehicle).items()
        }
        self._roles = {topic: (vehicle, role) for vehicle in self.vehicles for role, topic in self._named(vehicle)}
        self.topics = {topic: info for topic, info in known.items() if self._is_input(topic)}
        self.damage: list[str] = []
        self.left_out: Counter[str] = Counter()
        for vehicle in self.vehicles:
            self._require(vehicle, known)
        self.latched = self._read_latched()
        if TF in known and TF_STATIC not in known:
            self._borrow_frames()
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
        roles = ["left", "right", "imu"] + (["left_info", "right_info"] if self._setups[vehicle].needs_infos else [])
        return [
            t for t, (owner, role) in self._roles.items() if owner == vehicle and role in roles and t in self.topics
        ]

    def frame_shape(self, vehicle: str) -> FrameShape:
        """Return what makes a frame: images that the front end pairs, and a camera_info unless files replace it."""
        setup = self._setups[vehicle]
        with_info = setup.needs_infos and self._count(vehicle, Kind.INFO) > 0
        return FrameShape(
            parts=FRAME_PARTS if with_info else FRAME_PARTS - {Kind.INFO},
            tolerance_ns=round(setup.config.pair_tolerance_s * NS_PER_S),
            offset_ns=setup.time_offset_ns,
        )

    def messages(self) -> Iterator[Recorded]:
        """Yield all but the latched messages in recorded order, as far as they can be read.

        What paces the replay has the stamp of its header, and all else that of the last such message: the clock of the
        recorder may be another one.
        """
        latched = {raw.topic for raw in self.latched}
        topics = [topic for topic in self.topics if topic not in latched]
        streams = [UpToDamage(iter_raw([path], [*topics, *self._gyro_topics])) for path in self._paths]
        newest_ns: int | None = None
        for raw in united(heapq.merge(*streams, key=lambda raw: raw.stamp_ns), self._gyro_topics):
            vehicle, kind = self.classify(raw.topic)
            if not (_is_valid(raw) if kind is not Kind.OTHER else len(raw.data) >= LEAST_BYTES):  # no node answers it
                self.left_out[raw.topic] += 1
                continue
            if kind is not Kind.OTHER:
                newest_ns = header_stamp_ns(raw.data)
            stamp_ns = raw.stamp_ns if newest_ns is None else newest_ns
            yield Recorded(raw.topic, vehicle, kind, stamp_ns, raw.data)
        self.damage = [str(stream.error) for stream in streams if stream.error]

    def _read_latched(self) -> list[RawMessage]:
        topics = [topic for topic, info in self.topics.items() if info.latched or self._is_latched(topic)]
        newest: dict[tuple[Path, str, bytes], RawMessage] = {}
        for path in self._paths:
            for raw in iter_readable([path], topics):
                if self._is_latched(raw.topic) and not _is_valid(raw):
                    self.left_out[raw.topic] += 1
                    continue
                # Several nodes may each publish a part of /tf_static.
                newest[path, raw.topic, raw.data if raw.topic == TF_STATIC else b""] = raw
        return list(newest.values())

    def _borrow_frames(self) -> None:
        """Replay as /tf_static what of /tf never moves: the nodes read the former alone."""
        if edges := unmoved_edges(self._paths):
            self.topics[TF_STATIC] = TopicInfo(TF_TYPE, 1, latched=True)
            self.latched.append(RawMessage(TF_STATIC, TF_TYPE, 0, encode(transforms_message(0, edges))))

    def topic(self, vehicle: str, role: str) -> str:
        """Return the name of a vehicle's input; `role` is a key of `input.topics`."""
        return self._setups[vehicle].config.topic(vehicle, role)

    def _named(self, vehicle: str) -> Iterator[tuple[str, str]]:
        """Yield role and topic of a vehicle's inputs; images under both names."""
        for role in (*KINDS, "right_info", INITIAL_STATE):
            topic = self.topic(vehicle, role)
            yield from ((role, name) for name in (image_names(topic) if role in SIDES else (topic,)))

    def _is_input(self, topic: str) -> bool:
        vehicle, _ = self.classify(topic)
        if topic in self._gyro_topics:
            return False
        if topic in self._roles:
            return self._roles[topic][1] != INITIAL_STATE or vehicle not in self._finding_start
        name = topic.removeprefix(f"/{vehicle}/")
        return topic == TF_STATIC or (vehicle != "" and name not in OUTPUTS and not name.startswith(OUTPUT_FOLDERS))

    def _is_latched(self, topic: str) -> bool:
        """Return whether late subscribers need the topic, however it was recorded."""
        return topic == TF_STATIC or self._roles.get(topic, ("", ""))[1] == INITIAL_STATE

    def _count(self, vehicle: str, kind: Kind) -> int:
        counts = [info.count for topic, info in self.topics.items() if self.classify(topic) == (vehicle, kind)]
        return max(counts, default=0)

    def _require(self, vehicle: str, known: Mapping[str, TopicInfo]) -> None:
        bags = ", ".join(map(str, self._paths))
        recorded = {self.classify(topic) for topic in self.topics}
        for kind in (Kind.LEFT, Kind.RIGHT, Kind.IMU):
            if (vehicle, kind) not in recorded:
                names = " or ".join(t for t in self._roles if self.classify(t) == (vehicle, kind))
                held = ", ".join(vehicles_of(self._paths)) or "none"
                raise BagError(f"{bags}: no {names} for vehicle {vehicle}; vehicles recorded: {held}")
        for accel in self._setups[vehicle].config.gyro_topics(vehicle):
            if accel not in known:
                raise BagError(f"{bags}: no {accel} for vehicle {vehicle}; correct input.topics.accel")
        infos, images = self._count(vehicle, Kind.INFO), self.frames(vehicle)
        if self._setups[vehicle].needs_infos and infos and 2 * infos < images:
            raise BagError(
                f"{bags}: {infos} messages on {self.topic(vehicle, 'left_info')} for {images} left images; the nodes "
                "need one with each image, of the same stamp (uav-vslam run does not), or none and input.calibration"
            )


def _is_valid(raw: RawMessage) -> bool:
    try:
        decode(raw)
    except BagError:
        return False
    return True
