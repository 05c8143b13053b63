# SPDX-License-Identifier: Apache-2.0
"""The replay and the recorder as processes, between a written bag and a vehicle that only answers."""

import contextlib
import dataclasses
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from ros1_frames import repeated_on_tf

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image, Imu  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from uav_vslam.datasets.bag_recorder import RawRecorder  # noqa: E402
from uav_vslam.datasets.cdr import RawMessage, decode, encode  # noqa: E402
from uav_vslam.datasets.flight_writer import FlightRecording, write_flights  # noqa: E402
from uav_vslam.datasets.messages import transforms_of  # noqa: E402
from uav_vslam.datasets.rosbag import iter_raw, topics_of  # noqa: E402
from uav_vslam.errors import BagError  # noqa: E402
from uav_vslam.geometry.camera import PinholeCamera  # noqa: E402
from uav_vslam.geometry.pose import Pose  # noqa: E402
from uav_vslam.geometry.stereo import StereoRig  # noqa: E402
from uav_vslam.ros.qos import IMAGE, LATCHED, NEWEST, SENSOR, STATE  # noqa: E402
from uav_vslam.ros.readiness import DISCOVERY  # noqa: E402
from uav_vslam.ros.recording import Recording  # noqa: E402
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, NavState, StereoFrame  # noqa: E402
from uav_vslam_msgs.msg import NavigationState  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros

START_NS, FRAME_NS, IMU_NS = 5_000_000_000, 100_000_000, 10_000_000
FRAMES, FRAMES_BEFORE_START = 12, 2
SIZE = 16


def flight(vehicle: str) -> FlightRecording:
    """A second of a vehicle at rest, with two frames before its start state."""
    camera = PinholeCamera(SIZE, SIZE, 10.0, 10.0, 8.0, 8.0, np.zeros(5))
    rig = StereoRig(camera, camera, Pose.identity(), Pose(np.eye(3), np.array([0.1, 0.0, 0.0])))
    first = START_NS - FRAMES_BEFORE_START * FRAME_NS
    image = np.zeros((SIZE, SIZE), np.uint8)
    stamps = range(first, first + FRAMES * FRAME_NS, FRAME_NS)
    start = NavState(START_NS, Pose.identity(), np.zeros(3), np.zeros(3), np.zeros(3))
    readings = range(first, stamps[-1] + FRAME_NS, IMU_NS)
    return FlightRecording(
        vehicle=vehicle,
        rig=rig,
        imu=[ImuSample(stamp, np.zeros(3), np.array([0.0, 0.0, 9.8])) for stamp in readings],
        truth=[],
        frames=[StereoFrame(stamp, image, image) for stamp in stamps],
        initial=NavEstimate(start, np.eye(15)),
    )


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    for vehicle in ("uav1", "uav2"):
        write_flights(folder / vehicle, [flight(vehicle)])
    return [folder / "uav1", folder / "uav2"]


class Vehicle:
    """Subscribes to a vehicle's inputs and answers as its nodes do."""

    def __init__(self, node, name: str, answers: Callable[[int], bool]) -> None:
        self.readings: list[int] = []
        self.frames: dict[int, set[str]] = {}
        self.starts: list[int] = []
        self.early: list[int] = []
        self.answered: set[int] = set()
        self._answers = answers
        self._publishers = [
            node.create_publisher(Odometry, f"/{name}/{t}", NEWEST) for t in ("odometry", "fused/odometry")
        ]
        self._ins = node.create_publisher(Odometry, f"/{name}/ins/odometry", STATE)
        node.create_subscription(NavigationState, f"/{name}/initial_state", self._on_start, LATCHED)
        node.create_subscription(Imu, f"/{name}/imu/data_raw", self._on_imu, SENSOR)
        for side in ("left", "right"):
            for topic, kind, qos in (("image_raw", Image, IMAGE), ("camera_info", CameraInfo, STATE)):
                what = f"{side} {topic}"
                node.create_subscription(
                    kind, f"/{name}/{side}/{topic}", lambda m, what=what: self._on_part(what, m), qos
                )

    def _on_start(self, message: NavigationState) -> None:
        self.starts.append(ns(message))

    def _on_imu(self, message: Imu) -> None:
        self.readings.append(ns(message))
        self._ins.publish(Odometry(header=message.header))
        self._answer()

    def _on_part(self, what: str, message: Image | CameraInfo) -> None:
        open_frames = [
            s for s, parts in self.frames.items() if s >= START_NS and len(parts) == 4 and s not in self.answered
        ]
        self.early += [stamp for stamp in open_frames if stamp != ns(message)]
        self.frames.setdefault(ns(message), set()).add(what)
        self._answer()

    def _answer(self) -> None:
        for stamp_ns, parts in self.frames.items():
            covered = bool(self.readings) and self.readings[-1] >= stamp_ns
            if stamp_ns not in self.answered and stamp_ns >= START_NS and len(parts) == 4 and covered:
                if not self._answers(stamp_ns):
                    continue
                self.answered.add(stamp_ns)
                message = Odometry()
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
                for publisher in self._publishers:
                    publisher.publish(message)


class Fleet:
    """Two such vehicles on a ROS domain of their own, spun in a thread."""

    def __init__(self, domain_id: int) -> None:
        self.domain_id = domain_id
        self.answers: Callable[[int], bool] = lambda stamp_ns: True
        self.clock: list[int] = []
        self.static: list[TFMessage] = []
        self.recorder: dict[str, str] = {}
        self._context = rclpy.Context()
        self._context.init(domain_id=self.domain_id)
        self.node = rclpy.create_node("fleet", context=self._context)
        self.vehicles = {name: Vehicle(self.node, name, lambda s: self.answers(s)) for name in ("uav1", "uav2")}
        self.node.create_subscription(Clock, "/clock", lambda m: self.clock.append(m.clock.sec), STATE)
        self.node.create_subscription(TFMessage, "/tf_static", self.static.append, LATCHED)
        for topic in ("/diagnostics", DISCOVERY):
            self.node.create_subscription(DiagnosticArray, topic, self._on_status, 10)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _on_status(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "fleet: recorder":
                self.recorder |= {entry.key: entry.value for entry in status.values}

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def replay(self, bags: list[Path], **parameters: str) -> subprocess.CompletedProcess[str]:
        arguments = [f"bags:=[{', '.join(map(str, bags))}]", *(f"{key}:={value}" for key, value in parameters.items())]
        return run_node("replay", arguments, self.domain_id)

    def close(self) -> None:
        self._context.try_shutdown()
        self._thread.join()
        self.node.destroy_node()


def ns(message) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def node_command(name: str, parameters: list[str]) -> list[str]:
    pairs = [argument for parameter in parameters for argument in ("-p", parameter)]
    return [sys.executable, "-m", f"uav_vslam.ros.{name}_node", "--ros-args", *pairs]


def run_node(name: str, parameters: list[str], domain_id: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run(node_command(name, parameters), env=environment(domain_id), capture_output=True, text=True)


def environment(domain_id: int) -> dict[str, str]:
    return os.environ | {"ROS_DOMAIN_ID": str(domain_id)}


@pytest.fixture
def fleet(domain_id: int) -> Iterator[Fleet]:
    started = Fleet(domain_id)
    yield started
    started.close()


def test_lock_step_delivers_everything_once_and_each_frame_after_the_last_answer(
    fleet: Fleet, bags: list[Path]
) -> None:
    done = fleet.replay(bags)
    assert done.returncode == 0, done.stderr
    for vehicle in fleet.vehicles.values():
        assert len(vehicle.frames) == FRAMES
        assert all(len(parts) == 4 for parts in vehicle.frames.values())
        assert len(vehicle.answered) == FRAMES - FRAMES_BEFORE_START
        assert len(vehicle.readings) == FRAMES * FRAME_NS // IMU_NS
        assert vehicle.starts == [START_NS]
        assert vehicle.early == []
    assert fleet.clock[-1] == 5


def test_a_recorded_start_state_is_not_replayed_to_a_vehicle_that_estimates_its_own(bags: list[Path]) -> None:
    recording = Recording(bags, finding_start=["uav2"])
    assert recording.starts_ns == {"uav1": START_NS}
    assert "/uav1/initial_state" in recording.topics
    assert "/uav2/initial_state" not in recording.topics
    assert {raw.topic for raw in recording.latched} == {"/uav1/initial_state", "/tf_static"}


@pytest.mark.parametrize(
    "name", ["odometry", "slam/quality", "fused/odometry", "map/surface", "received/uav2", "mapper/transition_event"]
)
def test_what_the_nodes_publish_is_not_replayed(name: str, bags: list[Path], tmp_path: Path) -> None:
    with RawRecorder(tmp_path / "all") as out:
        for raw in iter_raw([bags[0]]):
            out.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
        out.write(f"/uav1/{name}", raw.msgtype, raw.data, raw.stamp_ns)
    assert Recording([tmp_path / "all"]).topics.keys() == Recording([bags[0]]).topics.keys()


def test_the_static_transforms_of_all_bags_are_one_message(fleet: Fleet, bags: list[Path]) -> None:
    fleet.replay(bags)
    children = [transform.child_frame_id for transform in fleet.static[-1].transforms]
    assert sorted(children) == [f"{name}/{side}_optical" for name in ("uav1", "uav2") for side in ("left", "right")]


def rewritten(source: Path, out: Path, keep: Callable[[RawMessage], list[bytes]]) -> Path:
    with RawRecorder(out) as recorder:
        for raw in iter_raw([source]):
            for data in keep(raw):
                latched = raw.topic in {"/tf_static", "/uav1/initial_state"}
                recorder.write(raw.topic, raw.msgtype, data, raw.stamp_ns, latched=latched)
    return out


def test_one_wrong_stamp_does_not_set_the_clock(fleet: Fleet, bags: list[Path], tmp_path: Path) -> None:
    """It would stand still until the recording has caught up."""
    wrong = [raw for raw in iter_raw([bags[0]]) if raw.topic == "/uav1/imu/data_raw"][50]

    def ahead(raw: RawMessage) -> list[bytes]:
        if raw != wrong:
            return [raw.data]
        message = decode(raw)
        message.header.stamp.sec += 1000
        return [encode(message)]

    done = fleet.replay([rewritten(bags[0], tmp_path / "ahead", ahead)])
    assert done.returncode == 0, done.stderr
    assert len(fleet.vehicles["uav1"].readings) == FRAMES * FRAME_NS // IMU_NS
    assert max(fleet.clock) == 5


def test_what_the_recorder_s_clock_stamped_comes_with_the_inputs_around_it(bags: list[Path], tmp_path: Path) -> None:
    away_ns = 300_000_000 * NS_PER_S
    with RawRecorder(tmp_path / "other_clock") as recorder:
        for raw in iter_raw([bags[0]]):
            latched = raw.topic in {"/tf_static", "/uav1/initial_state"}
            recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns + away_ns, latched=latched)
    stamps, others = (
        [(message.topic, message.stamp_ns) for message in Recording([path]).messages()]
        for path in (bags[0], tmp_path / "other_clock")
    )
    assert others == stamps
    assert "/uav1/right/camera_info" in dict(stamps)


@pytest.mark.parametrize("size", [0, 1, 11, 40])
@pytest.mark.parametrize("topic", ["imu/data_raw", "left/image_raw", "left/camera_info"])
def test_a_message_that_can_not_be_read_costs_itself(topic: str, size: int, bags: list[Path], tmp_path: Path) -> None:
    """A node would not answer it, and its frame would be waited for in vain."""
    cut = [raw for raw in iter_raw([bags[0]]) if raw.topic == f"/uav1/{topic}"][5]

    def truncated(raw: RawMessage) -> list[bytes]:
        return [raw.data[:size] if raw == cut else raw.data]

    recording = Recording([rewritten(bags[0], tmp_path / "cut", truncated)])
    replayed = [(one.topic, one.payload) for one in recording.messages()]
    expected = [(one.topic, one.payload) for one in Recording([bags[0]]).messages()]
    assert replayed == [one for one in expected if one != (cut.topic, cut.data)] != expected
    assert recording.left_out == {cut.topic: 1}
    assert recording.damage == []


def test_latched_messages_that_can_not_be_read_are_left_out(bags: list[Path], tmp_path: Path) -> None:
    def twice(raw: RawMessage) -> list[bytes]:
        return [raw.data, raw.data[:7]] if raw.topic in {"/tf_static", "/uav1/initial_state"} else [raw.data]

    recording = Recording([rewritten(bags[0], tmp_path / "cut", twice)])
    assert recording.starts_ns == {"uav1": START_NS}
    assert [raw.data for raw in recording.latched] == [raw.data for raw in Recording([bags[0]]).latched]
    assert recording.left_out == {"/tf_static": 1, "/uav1/initial_state": 1}


def test_separately_recorded_static_transforms_are_all_kept(bags: list[Path], tmp_path: Path) -> None:
    def one_by_one(raw: RawMessage) -> list[bytes]:
        if raw.topic != "/tf_static":
            return [raw.data]
        whole = decode(raw)
        return [encode(dataclasses.replace(whole, transforms=[transform])) for transform in whole.transforms]

    parts = Recording([rewritten(bags[0], tmp_path / "parts", one_by_one)]).latched
    assert [raw.topic for raw in parts].count("/tf_static") == 2


def test_a_recording_without_images_is_refused(bags: list[Path], tmp_path: Path) -> None:
    """As the recorder's bags are, of which a replay would end at once with exit code 0."""
    outputs = rewritten(bags[0], tmp_path / "outputs", lambda raw: [] if "image_raw" in raw.topic else [raw.data])
    with pytest.raises(BagError, match="outputs: no <vehicle>/left/image_raw to replay"):
        Recording([outputs])


def test_a_recording_with_too_few_camera_infos_is_refused(bags: list[Path], tmp_path: Path) -> None:
    seen: list[RawMessage] = []

    def first_only(raw: RawMessage) -> list[bytes]:
        seen.extend([raw] if raw.topic == "/uav1/left/camera_info" else [])
        return [raw.data] if raw.topic != "/uav1/left/camera_info" or len(seen) == 1 else []

    with pytest.raises(BagError, match=f"1 messages on /uav1/left/camera_info for {FRAMES} left images"):
        Recording([rewritten(bags[0], tmp_path / "few", first_only)])


def test_a_vehicle_that_stops_answering_is_named_with_topic_and_stamp(fleet: Fleet, bags: list[Path]) -> None:
    fleet.answers = lambda stamp_ns: stamp_ns < START_NS + 3 * FRAME_NS
    done = fleet.replay(bags, timeout_s="6.0")
    assert done.returncode == 1
    assert f"/uav1/odometry at {START_NS + 3 * FRAME_NS} ns" in done.stderr


def test_real_time_has_no_back_pressure_and_fails_if_a_vehicle_does_nothing(fleet: Fleet, bags: list[Path]) -> None:
    fleet.answers = lambda stamp_ns: False
    begin_s = time.monotonic()
    done = fleet.replay(bags, rate="2.0")
    assert done.returncode == 1, done.stderr
    assert "uav1, uav2 processed no frame" in done.stderr
    assert time.monotonic() - begin_s > FRAMES * FRAME_NS / 2e9
    assert re.search(r"frames that were not answered: uav1 \d+, uav2 \d+; ", done.stderr)
    assert all(len(vehicle.frames) == FRAMES for vehicle in fleet.vehicles.values())


def test_a_truncated_bag_is_replayed_up_to_the_damage_and_fails(fleet: Fleet, bags: list[Path], tmp_path: Path) -> None:
    cut = tmp_path / "cut"
    cut.mkdir()
    (source,) = bags[0].glob("*.mcap")
    data = source.read_bytes()
    (cut / source.name).write_bytes(data[: len(data) * 7 // 10])
    done = fleet.replay([cut, bags[1]])
    assert done.returncode == 2
    assert "is damaged" in done.stderr
    assert len(fleet.vehicles["uav2"].frames) == FRAMES


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        (["bags:=[nowhere]"], "nowhere"),
        ([], "bags"),
        (["bags:=[BAG]", "vehicles:=[ghost]"], "vehicle ghost"),
        (["bags:=[BAG]", "inputs:=['uav1:topics.left:=[']"], "the value of 'uav1:topics.left:=[' is not YAML"),
    ],
)
def test_an_invalid_recording_is_one_line_and_exit_code_2(
    bags: list[Path], domain_id: int, parameters: list[str], said: str
) -> None:
    given = [parameter.replace("BAG", str(bags[0])) for parameter in parameters]
    done = run_node("replay", given, domain_id)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 1


def test_without_subscribers_it_times_out_and_lists_the_topics(bags: list[Path], domain_id: int) -> None:
    done = run_node("replay", [f"bags:=[{bags[0]}]", "timeout_s:=1.0"], domain_id)
    assert done.returncode == 1
    assert "/uav1/imu/data_raw has no subscriber" in done.stderr
    assert "/uav1/fused/odometry has no publisher" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_recorder_completes_its_bag_at_a_signal(
    fleet: Fleet, bags: list[Path], tmp_path: Path, number: signal.Signals
) -> None:
    out = tmp_path / "out"
    command = node_command("recorder", [f"output:={out}", "vehicles:=[uav1, uav2]"])
    recorder = subprocess.Popen(command, env=environment(fleet.domain_id), stderr=subprocess.PIPE, text=True)
    try:
        assert recorder.stderr is not None
        assert "recording to" in recorder.stderr.readline()
        answers = {f"/{name}/{topic}" for name in fleet.vehicles for topic in ("odometry", "fused/odometry")}
        assert wait_for(
            lambda: (
                {"unmatched", "written"} <= fleet.recorder.keys()
                and not answers & set(fleet.recorder["unmatched"].split())
            ),
            alive=lambda: recorder.poll() is None,
        )
        assert fleet.replay(bags).returncode == 0
        count = len(answers) * (FRAMES - FRAMES_BEFORE_START)
        assert wait_for(lambda: int(fleet.recorder["written"]) >= count, alive=lambda: recorder.poll() is None)
        recorder.send_signal(number)
        assert recorder.wait() == 0
    finally:
        recorder.kill()
        recorder.communicate()
    topics = topics_of([out])
    for name in ("uav1", "uav2"):
        assert topics[f"/{name}/odometry"].count == FRAMES - FRAMES_BEFORE_START
    stamps = [raw.stamp_ns for raw in iter_raw([out], ["/uav1/fused/odometry"])]
    assert stamps == sorted(fleet.vehicles["uav1"].answered)


def test_constant_frames_on_tf_are_replayed_as_tf_static(bags: list[Path], tmp_path: Path) -> None:
    """The nodes read /tf_static alone."""
    expected, found = (
        [transforms_of(decode(raw))[0] for raw in Recording([path]).latched if raw.topic == "/tf_static"]
        for path in (bags[0], repeated_on_tf(bags[0], tmp_path / "tf"))
    )
    assert len(expected) == len(found) == 1
    names, poses = ([(*edge[:2],) for edge in expected[0]], [edge[2].matrix for edge in expected[0]])
    assert [(*edge[:2],) for edge in found[0]] == names
    np.testing.assert_allclose([edge[2].matrix for edge in found[0]], poses, atol=1e-12)
