# SPDX-License-Identifier: Apache-2.0
"""Vehicles of one name, sessions out of nowhere, keys that differ: fusion nodes as processes name them and go on."""

import contextlib
import dataclasses
import itertools
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from geometry_msgs.msg import TwistWithCovariance  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from node_processes import Witness, running  # noqa: E402

from uav_vslam.config import FusionConfig  # noqa: E402
from uav_vslam.cooperation.fusion import Fusion  # noqa: E402
from uav_vslam.ros.convert import joint_to_msg, odometry_to_msg  # noqa: E402
from uav_vslam.ros.fleet_commands import NodeSpec, packets_of  # noqa: E402
from uav_vslam.ros.packet_message import packet_to_msg  # noqa: E402
from uav_vslam.ros.qos import NEWEST, RADIO, STATE  # noqa: E402
from uav_vslam.slam.packet import checksum  # noqa: E402
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket, PoseEstimate  # noqa: E402
from uav_vslam_msgs.msg import FusionStatus, LandmarkInformation  # noqa: E402
from uav_vslam_msgs.msg import JointInformation as JointInformationMsg  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.slow]

MakeJoint = Callable[..., JointInformation]
FLOOD = 100  # messages of the future
LANDMARKS = 100  # in each, so that it takes 0.75 MB
PACE_S = 0.1  # of the wall clock from one epoch to the next, at least


class Vehicle:
    """The back end of one vehicle, in this process: feeds its fusion node an epoch when the others are there too.

    Attributes:
        status: newest of its fusion node.
    """

    def __init__(self, domain_id: int, make_joint: MakeJoint, name: str, *, session: int = 1) -> None:
        self.witness = Witness(domain_id, name=f"back_end_{session}")
        self.name, self._session, self._make_joint = name, session, make_joint
        node = self.witness.node
        self.joints = node.create_publisher(JointInformationMsg, f"/{name}/joint_information", NEWEST)
        self._odometry = node.create_publisher(Odometry, f"/{name}/odometry", NEWEST)
        self.status: FusionStatus | None = None
        node.create_subscription(FusionStatus, f"/{name}/fusion/status", self._on_status, STATE)

    @property
    def fusion(self) -> str:
        """Name of its fusion node's status."""
        return f"{self.name}: fusion"

    @property
    def listened_to(self) -> bool:
        """Whether its fusion node is there."""
        return self._odometry.get_subscription_count() > 0 and self.joints.get_subscription_count() > 0

    @property
    def second(self) -> int:
        """Time of its last epoch."""
        return self.status.header.stamp.sec if self.status else 0

    def joint(self, second: int, *, landmarks: int = 6) -> JointInformation:
        points = [[4.0 * k, 7.0 * (k % 3), 0.0] for k in range(landmarks)]
        covariance, stamp_ns = np.eye(6 + 3 * landmarks), second * NS_PER_S
        return self._make_joint(points, covariance, vehicle=self.name, session=self._session, stamp_ns=stamp_ns)

    def fly(self, second: int) -> None:
        """Publish what the back end does at an epoch."""
        if second == 1:
            self._move(NS_PER_S // 2)  # a frame before the first epoch
        self.joints.publish(joint_to_msg(self.joint(second), frame_id=f"{self.name}/map"))
        self._move(second * NS_PER_S)

    def _move(self, stamp_ns: int) -> None:
        pose = PoseEstimate(stamp_ns, self.joint(1).T_map_body, np.eye(6))
        twist = TwistWithCovariance(covariance=np.eye(6).ravel())
        message = odometry_to_msg(pose, twist, frame_id=f"{self.name}/map", child_frame_id=f"{self.name}/base_link")
        self._odometry.publish(message)

    def _on_status(self, message: FusionStatus) -> None:
        self.status = message


class Fleet:
    """Vehicles that fly in step, at most ten seconds of flight in one of the wall clock.

    Faster, some milliseconds of scheduling on the radio are seconds without a packet: a session that is handed over.
    """

    def __init__(self, *vehicles: Vehicle) -> None:
        self.vehicles, self._second, self._next = list(vehicles), 0, 0.0

    def until(self, condition: Callable[[], Any]) -> bool:
        """Fly until the condition holds."""
        return wait_for(condition, self._turn)

    def epochs(self, count: int) -> None:
        """Fly so many epochs."""
        end = self._second + count
        assert self.until(lambda: self._second >= end)

    def _turn(self) -> None:
        done = all(one.listened_to and one.second == self._second for one in self.vehicles)
        if done and time.monotonic() >= self._next:
            self._next = time.monotonic() + PACE_S
            self._second += 1
            for one in self.vehicles:
                one.fly(self._second)
        for one in self.vehicles:
            one.witness.turn()


@pytest.fixture
def make_vehicle(make_joint: MakeJoint) -> Iterator[Callable[..., Vehicle]]:
    made: list[Vehicle] = []

    def make(domain_id: int, name: str, *, session: int = 1) -> Vehicle:
        made.append(Vehicle(domain_id, make_joint, name, session=session))
        return made[-1]

    yield make
    for one in made:
        one.witness.__exit__()


def fusion(vehicle: str, *, folder: Path, **parameters: Any) -> tuple[NodeSpec, Path]:
    folder.mkdir(exist_ok=True)
    return NodeSpec("fusion", f"/{vehicle}", {"vehicle": vehicle, **parameters}), folder


def test_two_vehicles_of_one_name_on_the_radio_are_an_error_on_both_and_named_by_their_peers(
    make_domain_id: Callable[[], int], make_vehicle: Callable[..., Vehicle], tmp_path: Path
) -> None:
    radio, *own = (make_domain_id() for _ in range(4))
    first, second, peer = make_vehicle(own[0], "uav1", session=5), make_vehicle(own[1], "uav1", session=9), None
    peer = make_vehicle(own[2], "uav2")
    on_radio = {"radio_domain_id": radio, "radio_peers": ["127.0.0.1"]}
    specs = [
        NodeSpec("fusion", "/uav1", {"peers": ["uav2"], **on_radio}),
        NodeSpec("fusion", "/uav1", {"peers": ["uav2"], **on_radio}),
        NodeSpec("fusion", "/uav2", {"peers": ["uav1"], **on_radio}),
    ]
    folders = [tmp_path / name for name in ("first", "second", "peer")]
    for folder in folders:
        folder.mkdir()
    with (
        running(specs[:1], folders[0], own[0]),
        running(specs[1:2], folders[1], own[1]) as other,
        running(specs[2:], folders[2], own[2]),
    ):
        fleet = Fleet(first, second, peer)
        assert fleet.until(lambda: all(one.witness.is_error(one.fusion) for one in (first, second)))
        assert "another vehicle called uav1 is on the radio (session 9)" in first.witness.text(first.fusion)
        assert "another vehicle called uav1 is on the radio (session 5)" in second.witness.text(second.fusion)
        assert fleet.until(lambda: "uav1 sends in two sessions at once" in peer.witness.text(peer.fusion))
        assert peer.status is not None
        (link,) = peer.status.peers
        counted = link.session
        assert f"session {counted} is used" in peer.witness.text(peer.fusion)
        fleet.epochs(12)
        (link,) = peer.status.peers
        assert link.session == counted  # never the other in between
        other["fusion"].send_signal(signal.SIGINT)
        fleet.vehicles.remove(second)
        assert fleet.until(lambda: not first.witness.is_error(first.fusion))
        assert fleet.until(lambda: peer.status and peer.status.peers[0].session == 5)
        assert fleet.until(lambda: "two sessions" not in peer.witness.text(peer.fusion))
    assert "another vehicle called uav1" in (folders[0] / "fusion.log").read_text()
    assert "uav1 sends in two sessions at once" in (folders[2] / "fusion.log").read_text()


def test_keys_that_differ_are_told_by_every_vehicle(
    domain_id: int, make_vehicle: Callable[..., Vehicle], tmp_path: Path
) -> None:
    names = ("uav1", "uav2", "uav3")
    keys = {"uav1": "", "uav2": str(tmp_path / "one.key"), "uav3": str(tmp_path / "other.key")}
    (tmp_path / "one.key").write_bytes(b"k" * 32)
    (tmp_path / "other.key").write_bytes(b"x" * 32)
    vehicles = {name: make_vehicle(domain_id, name) for name in names}
    with contextlib.ExitStack() as stack:
        for name in names:
            peers = [peer for peer in names if peer != name]
            spec = NodeSpec("fusion", f"/{name}", {"peers": peers, "fusion.fleet_key_file": keys[name]})
            (tmp_path / name).mkdir()
            stack.enter_context(running([spec], tmp_path / name, domain_id))
        fleet = Fleet(*vehicles.values())

        def told(by: str, *texts: str) -> bool:
            message = vehicles[by].witness.text(vehicles[by].fusion)
            return all(text in message for text in texts)

        keyless, another = "signs its packets, but this vehicle has no key", "has another key than this vehicle"
        unsigned = "uav1 does not sign its packets, and this vehicle has a key"
        assert fleet.until(lambda: told("uav1", f"uav2 {keyless}", f"uav3 {keyless}"))
        assert fleet.until(lambda: told("uav2", unsigned, f"uav3 {another}"))
        assert fleet.until(lambda: told("uav3", unsigned, f"uav2 {another}"))
        for name in ("uav2", "uav3"):
            assert not vehicles[name].status.peers  # nothing was taken in
    for name in names:
        assert "packets" in (tmp_path / name / "fusion.log").read_text()


def forged(packet: LandmarkPacket, session: int) -> LandmarkPacket:
    packet = dataclasses.replace(packet, session=session, sources=(f"{packet.vehicle}/{session}",))
    return dataclasses.replace(packet, checksum=checksum(packet))


def memory_mb(pid: int) -> float:
    """Return the resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def test_a_forged_session_does_not_end_cooperation_and_the_future_does_not_fill_the_memory(
    domain_id: int, make_vehicle: Callable[..., Vehicle], tmp_path: Path
) -> None:
    uav1 = make_vehicle(domain_id, "uav1")
    radio = uav1.witness.node.create_publisher(LandmarkInformation, packets_of("uav2"), RADIO["wideband"])
    peer = Fusion("uav2", FusionConfig())
    spec = NodeSpec("fusion", "/uav1", {"peers": ["uav2"]})
    with running([spec], tmp_path, domain_id) as processes:
        fleet = Fleet(uav1)

        def hear(session: int | None = None) -> None:
            """Let the peer send a packet of the present, and fly on."""
            peer.fuse(dataclasses.replace(uav1.joint(uav1.second), vehicle="uav2"))
            packet = peer.packet()
            radio.publish(packet_to_msg(packet if session is None else forged(packet, session)))
            fleet.epochs(1)

        def link() -> Any:
            return uav1.status.peers[0]

        assert fleet.until(lambda: radio.get_subscription_count() > 0)
        assert wait_for(lambda: uav1.status and uav1.status.peers, hear)
        hear(2**63)
        named = f"uav2 sends in two sessions at once, 1 and {2**63}"
        assert wait_for(lambda: named in (tmp_path / "fusion.log").read_text(), hear)
        used = link().packets_used
        assert wait_for(lambda: link().packets_used > used + 3, hear)
        assert link().session == 1
        assert wait_for(lambda: "two sessions" not in uav1.witness.text(uav1.fusion), hear)

        before_mb, future = memory_mb(processes["fusion"].pid), itertools.count(10**6)

        def dropped() -> int:
            return int(uav1.witness.value(uav1.fusion, "dropped/stamp_jump") or 0)

        def flood() -> None:
            uav1.joints.publish(joint_to_msg(uav1.joint(next(future), landmarks=LANDMARKS), frame_id="uav1/map"))
            uav1.witness.turn()

        assert wait_for(lambda: dropped() >= FLOOD, flood)
        size_mb = 8 * (6 + 3 * LANDMARKS) ** 2 / 1e6
        assert memory_mb(processes["fusion"].pid) - before_mb < dropped() * size_mb / 2
        used = link().packets_used
        assert wait_for(lambda: link().packets_used > used + 3, hear)  # what is due is fused as before
