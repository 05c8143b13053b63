# SPDX-License-Identifier: Apache-2.0
"""A vehicle's own nodes as processes, on a radio where an attacker sends hundreds of packets a frame.

The attacker sits in this process. It corrupts an honest peer's packets as test_packet_fuzz does, as bytes and
as messages, sends them again, and sends the vehicle's own packets back to it as those of a peer, a metre away. The
replay waits for it at each frame, so that the whole flight is attacked, however fast the machine.
"""

import dataclasses
import runpy
import signal
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from node_processes import running  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402

from uav_vslam.config import FleetConfig, ReplayConfig, load_vehicle  # noqa: E402
from uav_vslam.cooperation.authentication import FleetKey  # noqa: E402
from uav_vslam.cooperation.inbox import NOTHING_COMMON, SUPERSEDED, Inbox  # noqa: E402
from uav_vslam.datasets.cdr import RawMessage, decode  # noqa: E402
from uav_vslam.datasets.flight_writer import ImageCoding  # noqa: E402
from uav_vslam.datasets.rosbag import iter_raw  # noqa: E402
from uav_vslam.ros.domain import claimed_domain  # noqa: E402
from uav_vslam.ros.fleet_commands import NodeSpec, feedback_to, node_specs, packets_of  # noqa: E402
from uav_vslam.ros.packet_message import packet_from_msg, packet_to_msg  # noqa: E402
from uav_vslam.ros.qos import NEWEST, RADIO, STATE  # noqa: E402
from uav_vslam.simulation.recording import record  # noqa: E402
from uav_vslam.simulation.scenario import SCENARIOS, START_NS  # noqa: E402
from uav_vslam.slam.packet import PacketPolicy, checksum, make_packet  # noqa: E402
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket  # noqa: E402
from uav_vslam_msgs.msg import LandmarkInformation  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROOT = Path(__file__).parents[2]
FUZZ = runpy.run_path(str(Path(__file__).with_name("test_packet_fuzz.py")))  # its packet corruptions

FRAMES = 17  # 2.2 s: epochs at 1 and 2 s, so that what comes in the first can do its harm in the second
FEW = {"frontend.max_tracks": 150, "backend.max_in_view": 40}  # landmarks: an attack needs no more
SHARE = 150  # hostile packets at each frame
BURST = 8  # two a topic at once
PAUSE_S = 0.004
HONEST, MIRROR = "uav2", "uav4"
PEERS = (HONEST, "uav3", MIRROR)
TOPICS = (*map(packets_of, PEERS), feedback_to("uav1"))  # all that the vehicle receives from others
KEY = b"k" * 32
SETTLED = 2  # diagnostics after the flight: the first may have been on its way when the last packet was counted


@dataclasses.dataclass
class Outcome:
    """What a flight left.

    Attributes:
        own, fused: recorded odometry, as bytes.
        status: the fusion node's last FusionStatus.
        dropped: by reason, in its diagnostics.
        sent: packets of the attacker.
        codes: exit codes of the processes, by name.
        output: of all processes.
    """

    own: list[bytes]
    fused: list[bytes]
    status: Any
    dropped: Counter[str]
    sent: int
    codes: dict[str, int]
    output: str

    @property
    def accepted(self) -> dict[str, int]:
        """Packets taken in of each peer by the last epoch."""
        return {peer.peer: int(peer.packets_received) - refused(peer) for peer in self.status.peers}

    def link(self, peer: str) -> Any:
        """The status of one peer."""
        return next(link for link in self.status.peers if link.peer == peer)


def refused(peer: Any) -> int:
    """Return how many packets of a peer were refused on arrival."""
    drops = zip(peer.drop_reasons, peer.drop_counts, strict=True)
    return sum(int(count) for reason, count in drops if reason not in (SUPERSEDED, NOTHING_COMMON))


class Attacker:
    """A node on the radio: the honest peer, and whoever means harm."""

    def __init__(self, node: Any, honest: list[bytes], hostile: list[list[bytes]]) -> None:
        """Prepare.

        Args:
            node: to publish with.
            honest: a packet of uav2 for each frame.
            hostile: what is sent at each frame; empty ones for a flight that nobody disturbs.
        """
        self._node, self._honest, self._hostile = node, honest, hostile
        self._radio = [node.create_publisher(LandmarkInformation, topic, RADIO["wideband"]) for topic in TOPICS]
        self._answer = node.create_publisher(Odometry, "/uav1/attacked", NEWEST)
        self._waiting: list[bytes] = []
        self._unanswered: list[Odometry] = []
        self._mirrored: LandmarkInformation | None = None
        self._frames = self.sent = self.reports = 0
        self.dropped: Counter[str] = Counter()
        node.create_subscription(Odometry, "/uav1/odometry", self._on_frame, STATE)
        node.create_subscription(LandmarkInformation, packets_of("uav1"), self._on_packet, RADIO["wideband"])
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def step(self) -> None:
        """Send a burst; half of its share goes out while the vehicle is at its next frame."""
        for number, data in enumerate(self._waiting[:BURST]):
            self._radio[number % len(TOPICS)].publish(data)
            self.sent += 1
        del self._waiting[:BURST]
        if len(self._waiting) <= SHARE // 2:
            for frame in self._unanswered:
                self._answer.publish(frame)
            self._unanswered.clear()

    def _on_frame(self, message: Odometry) -> None:
        self._radio[PEERS.index(HONEST)].publish(self._honest[self._frames])
        if self._mirrored is not None:
            self._radio[PEERS.index(MIRROR)].publish(self._mirrored)
            self.sent += 1
        self._waiting += self._hostile[self._frames]
        self._frames += 1
        self._unanswered.append(message)

    def _on_packet(self, message: LandmarkInformation) -> None:
        """Make of the vehicle's own landmarks a peer's, a metre away."""
        if not any(self._hostile):
            return
        packet = dataclasses.replace(packet_from_msg(message), vehicle=MIRROR, sources=(f"{MIRROR}/{message.session}",))
        packet = dataclasses.replace(packet, origin=packet.origin + np.array([1, 0, 0], np.int32))
        self._mirrored = packet_to_msg(dataclasses.replace(packet, checksum=checksum(packet)))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "uav1: fusion":
                self.reports += 1
                values = {entry.key: entry.value for entry in status.values}
                counts = {key: int(value) for key, value in values.items() if key.startswith("dropped/")}
                self.dropped = Counter({key.removeprefix("dropped/"): count for key, count in counts.items()})


def end_of(process: subprocess.Popen[bytes], log: Path) -> int:
    """Return the exit code; of a process that hangs, say where."""
    if not wait_for(lambda: process.poll() is not None):
        process.send_signal(signal.SIGABRT)
        process.wait()
        pytest.fail(f"{log.stem} did not end:\n{log.read_text(errors='replace')}")
    return process.returncode


def nodes_of(bag: Path, folder: Path, key_file: str) -> list[NodeSpec]:
    """Return a vehicle's nodes, the recorder and, last, a replay that waits for the attacker at each frame."""
    settings = {"fusion.fleet_key_file": key_file, "fusion.feedback": True} | FEW
    config = load_vehicle(ROOT / "config" / "sample.yaml", overrides=settings)
    specs = node_specs(FleetConfig({"uav1": config}, ReplayConfig(bags=(bag,))))
    added = {
        "fusion": {"peers": list(PEERS)},
        "replay": {"wait_for": ["odometry", "fused/odometry", "attacked"]},
    }
    specs = [dataclasses.replace(s, parameters=s.parameters | added.get(s.executable, {})) for s in specs]
    recorder = NodeSpec("recorder", "/", {"output": str(folder / "out"), "vehicles": ["uav1"]})
    return [recorder, *specs]


def fly(bag: Path, folder: Path, honest: list[bytes], hostile: list[list[bytes]], *, key_file: str = "") -> Outcome:
    """Replay the recording through the vehicle's nodes to its end, with an attack or without."""
    folder.mkdir()
    context = rclpy.Context()
    *nodes, replay = nodes_of(bag, folder, key_file)
    with claimed_domain() as domain_id, running(nodes, folder, domain_id) as processes:
        context.init(domain_id=domain_id)
        node, executor = rclpy.create_node("attacker", context=context), SingleThreadedExecutor(context=context)
        executor.add_node(node)
        try:
            attacker = Attacker(node, honest, hostile)
            with running([replay], folder, domain_id) as last:
                (replaying,), fusion = last.values(), processes["fusion"]
                spin(executor, attacker.step, lambda: replaying.poll() is not None)
                enough = attacker.reports + SETTLED
                spin(executor, attacker.step, lambda: attacker.reports >= enough or fusion.poll() is not None)
                for process in processes.values():
                    process.send_signal(signal.SIGINT)
                codes = {name: end_of(process, folder / f"{name}.log") for name, process in (processes | last).items()}
        finally:
            executor.shutdown()
            node.destroy_node()
            context.try_shutdown()
    own, fused, statuses = (recorded(folder, name) for name in ("odometry", "fused/odometry", "fusion/status"))
    return Outcome(
        own=[raw.data for raw in own],
        fused=[raw.data for raw in fused],
        status=decode(statuses[-1]),
        dropped=attacker.dropped,
        sent=attacker.sent,
        codes=codes,
        output="".join(log.read_text(errors="replace") for log in folder.glob("*.log")),
    )


def recorded(folder: Path, name: str) -> list[RawMessage]:
    return list(iter_raw([folder / "out"], [f"/uav1/{name}"]))


def spin(executor: Any, step: Callable[[], None], done: Callable[[], bool]) -> None:
    while not done():
        step()
        executor.spin_once(timeout_sec=PAUSE_S)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("attacked") / "flight"
    record(dataclasses.replace(SCENARIOS["sample"], frames=FRAMES, vehicles=1), path, coding=ImageCoding("png"))
    return path


@pytest.fixture(scope="module")
def honest(make_joint: Callable[..., JointInformation]) -> list[LandmarkPacket]:
    """A packet of a peer for each frame, signed; it sees nothing that the vehicle sees."""
    rng, packets = np.random.default_rng(0), []
    for k in range(FRAMES):
        stamp_ns = START_NS + k * NS_PER_S // 8
        joint = make_joint(
            rng.uniform(900, 980, (14, 3)), np.eye(48), vehicle=HONEST, stamp_ns=stamp_ns, identities=range(500, 514)
        )
        packets.append(FleetKey(KEY).sign(make_packet(joint, sequence=k + 1, policy=PacketPolicy())))
    return packets


@pytest.fixture(scope="module")
def sent_by_peer(honest: list[LandmarkPacket]) -> list[bytes]:
    return [serialize_message(packet_to_msg(packet)) for packet in honest]


@pytest.fixture(scope="module")
def hostile(sent_by_peer: list[bytes]) -> list[list[bytes]]:
    """What the attacker sends at each frame, made from what it has received by then."""
    rng = np.random.default_rng(1)
    return [
        [FUZZ["corrupted"](sent_by_peer[rng.integers(k + 1)], rng) for _ in range(SHARE)]
        for k in range(len(sent_by_peer))
    ]


@pytest.fixture(scope="module")
def undisturbed(bag: Path, sent_by_peer: list[bytes]) -> Outcome:
    return fly(bag, bag.parent / "undisturbed", sent_by_peer, [[] for _ in sent_by_peer])


def assert_unharmed(attacked: Outcome, undisturbed: Outcome, hostile: list[list[bytes]]) -> None:
    """Hold what no attack may change to the undisturbed flight, and count what was refused before any inbox."""
    assert attacked.sent >= 2000
    assert len(undisturbed.own) == FRAMES
    assert attacked.own == undisturbed.own
    assert set(attacked.codes.values()) == {0}, attacked.codes
    assert "Traceback" not in attacked.output
    expected = Counter(reason_of(data) for share in hostile for data in share)
    for reason in ("undecodable", "version", "form"):
        # A reader keeps the newest ten: on a busy machine some are replaced before the node has seen them.
        assert 0 < attacked.dropped[reason] <= expected[reason]
    assert {"sender", "shape", "checksum"} <= set(attacked.dropped)


def reason_of(data: bytes) -> str:
    """Return why a vehicle that has received nothing before refuses a packet; "" if it does not."""
    return str(FUZZ["receive"](Inbox("uav1"), data)[0])


def test_nothing_is_refused_where_nobody_attacks(undisturbed: Outcome) -> None:
    assert undisturbed.sent == 0
    assert undisturbed.dropped == {}
    assert set(undisturbed.accepted) == {HONEST}


def test_with_a_fleet_key_an_attacker_changes_nothing(
    bag: Path, sent_by_peer: list[bytes], hostile: list[list[bytes]], undisturbed: Outcome, tmp_path: Path
) -> None:
    (tmp_path / "key").write_bytes(KEY)
    attacked = fly(bag, tmp_path / "flight", sent_by_peer, hostile, key_file=str(tmp_path / "key"))
    assert_unharmed(attacked, undisturbed, hostile)
    assert attacked.fused == undisturbed.fused
    assert set(attacked.accepted) == {HONEST}  # of nobody else was one packet taken in
    assert 0 < attacked.accepted[HONEST] <= FRAMES  # and each of its own at most once
    assert attacked.link(HONEST).session == 1
    assert attacked.link(HONEST).last_sequence <= FRAMES
    assert {"checksum", "signature", "duplicate"} <= set(attacked.link(HONEST).drop_reasons)
    assert attacked.dropped["signature"] > 0


def test_without_a_key_only_the_fused_track_can_be_lied_to(
    bag: Path, sent_by_peer: list[bytes], hostile: list[list[bytes]], undisturbed: Outcome, tmp_path: Path
) -> None:
    attacked = fly(bag, tmp_path / "flight", sent_by_peer, hostile)
    assert_unharmed(attacked, undisturbed, hostile)
    valid = sum(reason_of(data) == "" for share in hostile for data in share)
    assert set(attacked.accepted) == set(PEERS)
    assert attacked.accepted[MIRROR] == 1
    assert sum(attacked.accepted.values()) <= valid + FRAMES + 1
    assert attacked.dropped["signature"] == 0
    assert attacked.link(MIRROR).packets_used > 0  # the attack has teeth: that is what keys are for
    assert attacked.fused != undisturbed.fused
    for raw in recorded(tmp_path / "flight", "fused/odometry"):
        assert np.isfinite(decode(raw).pose.covariance).all()
