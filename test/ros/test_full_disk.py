# SPDX-License-Identifier: Apache-2.0
"""A recorder whose disk is full goes on: it says so, counts what it drops, and records again once there is room.

A limit of its file's size stands in for the disk: the kernel refuses the same write, after the same partial one.
"""

import re
import resource
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from node_processes import Witness, running  # noqa: E402

from uav_vslam.datasets.cdr import decode  # noqa: E402
from uav_vslam.datasets.rosbag import iter_raw  # noqa: E402
from uav_vslam.errors import BagError  # noqa: E402
from uav_vslam.ros.command import node_command  # noqa: E402
from uav_vslam.ros.fleet_commands import NodeSpec  # noqa: E402
from uav_vslam.ros.supervisor import Supervisor  # noqa: E402

pytestmark = pytest.mark.ros

RECORDER = "fleet: recorder"
PAYLOAD = "x" * 300_000  # a bag is written in chunks of 1 MB
UNDER_WAY = 15
ROOM = 700_000  # for two messages of the next chunk


class Recording:
    """A recorder that is fed with large messages, numbered by their stamps."""

    def __init__(self, witness: Witness, process: subprocess.Popen[bytes], bag: Path) -> None:
        self.witness, self.process, self.file = witness, process, bag / f"{bag.name}.mcap"
        self._publisher = witness.node.create_publisher(DiagnosticArray, "/diagnostics", 500)
        self._sent = 0
        assert witness.sees(lambda: witness.text(RECORDER) and self._publisher.get_subscription_count() == 2)

    def feed(self) -> None:
        """Send one more, unless many are under way: DDS would drop the oldest."""
        if self._sent - self.count("written") - self.count("dropped") >= UNDER_WAY:
            return
        self._sent += 1
        message = DiagnosticArray(status=[DiagnosticStatus(name="load", message=PAYLOAD)])
        message.header.stamp.sec = self._sent
        self._publisher.publish(message)

    def until(self, condition: Callable[[], object]) -> bool:
        return self.witness.sees(condition, self.feed)

    def count(self, key: str) -> int:
        return int(self.witness.value(RECORDER, key) or 0)

    def limit(self, size: int) -> None:
        """Let the file grow to that size only."""
        resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

    def fill(self) -> None:
        """Record, then let there be room for a part of a chunk only."""
        assert self.until(lambda: self.file.stat().st_size > 2e6)
        self.limit(self.file.stat().st_size + ROOM)
        assert self.until(lambda: self.witness.is_error(RECORDER) and self.count("dropped") > 5)

    def end(self) -> int:
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(60)


@pytest.mark.parametrize("room_again", [True, False])
def test_a_recorder_on_a_full_disk_goes_on(room_again: bool, domain_id: int, tmp_path: Path) -> None:
    bag = tmp_path / "out"
    spec = NodeSpec("recorder", "/", {"output": str(bag), "vehicles": ["uav1"]})
    with Witness(domain_id) as witness, running([spec], tmp_path, domain_id) as processes:
        recording = Recording(witness, processes["recorder"], bag)
        recording.fill()
        assert "is full" in witness.text(RECORDER)
        assert "File too large" in (tmp_path / "recorder.log").read_text()
        before = recording.count("written")
        if room_again:
            recording.limit(resource.RLIM_INFINITY)
            assert recording.until(lambda: not witness.is_error(RECORDER) and recording.count("written") > before + 8)
            assert "messages were not recorded" in witness.text(RECORDER)
        assert recording.end() == (0 if room_again else 1)
    log = (tmp_path / "recorder.log").read_text()
    assert "Traceback" not in log
    assert ("has no end" in log) == (not room_again)
    numbers, damage = read(bag)
    assert (damage == "") == room_again
    assert numbers == sorted(set(numbers))
    (count,) = re.findall(r"(\d+) messages recorded", log)
    assert int(count) == len(numbers)
    assert ("lost with the end of the bag" in log) == (not room_again)
    missing = set(range(1, numbers[-1] + 1)) - set(numbers)
    if room_again:
        assert len(numbers) > before - 5
        assert len(missing) > 5
        assert max(missing) - min(missing) == len(missing) - 1  # what was dropped meanwhile, and nothing else
    else:
        assert len(numbers) * len(PAYLOAD) > 1.5e6
        assert not missing


def test_a_fleet_whose_bag_has_no_end_does_not_end_well(domain_id: int, tmp_path: Path) -> None:
    bag, said = tmp_path / "out", []
    spec = NodeSpec("recorder", "/", {"output": str(bag), "vehicles": ["uav1"]})

    def on_line(_: str, line: str) -> None:
        said.append(line)
        if "recording to" in line:
            size = (bag / "out.mcap").stat().st_size
            resource.prlimit(supervisor._children[0].process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
            signal.raise_signal(signal.SIGTERM)

    supervisor = Supervisor({"ROS_DOMAIN_ID": str(domain_id)}, on_line=on_line)
    assert supervisor.run([node_command(spec)]) == 1
    assert any("has no end" in line for line in said)


def read(bag: Path) -> tuple[list[int], str]:
    """Return the numbers of the messages that can be read, and what is damaged."""
    numbers: list[int] = []
    try:
        for raw in iter_raw([bag], ["/diagnostics"]):
            message = decode(raw)
            if message.status[0].name == "load":
                numbers.append(message.header.stamp.sec)
    except BagError as error:
        return numbers, str(error)
    return numbers, ""
