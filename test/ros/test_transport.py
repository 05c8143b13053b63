# SPDX-License-Identifier: Apache-2.0
"""Only nodes that exchange images use shared memory, where a killed process can leave another deaf."""

import os
import shlex
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from node_processes import Witness, running

from uav_vslam.config import find_dds_profile
from uav_vslam.ros.fleet_commands import IN_SHARED_MEMORY, VEHICLE_NODES, NodeSpec
from uav_vslam.ros.transport import DISCOVERY_RANGE, PROFILES_FILE, udp_alone

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
SEGMENT = "/dev/shm/fastrtps_"


@pytest.mark.slow
def test_only_nodes_with_images_map_shared_memory(
    domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PROFILES_FILE, str(find_dds_profile("images.xml")))
    specs = [NodeSpec(name, "/uav1", {"vehicle": "uav1"}) for name in (*VEHICLE_NODES, "mapper")]
    specs[-1].parameters["map.folder"] = str(tmp_path / "map")
    specs.append(NodeSpec("recorder", "/", {"output": str(tmp_path / "out"), "vehicles": ["uav1"]}))
    with Witness(domain_id) as witness, running(specs, tmp_path, domain_id) as processes:
        assert witness.sees(lambda: len(witness.statuses) == len(specs))
        maps = {name: Path(f"/proc/{process.pid}/maps").read_text() for name, process in processes.items()}
    found = {name for name, mapped in maps.items() if SEGMENT in mapped}
    assert found == {"stereo_frontend", "mapper", "fusion"}
    assert found | {"replay"} == IN_SHARED_MEMORY


@pytest.mark.parametrize(
    ("profile", "discovery", "applies"),
    [
        (None, "LOCALHOST", True),
        ("", "LOCALHOST", True),
        ("images.xml", "LOCALHOST", True),  # as env.sh sets it
        ("radio.xml", "LOCALHOST", False),
        ("images.xml", "SUBNET", False),
        ("images.xml", None, False),
    ],
)
def test_a_profile_or_range_that_the_user_has_chosen_stays(
    profile: str | None, discovery: str | None, applies: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_STATIC_PEERS", raising=False)
    given = {PROFILES_FILE: profile and str(find_dds_profile(profile)), DISCOVERY_RANGE: discovery}
    for name, value in given.items():
        if value is None:
            monkeypatch.delenv(name, raising=False)
        else:
            monkeypatch.setenv(name, value)
    changed = {PROFILES_FILE: str(find_dds_profile("messages.xml")), DISCOVERY_RANGE: "SYSTEM_DEFAULT"}
    assert udp_alone() == (changed if applies else {})


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("", str(ROOT / "config/dds/images.xml")),
        ("/another/clone/config/dds/images.xml", str(ROOT / "config/dds/images.xml")),
        ("/mine/profile.xml", "/mine/profile.xml"),
    ],
)
def test_the_environment_names_its_own_profile_unless_the_user_has_one(before: str, after: str) -> None:
    script = f'. {shlex.quote(str(ROOT / "env.sh"))} && echo "${PROFILES_FILE}"'
    shell = subprocess.run(
        ["bash", "-c", script], env=os.environ | {PROFILES_FILE: before}, capture_output=True, text=True, check=True
    )
    assert shell.stdout.strip() == after


def test_static_peers_keep_the_range(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_STATIC_PEERS", "10.0.0.2")
    monkeypatch.setenv(DISCOVERY_RANGE, "LOCALHOST")
    assert udp_alone() == {}
