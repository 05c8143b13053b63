# SPDX-License-Identifier: Apache-2.0
"""The back end's services save the same map as the offline twin, and load one to start in; errors are responses."""

import itertools
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.task import Future  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from uav_vslam.config import StartConfig, VehicleConfig  # noqa: E402
from uav_vslam.ins.preintegration import preintegrate  # noqa: E402
from uav_vslam.offline.track import track_vehicle  # noqa: E402
from uav_vslam.ros.convert import features_to_msg, increment_to_msg  # noqa: E402
from uav_vslam.ros.executor import LeanExecutor  # noqa: E402
from uav_vslam.ros.slam_backend_node import SlamBackendNode  # noqa: E402
from uav_vslam.simulation.landmarks import observe, scatter_landmarks  # noqa: E402
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_fleet  # noqa: E402
from uav_vslam.simulation.source import SimulatedSource  # noqa: E402
from uav_vslam.slam.frame_queue import Frame  # noqa: E402
from uav_vslam.slam.saved_map import MappedPlace, load_map, save_map  # noqa: E402
from uav_vslam.slam.stage import SlamStage  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros
FRAMES, SESSION = 30, 7
LONG = 20  # times what is mapped: seconds to save


@dataclass(frozen=True)
class Ground:
    """A map of the first vehicle's flight, and the second one's frames over it."""

    file: Path
    vehicle: SimulatedVehicle
    frames: list[Frame]


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Ground:
    vehicles = simulate_fleet(Scenario(frames=FRAMES))
    field = scatter_landmarks(vehicles)
    track = track_vehicle(SimulatedSource(vehicles[0], field), VehicleConfig(), keep_map=True)
    file = tmp_path_factory.mktemp("maps") / "uav1_map.npz"
    assert track.saved_map is not None
    save_map(track.saved_map, file)
    vehicle, zero = vehicles[1], np.zeros(3)
    samples, imu = vehicle.imu.samples(), VehicleConfig().imu
    steps = [
        preintegrate(samples, int(a), int(b), gyro_bias=zero, accel_bias=zero, imu=imu)
        for a, b in itertools.pairwise(vehicle.frame_stamps_ns)
    ]
    features = [seen for seen, _ in observe(vehicle, field)]
    return Ground(file, vehicle, list(zip(features, [None, *steps], strict=True)))


class Node:
    """The back end, and a client that calls its services."""

    def __init__(self, ground: Ground) -> None:
        self.backend, self._client = SlamBackendNode(), rclpy.create_node("client")
        self.backend._rig.rig = ground.vehicle.rig
        self._size = ground.vehicle.rig.left.width, ground.vehicle.rig.left.height
        self._executor = LeanExecutor()
        self._executor.add_node(self.backend)
        self._executor.add_node(self._client)

    def spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.02)

    def begin(self, service: str, map_file: Path | None = None) -> Future:
        """Call a service, and return what its response will be in."""
        if map_file is not None:
            self.backend.set_parameters([Parameter("map_file", value=str(map_file))])
        client = self._client.create_client(Trigger, f"/uav2/slam_backend/{service}")
        assert wait_for(client.service_is_ready, self.spin)
        return client.call_async(Trigger.Request())

    def call(self, service: str, map_file: Path | None = None) -> Trigger.Response:
        """Call a service, and wait for its response."""
        future = self.begin(service, map_file)
        assert wait_for(future.done, self.spin)
        return future.result()

    def fly(self, frames: list[Frame]) -> None:
        for features, increment in frames:
            if increment is not None:
                self.backend._on_increment(increment_to_msg(increment, frame_id="uav2/base_link"))
            self.backend._on_features(features_to_msg(features, frame_id="left", size=self._size))

    def close(self) -> None:
        self.backend.destroy_node()
        self._client.destroy_node()


@pytest.fixture
def node(ground: Ground, domain_id: int) -> Iterator[Node]:
    settings = ["-p", "start.method:=map", "-p", f"session:={SESSION}"]
    rclpy.init(args=["--ros-args", "-r", "__ns:=/uav2", *settings], domain_id=domain_id)
    node = Node(ground)
    yield node
    node.close()
    rclpy.shutdown()


def offline_map_hash(ground: Ground) -> str:
    config = VehicleConfig(start=StartConfig(method="map", map=str(ground.file)))
    stage = SlamStage(config, vehicle="uav2", session=SESSION, keep_map=True)
    stage.rig = ground.vehicle.rig
    for features, increment in ground.frames:
        if increment is not None:
            stage.add_increment(increment)
        stage.add_features(features)
        for _ in stage.run():
            pass
    assert stage.initial is not None
    return stage.mapped().saved_map().hash


@pytest.mark.slow
def test_a_node_that_loads_a_map_starts_in_it_and_saves_the_offline_twin_s_map(
    node: Node, ground: Ground, tmp_path: Path
) -> None:
    loaded = node.call("load_map", ground.file)
    assert loaded.success, loaded.message
    assert load_map(ground.file).hash in loaded.message
    node.fly(ground.frames)
    nowhere = node.call("save_map", tmp_path / "nowhere" / "map.npz")
    assert (nowhere.success, "can't be written" in nowhere.message) == (False, True)
    over = node.call("save_map", ground.file)
    assert (over.success, "map that was loaded" in over.message) == (False, True)
    assert load_map(ground.file).hash in loaded.message
    assert node.backend.notes["start"] == "found in flight"
    saved = node.call("save_map", tmp_path / "uav2_map.npz")
    assert saved.success, saved.message
    written = load_map(tmp_path / "uav2_map.npz")
    assert written.origin.sources == (f"uav2/{SESSION}", "uav1/1")
    assert written.hash == offline_map_hash(ground)
    assert len(written) > 0
    late = node.call("load_map", ground.file)
    assert not late.success
    assert "before the flight" in late.message


@pytest.mark.slow
def test_the_node_goes_on_while_a_map_is_saved(node: Node, ground: Ground, tmp_path: Path) -> None:
    node.call("load_map", ground.file)
    node.fly(ground.frames)
    archive = node.backend._stage._flight.archive
    assert archive is not None
    archive._parts = archive._rest() * LONG  # as after a long flight
    saving = node.begin("save_map", tmp_path / "uav2_map.npz")
    assert not node.call("load_map").success  # it flies already
    assert not saving.done()
    assert wait_for(saving.done, node.spin)
    assert saving.result().success, saving.result().message


def test_what_goes_wrong_is_the_response_and_the_node_goes_on(node: Node, tmp_path: Path) -> None:
    for service, file, reason in (
        ("load_map", None, "map_file is empty"),
        ("load_map", tmp_path / "nothing.npz", "can't be read"),
        ("save_map", tmp_path / "empty.npz", "no landmark is mapped so far"),
        ("save_map", Path("~nobody_here/map.npz"), "no such user"),
        ("load_map", Path("~nobody_here/map.npz"), "no such user"),
    ):
        response = node.call(service, file)
        assert not response.success
        assert reason in response.message
    assert not (tmp_path / "empty.npz").exists()


@pytest.mark.slow
def test_a_failure_that_nobody_foresaw_does_not_end_a_node_in_flight(
    node: Node, ground: Ground, tmp_path: Path
) -> None:
    node.call("load_map", ground.file)
    node.fly(ground.frames)
    archive, one = node.backend._stage._flight.archive, np.ones(1, np.uint32)
    assert archive is not None
    lost = np.zeros(0, np.float32)  # the covariance of a landmark: bounding it raises ValueError
    archive._parts = [MappedPlace(one, np.zeros((1, 3)), lost, np.zeros((1, 128), np.uint8), one)]
    response = node.call("save_map", tmp_path / "uav2_map.npz")
    assert not response.success
    assert response.message


def test_an_empty_map_neither_replaces_another_nor_is_one_to_start_in(
    node: Node, ground: Ground, tmp_path: Path
) -> None:
    """After a reset nothing is mapped."""
    file, empty = tmp_path / "uav2_map.npz", tmp_path / "empty.npz"
    shutil.copy(ground.file, file)
    saved = node.call("save_map", file)
    assert (saved.success, saved.message.startswith("no landmark is mapped so far")) == (False, True)
    assert load_map(file).hash == load_map(ground.file).hash
    save_map(node.backend._stage.mapped().saved_map(), empty)
    loaded = node.call("load_map", empty)
    assert (loaded.success, "has no landmarks to start in" in loaded.message) == (False, True)
    assert node.call("load_map", ground.file).success
