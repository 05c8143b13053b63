# SPDX-License-Identifier: Apache-2.0
"""replay: the fleet's recordings as live topics under one clock.

in   /<vehicle>/<each of wait_for>    nav_msgs/Odometry, answers to a frame by its stamp; they pace lock-step (rate 0)
     /<vehicle>/ins/odometry          nav_msgs/Odometry, acknowledges IMU samples
     /<vehicle>/initial_state, stereo_features    if no start state is replayed: estimated by the vehicle itself
out  /<vehicle>/...                   the recorded inputs, byte for byte
     /<vehicle>/initial_state         uav_vslam_msgs/NavigationState, latched, published first
     /tf_static                       tf2_msgs/TFMessage, latched, merged over all bags
     /clock                           rosgraph_msgs/Clock

Exit code 0 at the end; 1 if a consumer or an answer is missing, or a vehicle processed no frame; 2 if a bag can't be
replayed, or only up to its damage.
"""

import time
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock as ClockMsg
from tf2_msgs.msg import TFMessage

from uav_vslam.config import InputConfig
from uav_vslam.config.nodes import ReplayNodeConfig
from uav_vslam.config.settings import build
from uav_vslam.datasets.frame_tree import TF_STATIC
from uav_vslam.datasets.messages import header_stamp_ns
from uav_vslam.errors import ConfigError, InvalidYaml
from uav_vslam.ros.answers import EARLY_ANSWER, IMU_AHEAD, Answers, Readings
from uav_vslam.ros.batches import Batches, take_waiting
from uav_vslam.ros.convert import stamp_from_ns
from uav_vslam.ros.message_types import type_named
from uav_vslam.ros.pacing import STEP_AHEAD_NS, LockStep, Pacer, RealTime, step_s
from uav_vslam.ros.params import declare, read
from uav_vslam.ros.qos import IMAGE, LATCHED, RESUMABLE, SENSOR, STATE
from uav_vslam.ros.readiness import Readiness
from uav_vslam.ros.recorded import Kind, Recorded
from uav_vslam.ros.recording import INITIAL_STATE, Recording
from uav_vslam.ros.runtime import run_node
from uav_vslam.ros.timers import create_wall_timer
from uav_vslam.yaml_text import parse_yaml
from uav_vslam_msgs.msg import NavigationState, StereoFeatures

INS_ANSWER = "ins/odometry"
QOS = {Kind.LEFT: IMAGE, Kind.RIGHT: IMAGE, Kind.IMU: SENSOR}
LOOK_S = 0.05  # period of looks at the graph: the nodes that it waits for need the processor to start
ANSWERS_S = 0.1  # real time: period of taking the answers, which nothing waits for
BURST = 50  # messages published before callbacks run again
DISCOVERY_S = 15.0  # timeout of the discovery among the nodes
LAST_ANSWERS_S = 3.0  # real time: timeout of the last answers
REPORT_S = 3.0
LISTED = 6  # missing endpoints named while waiting; all of them at the timeout
CLOCK_NS = 20_000_000


class ReplayNode(Node):
    """Publishes what a `Pacer` releases. The replay is one generator; a timer and, in lock-step, answers resume it."""

    def __init__(self) -> None:
        super().__init__("replay")
        self._config = read(self, ReplayNodeConfig)
        declare(self, self._config)
        self._wait_for = self._config.wait_for
        self._recording = Recording(
            self._config.bags,
            self._config.vehicles,
            finding_start=self._config.finding_start,
            inputs=_inputs(self._config.inputs),
        )
        self._vehicles, self._starts_ns = self._recording.vehicles, dict(self._recording.starts_ns)
        shapes = {name: self._recording.frame_shape(name) for name in self._vehicles}
        self._answers = Answers(self._vehicles, self._starts_ns, self._wait_for, shapes)
        self._readings = Readings(self._vehicles, self._starts_ns, IMU_AHEAD if self._wait_for else None)
        self._progress_s = self._begin_s = time.monotonic()
        self._clock_ns = -CLOCK_NS
        self._stamps_ns: dict[str, int] = {}  # of each vehicle's last message
        self._publishers_by_topic = {topic: self._advertise(topic) for topic in self._recording.topics}
        self._clock_publisher = self.create_publisher(ClockMsg, "/clock", STATE)
        self._answer_inputs: list[Any] = []
        for vehicle in self._vehicles:
            self._subscribe_to(vehicle)
        self._readiness = Readiness(self, self._vehicles)
        self._steps = self._replay()
        create_wall_timer(self, step_s(self._config.rate), self._step)
        if not self._lockstep:
            create_wall_timer(self, ANSWERS_S, self._take_answers)

    @property
    def _lockstep(self) -> bool:
        return self._config.rate == 0

    def _advertise(self, topic: str) -> Publisher:
        message_type = type_named(self._recording.topics[topic].msgtype, topic=topic)
        _, kind = self._recording.classify(topic)
        latched = any(raw.topic == topic for raw in self._recording.latched)
        return self.create_publisher(message_type, topic, LATCHED if latched else QOS.get(kind, STATE))

    def _subscribe_to(self, vehicle: str) -> None:
        topics: dict[str, Any] = dict.fromkeys([*self._wait_for, INS_ANSWER], Odometry)
        if vehicle not in self._starts_ns:  # the vehicle estimates its start state
            topics[EARLY_ANSWER] = StereoFeatures
            self.create_subscription(
                NavigationState,
                self._recording.topic(vehicle, INITIAL_STATE),
                partial(self._on_start, vehicle),
                LATCHED,
                raw=True,
            )
        group = Batches(at_once=self._lockstep)
        for topic, kind in topics.items():
            answer = partial(self._on_answer, vehicle, topic)
            qos = RESUMABLE if topic in self._wait_for else SENSOR  # a restarted node may answer before it is found
            self._answer_inputs.append(
                self.create_subscription(kind, f"/{vehicle}/{topic}", answer, qos, raw=True, callback_group=group)
            )

    def _take_answers(self) -> None:
        for one in self._answer_inputs:
            take_waiting(one)

    def _on_start(self, vehicle: str, data: bytes) -> None:
        self._starts_ns.setdefault(vehicle, header_stamp_ns(data))

    def _on_answer(self, vehicle: str, topic: str, data: bytes) -> None:
        stamp_ns = header_stamp_ns(data)
        if topic == INS_ANSWER:
            self._readings.answered(vehicle, stamp_ns)
        self._answers.answered(vehicle, topic, stamp_ns)
        self._progress_s = time.monotonic()
        if self._lockstep:
            self._step()

    def _publish_latched(self) -> None:
        """Publish latched messages; /tf_static of all bags as one, since late joiners get the last message only."""
        merged = TFMessage()
        for raw in self._recording.latched:
            if raw.topic == TF_STATIC:
                merged.transforms += deserialize_message(raw.data, TFMessage).transforms
            else:
                self._publishers_by_topic[raw.topic].publish(raw.data)
        if merged.transforms:
            self._publishers_by_topic[TF_STATIC].publish(merged)

    def _step(self) -> None:
        """Continue until the replay has to wait."""
        for _ in range(BURST):
            if not next(self._steps):
                return

    def _replay(self) -> Iterator[bool]:
        """The whole replay; yields False where it has to wait, True after each message."""
        yield from self._await_endpoints()
        self._publish_latched()
        self._begin_s = self._report_s = self._progress_s = time.monotonic()
        for message in self._pacer().order(self._recording.messages()):
            if message is None:
                self._check_timeout()
            else:
                self._publish(message)
            self._report()
            yield message is not None
        yield from self._await_last_answers()
        self._finish()

    def _pacer(self) -> Pacer:
        return LockStep(self._answers, self._readings) if self._lockstep else RealTime(self._answers, self._config.rate)

    def _await_endpoints(self) -> Iterator[bool]:
        """Wait until every topic has a subscriber and every answer a publisher."""
        while missing := self._missing_endpoints():
            if time.monotonic() - self._begin_s > self._config.timeout_s:
                text = ", ".join(missing)
                self._fail(f"gave up after {self._config.timeout_s:g} s: {text}; are the vehicle's nodes running?")
            more = f" and {len(missing) - LISTED} more" if len(missing) > LISTED else ""
            self.get_logger().info(f"waiting: {', '.join(missing[:LISTED])}{more}", throttle_duration_sec=REPORT_S)
            yield from _pause()
        yield from self._await_discovery()

    def _await_discovery(self) -> Iterator[bool]:
        """Wait until the nodes have discovered each other: the first frame passes through all of them."""
        give_up_s = time.monotonic() + DISCOVERY_S
        while missing := self._readiness.missing():
            if time.monotonic() > give_up_s:
                self.get_logger().warning(f"starting before discovery is complete: {', '.join(missing)}")
                return
            yield from _pause()

    def _missing_endpoints(self) -> list[str]:
        answers = [f"/{vehicle}/{topic}" for vehicle in self._vehicles for topic in self._wait_for]
        consumed = [topic for vehicle in self._vehicles for topic in self._recording.consumed(vehicle)]
        unread = [t for t in consumed if self._publishers_by_topic[t].get_subscription_count() == 0]
        unwritten = [t for t in answers if self.count_publishers(t) == 0]
        return [f"{t} has no subscriber" for t in unread] + [f"{t} has no publisher" for t in unwritten]

    def _publish(self, message: Recorded) -> None:
        if message.kind is not Kind.OTHER:
            self._advance_clock(message.vehicle, message.stamp_ns)
        self._publishers_by_topic[message.topic].publish(message.payload)
        self._progress_s = time.monotonic()

    def _advance_clock(self, vehicle: str, stamp_ns: int) -> None:
        """Publish the time; a jump ahead counts with the second stamp that shows it, for one alone may be wrong."""
        before_ns = self._stamps_ns.get(vehicle, stamp_ns)
        self._stamps_ns[vehicle] = stamp_ns
        if stamp_ns - before_ns <= STEP_AHEAD_NS and stamp_ns - self._clock_ns >= CLOCK_NS:
            self._clock_ns = stamp_ns
            self._clock_publisher.publish(ClockMsg(clock=stamp_from_ns(stamp_ns)))

    def _check_timeout(self) -> None:
        if self._lockstep and time.monotonic() - self._progress_s > self._config.timeout_s:
            behind = [(f"/{vehicle}/{INS_ANSWER}", stamp_ns) for vehicle, stamp_ns in self._readings.backlog()]
            missing = ", ".join(f"{topic} at {stamp_ns} ns" for topic, stamp_ns in self._answers.missing() + behind)
            self._fail(f"no answer for {self._config.timeout_s:g} s: {missing}")

    def _await_last_answers(self) -> Iterator[bool]:
        while self._answers.open() and time.monotonic() - self._progress_s < LAST_ANSWERS_S:
            yield False

    def _report(self) -> None:
        if time.monotonic() - self._report_s >= REPORT_S:
            self._report_s = time.monotonic()
            self.get_logger().info(self._summary())

    def _summary(self) -> str:
        counts = [f"{name} {count}/{self._recording.frames(name)}" for name, count in self._answers.frames.items()]
        return f"frames replayed: {', '.join(counts)} in {time.monotonic() - self._begin_s:.1f} s"

    def _finish(self) -> None:
        self.get_logger().info(self._summary())
        if unanswered := Counter(vehicle for vehicle, _ in self._answers.open()):
            counts = ", ".join(f"{name} {count}" for name, count in unanswered.items())
            self.get_logger().warning(
                f"frames that were not answered: {counts}; the graph is slower than the replay, or a node has stopped"
            )
        idle = [name for name, count in self._answers.processed.items() if self._wait_for and count == 0]
        if idle:
            self.get_logger().error(f"{', '.join(idle)} processed no frame; the warnings of its nodes say why")
        if left_out := self._recording.left_out:
            counts = ", ".join(f"{topic} {count}" for topic, count in left_out.items())
            self.get_logger().warning(f"messages that can't be read were left out: {counts}")
        for text in self._recording.damage:
            self.get_logger().error(text)
        raise SystemExit(2 if self._recording.damage else 1 if idle else 0)

    def _fail(self, text: str) -> None:
        self.get_logger().error(text)
        raise SystemExit(1)


def _pause() -> Iterator[bool]:
    """Wait until the next look at the graph."""
    end_s = time.monotonic() + LOOK_S
    while time.monotonic() < end_s:
        yield False


def _inputs(entries: Iterable[str]) -> dict[str, InputConfig]:
    """Return the settings of each vehicle's input from entries VEHICLE:KEY:=VALUE.

    Raises:
        ConfigError: an entry has another form, or a key or value is wrong.
    """
    values: dict[str, dict[str, Any]] = {}
    for entry in entries:
        name, found, value = entry.partition(":=")
        vehicle, _, key = name.partition(":")
        if not (vehicle and key and found):
            raise ConfigError(f"inputs: {entry!r} is not of the form VEHICLE:KEY:=VALUE")
        try:
            values.setdefault(vehicle, {})[key] = parse_yaml(value)
        except InvalidYaml as error:
            remedy = "quote it, or close its brackets"
            raise ConfigError(f"inputs: the value of {entry!r} is not YAML: {error}; {remedy}") from None
    return {vehicle: build(InputConfig, own, where=f"inputs of {vehicle}") for vehicle, own in values.items()}


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(ReplayNode, args, shared_memory=True)


if __name__ == "__main__":
    raise SystemExit(main())
