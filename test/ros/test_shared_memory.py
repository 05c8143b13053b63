# SPDX-License-Identifier: Apache-2.0
"""Shared memory of killed nodes is freed at the next start of a fleet, and that of living ones never touched."""

import contextlib
import fcntl
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from uav_vslam.cli.launch import _remove_leftovers, launch
from uav_vslam.config import FleetConfig, ReplayConfig, VehicleConfig
from uav_vslam.ros import shared_memory
from uav_vslam.ros.shared_memory import FOLDER, SETTLED_S, remove_leftovers
from uav_vslam.ros.supervisor import Supervisor
from uav_vslam.ros.transport import PROFILES_FILE
from waiting import wait_for

pytestmark = pytest.mark.ros

TALKER = """
    import sys, rclpy
    from std_msgs.msg import String
    rclpy.init()
    node = rclpy.create_node("talker")
    heard = node.create_subscription(String, sys.argv[1], lambda m: print("heard", flush=True), 10)
    said = node.create_publisher(String, sys.argv[2], 10)
    node.create_timer(0.05, lambda: said.publish(String(data="x" * 1000)))
    print("ready", flush=True)
    rclpy.spin(node)
""".replace("\n    ", "\n")


@pytest.fixture
def talkers(domain_id: int) -> Iterator[list[subprocess.Popen[str]]]:
    """Three nodes as processes; the first two hear each other, the third hears the first."""
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain_id)}
    topics = [("a", "b"), ("b", "a"), ("b", "c")]
    with contextlib.ExitStack() as stack:
        found = []
        for pair in topics:
            command = [sys.executable, "-c", TALKER, *pair]
            found.append(
                stack.enter_context(subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True))
            )
            stack.callback(found[-1].kill)
        for one in found:
            assert said(one) == "ready"
        yield found


def said(one: subprocess.Popen[str]) -> str:
    assert one.stdout is not None
    return one.stdout.readline().strip()


def files_of(process: subprocess.Popen[str]) -> set[str]:
    """Return the shared memory of which a process holds the lock, but for ports that other domains may use too."""
    open_files = [os.readlink(path) for path in Path(f"/proc/{process.pid}/fd").iterdir() if path.exists()]
    locks = {Path(name).name for name in open_files if name.startswith(f"{FOLDER}/fastrtps_")}
    own = {name for name in locks if not name.startswith("fastrtps_port70")}
    return {name.removesuffix("_el") for name in own} | own


def there(names: set[str]) -> set[str]:
    return {name for name in names if (FOLDER / name).exists()}


@pytest.mark.slow
def test_what_a_killed_node_left_is_freed_at_the_next_launch_and_the_living_go_on(
    talkers: list[subprocess.Popen[str]], capfd: pytest.CaptureFixture[str]
) -> None:
    first, second, killed = talkers
    of_killed, of_living = files_of(killed), files_of(first) | files_of(second)
    assert len(of_killed) >= 4  # a segment and a port, each with its lock
    started_s = max((FOLDER / name).stat().st_mtime for name in of_killed)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    assert there(of_killed) == of_killed
    assert wait_for(lambda: time.time() - started_s > SETTLED_S)
    empty = FleetConfig({}, ReplayConfig())  # which a recorder refuses
    assert launch(empty, record=Path("out")) == 2
    assert "that killed processes had left are free again" in capfd.readouterr().err
    # A port that a living process may still send to goes once that has noticed, at the latest when it exits.
    assert all("port" in name for name in there(of_killed))
    assert there(of_living) == of_living
    for one in (first, second):  # both before one is killed: either hears only the other
        assert [said(one) for _ in range(20)] == ["heard"] * 20
    for one in (first, second):
        one.send_signal(signal.SIGKILL)
        one.wait()
    assert wait_for(lambda: not there(of_killed | of_living), lambda: remove_leftovers() and time.sleep(0.5))


def test_what_a_node_killed_in_flight_left_is_freed_at_the_end(
    talkers: list[subprocess.Popen[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    killed = talkers[-1]
    segments = {name for name in files_of(killed) if "port" not in name}
    started_s = max((FOLDER / name).stat().st_mtime for name in segments)
    assert wait_for(lambda: time.time() - started_s > SETTLED_S)

    def fly(*_: object) -> int:
        killed.send_signal(signal.SIGKILL)
        killed.wait()
        return 0

    monkeypatch.setattr(Supervisor, "run", fly)
    assert there(segments) == segments
    launch(FleetConfig({}, ReplayConfig()))
    assert there(segments) == set()


def old(path: Path) -> Path:
    path.touch()
    os.utime(path, (0, 0))
    return path


def test_a_locked_a_mapped_and_a_young_file_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {kind: f"fastrtps_{k:016x}" for k, kind in enumerate(("left", "locked", "young"))}
    names["mapped"] = "fastrtps_port7410"
    for name in names.values():
        old(tmp_path / name).write_bytes(bytes(8192))
        old(tmp_path / f"{name}_el")
    (tmp_path / f"{names['young']}_el").touch()
    old(tmp_path / "something_else")
    monkeypatch.setattr(shared_memory, "_mapped", lambda _: {names["mapped"]})
    with (tmp_path / f"{names['locked']}_el").open("rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        removed = remove_leftovers(tmp_path)
    assert removed.names == (names["left"],)
    assert removed.size_bytes == 8192
    kept = {f"{names[kind]}{end}" for kind in ("locked", "mapped", "young") for end in ("", "_el")}
    assert {path.name for path in tmp_path.iterdir()} == kept | {"something_else"}


def test_a_port_goes_with_its_semaphore_and_a_lock_made_for_it_goes_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for port in (7410, 7412):
        old(tmp_path / f"fastrtps_port{port}")
        old(tmp_path / f"sem.fastrtps_port{port}_mutex")
    monkeypatch.setattr(shared_memory, "_mapped", lambda _: {"fastrtps_port7412"})
    assert remove_leftovers(tmp_path).names == ("fastrtps_port7410",)
    assert {path.name for path in tmp_path.iterdir()} == {"fastrtps_port7412", "sem.fastrtps_port7412_mutex"}


@pytest.mark.parametrize(("size_bytes", "told"), [(8192, ""), (3_000_000, "3 MB of ")])
def test_a_launch_tells_of_what_it_freed_unless_it_is_next_to_nothing(
    size_bytes: int, told: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shared_memory, "remove_leftovers", lambda: shared_memory.Removed(("one",), size_bytes))
    _remove_leftovers()
    error = capfd.readouterr().err
    assert error.startswith(f"uav-vslam: {told}") if told else not error


def test_where_there_is_no_shared_memory_nothing_is_removed(tmp_path: Path) -> None:
    assert remove_leftovers(tmp_path / "absent").names == ()


def test_a_launch_tells_of_too_little_shared_memory_as_containers_have(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(PROFILES_FILE, raising=False)
    monkeypatch.setattr(Supervisor, "run", lambda *_: 0)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(64_000_000, 0, 64_000_000))
    launch(FleetConfig({"uav1": VehicleConfig()}, ReplayConfig()))
    assert "64 MB free, and the nodes use up to 70 MB there" in capfd.readouterr().err
    launch(FleetConfig({}, ReplayConfig()))
    monkeypatch.setenv(PROFILES_FILE, "mine.xml")
    launch(FleetConfig({"uav1": VehicleConfig()}, ReplayConfig()))
    assert "64 MB" not in capfd.readouterr().err
