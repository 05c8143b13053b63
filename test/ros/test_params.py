# SPDX-License-Identifier: Apache-2.0
"""Every parameter of every node: described, refused where it is wrong, and in effect where it may change in flight."""

import math
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import ReliabilityPolicy  # noqa: E402

from uav_vslam.config import VehicleConfig  # noqa: E402
from uav_vslam.config.nodes import NODES  # noqa: E402
from uav_vslam.config.settings import Setting, all_settings  # noqa: E402
from uav_vslam.ins.preintegration import preintegrate  # noqa: E402
from uav_vslam.ros.fusion_node import FusionNode  # noqa: E402
from uav_vslam.ros.ins_propagator_node import InsPropagatorNode  # noqa: E402
from uav_vslam.ros.link_emulator_node import LinkEmulatorNode  # noqa: E402
from uav_vslam.ros.recorder_node import RecorderNode  # noqa: E402
from uav_vslam.ros.replay_node import ReplayNode  # noqa: E402
from uav_vslam.ros.runtime import finish, run_node  # noqa: E402
from uav_vslam.ros.slam_backend_node import SlamBackendNode  # noqa: E402
from uav_vslam.ros.stereo_frontend_node import StereoFrontendNode  # noqa: E402
from uav_vslam.simulation.camera_render import RenderedFlight  # noqa: E402
from uav_vslam.simulation.landmarks import observe, scatter_landmarks  # noqa: E402
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle  # noqa: E402
from uav_vslam.slam.frame_report import FrameReport  # noqa: E402
from uav_vslam.slam.state_folder import state_folder  # noqa: E402

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
CLASSES: dict[str, Callable[[], Node]] = {
    "stereo_frontend": StereoFrontendNode,
    "ins_propagator": InsPropagatorNode,
    "slam_backend": SlamBackendNode,
    "fusion": FusionNode,
    "replay": ReplayNode,
    "link_emulator": LinkEmulatorNode,
    "recorder": RecorderNode,
}
NEEDED = {
    "replay": [f"bags:=[{ROOT / 'bags' / 'sample'}]"],
    "link_emulator": ["vehicles:=[uav1, uav2]"],
    "recorder": ["vehicles:=[uav1]"],
}
IN_RANGE: dict[str, Any] = {  # a value other than the default for each setting that may change in flight
    "map_file": "other.npz",
    "frontend.epipolar_px": 3.0,
    "frontend.min_depth_m": 1.0,
    "frontend.max_depth_m": 400.0,
    "backend.sigma_px": 0.5,
    "backend.track_sigma_px": 0.2,
    "backend.gate_probability": 0.9,
    "backend.max_observations": 50,
    "fusion.mode": "narrowband",
    "fusion.budget_bytes_per_s": 500,
    "fusion.silent_after_s": 2.0,
    "fusion.feedback": True,
    "fusion.relay": True,
    "fusion.max_packet_landmarks": 10,
}


@pytest.fixture
def start(tmp_path: Path, domain_id: int) -> Iterator[Callable[..., Any]]:
    """Return a starter of nodes: start("fusion", "fusion.mode:=none")."""
    nodes: list[Node] = []

    def make(name: str, *parameters: str, more: tuple[str, ...] = ()) -> Any:
        output = [f"output:={tmp_path / 'out'}"] if name == "recorder" else []
        arguments = ["--ros-args", "-r", "__ns:=/uav1", *more]
        for parameter in [*NEEDED.get(name, []), *output, *parameters]:
            arguments += ["-p", parameter]
        rclpy.init(args=arguments, domain_id=domain_id)
        nodes.append(CLASSES[name]())
        return nodes[-1]

    yield make
    for node in nodes:
        finish(node)
        node.destroy_node()
    rclpy.try_shutdown()


def settings_of(name: str) -> dict[str, Setting]:
    of_vehicle = all_settings(VehicleConfig)
    return all_settings(NODES[name].own) | {key: of_vehicle[key] for key in NODES[name].used_names}


def wrong_values(described: Setting) -> list[Any]:
    """Return values that a setting must not have: of another type, not finite, beyond each bound."""
    if described.kind is bool:
        return [5, "nonsense"]
    if described.kind is str:
        return [7, *(["nonsense"] if described.choices else [])]
    if described.kind is int:
        lowest, highest = described.at_least, described.at_most
        return [1.5, "nonsense", int(lowest or 0) - 1, *([] if highest is None else [int(highest) + 1])]
    if described.kind is float:
        open_ends = [bound for bound in (described.above, described.below) if bound is not None]
        below = [] if described.at_least is None else [described.at_least - 1e-3]
        above = [] if described.at_most is None else [described.at_most + 1e-3]
        return ["nonsense", math.nan, math.inf, *open_ends, *below, *above]
    return ["nonsense", 3]


def set_parameter(node: Node, name: str, value: Any) -> Any:
    (result,) = node.set_parameters([Parameter(name, value=value)])
    return result


@pytest.mark.parametrize("name", CLASSES)
def test_every_parameter_is_described_and_refuses_what_is_wrong(start: Callable[..., Any], name: str) -> None:
    node = start(name)
    for key, described in settings_of(name).items():
        descriptor = node.describe_parameter(key)
        assert descriptor.description == described.description != ""
        assert descriptor.additional_constraints == described.range
        assert descriptor.read_only is not described.live
        numbers = [*descriptor.floating_point_range, *descriptor.integer_range]
        assert len(numbers) == (described.kind in (int, float)), key
        for value in wrong_values(described):
            result = set_parameter(node, key, value)
            assert not result.successful, (key, value)
            assert key in result.reason or "expected" in result.reason, (key, value, result.reason)
        if not described.live:
            result = set_parameter(node, key, node.get_parameter_or(key).value or "")
            assert not result.successful
            assert "read-only" in result.reason
            continue
        before = described.default
        assert set_parameter(node, key, IN_RANGE[key]).successful, key
        assert node.get_parameter(key).value == IN_RANGE[key] != before
        section, _, field = key.partition(".")
        if field:  # a node reads those of its own when it needs them
            assert getattr(getattr(node.config, section), field) == IN_RANGE[key]
        assert set_parameter(node, key, before).successful


def test_a_node_that_is_restarted_has_the_live_settings_of_the_one_before(start: Callable[..., Any]) -> None:
    def process(*parameters: str) -> Any:
        rclpy.try_shutdown()
        return start("fusion", *parameters)

    first = process("fusion.silent_after_s:=3.0")
    assert set_parameter(first, "fusion.mode", "narrowband").successful
    restarted = process("fusion.silent_after_s:=3.0", "resume:=true")
    assert restarted.config.fusion.mode == restarted.get_parameter("fusion.mode").value == "narrowband"
    assert restarted.config.fusion.silent_after_s == 3.0
    assert process().config.fusion.mode == "wideband"  # a new flight has its own
    assert process("resume:=true").config.fusion.mode == "wideband"


def test_a_node_that_dies_while_it_is_paused_is_paused_when_it_is_restarted(start: Callable[..., Any]) -> None:
    def process(*parameters: str) -> Any:
        rclpy.try_shutdown()
        return start("fusion", *parameters)

    process().trigger_deactivate()
    restarted = process("resume:=true")
    assert restarted.paused == "paused"
    restarted.trigger_activate()
    assert not restarted.paused
    again = process("resume:=true")
    assert not again.paused
    again.trigger_deactivate()
    assert not process().paused  # a new flight
    assert not process("resume:=true").paused


def test_live_settings_that_can_not_be_read_are_left(start: Callable[..., Any]) -> None:
    stored = state_folder() / "uav1_fusion.json"
    stored.parent.mkdir(parents=True, exist_ok=True)
    for content in ("{", "[1]", '{"fusion.mode": "loud"}', '{"unknown": 1}'):
        rclpy.try_shutdown()
        stored.write_text(content)
        assert start("fusion", "resume:=true").config.fusion.mode == "wideband"


def test_values_that_do_not_go_together_are_refused_when_set(start: Callable[..., Any]) -> None:
    node = start("stereo_frontend")
    result = set_parameter(node, "frontend.min_depth_m", 600.0)
    assert not result.successful
    assert "frontend.min_depth_m = 600.0 is not allowed; use a depth below max_depth_m, which is 500" in result.reason
    both = [Parameter("frontend.min_depth_m", value=600.0), Parameter("frontend.max_depth_m", value=700.0)]
    assert node.set_parameters_atomically(both).successful
    assert (node.config.frontend.min_depth_m, node.config.frontend.max_depth_m) == (600.0, 700.0)


def test_the_noise_of_a_calibration_file_counts_where_no_parameter_sets_it(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    file = tmp_path / "imu.yaml"
    file.write_text("imu0: {gyroscope_noise_density: 7.0e-4, accelerometer_noise_density: 8.0e-3}")
    node = start("ins_propagator", f"input.calibration:=[{file}]", "imu.accel_noise:=2.0e-3")
    assert node.config.imu.gyro_noise == node.get_parameter("imu.gyro_noise").value == 7.0e-4
    assert node.config.imu.accel_noise == node.get_parameter("imu.accel_noise").value == 2.0e-3


@pytest.mark.parametrize(("value", "taken"), [(2, 2.0), ("1e-1", 0.1)])
def test_a_whole_number_and_an_exponent_may_stand_for_a_float(
    start: Callable[..., Any], value: Any, taken: float
) -> None:
    node = start("slam_backend", "backend.pnp_px:=3", "backend.retention_cell_m:=1e1", "imu.gyro_noise:='1e-3'")
    assert node.get_parameter("backend.pnp_px").value == node.config.backend.pnp_px == 3.0
    assert node.get_parameter("backend.retention_cell_m").value == 10.0
    assert node.config.imu.gyro_noise == 1e-3
    assert set_parameter(node, "backend.sigma_px", value).successful
    assert node.get_parameter("backend.sigma_px").value == node.config.backend.sigma_px == taken


@pytest.mark.parametrize(
    ("name", "setting"), [("stereo_frontend", "matcher = gtm"), ("slam_backend", "association = nn")]
)
def test_a_node_warns_of_its_own_settings_that_decide_nothing(
    start: Callable[..., Any], capfd: pytest.CaptureFixture[str], name: str, setting: str
) -> None:
    start(name, "frontend.matcher:=gtm", "backend.association:=nn")
    lines = [line for line in capfd.readouterr().err.splitlines() if "klt" in line]
    assert len(lines) == 1
    assert setting in lines[0]


def test_a_node_warns_of_its_own_settings_that_claim_too_much(
    start: Callable[..., Any], capfd: pytest.CaptureFixture[str]
) -> None:
    start("fusion", "fusion.association:=nn", "backend.model:=euler9")
    (line,) = [line for line in capfd.readouterr().err.splitlines() if "use it to compare" in line]
    assert "fusion.association = nn" in line


@pytest.mark.parametrize("name", CLASSES)
def test_configuration_files_of_ours_are_parameter_files_of_every_node(start: Callable[..., Any], name: str) -> None:
    link = ROOT / "config" / "links" / "bad_radio.yaml"
    more = ("--params-file", str(ROOT / "config" / "kagaru.yaml"), "--params-file", str(link))
    node = start(name, more=more)
    declared = {key for key in node.list_parameters([], 0).names if not key.startswith(("qos_overrides", "use_"))}
    assert declared - {"start_type_description_service"} == set(settings_of(name))
    if name == "slam_backend":
        assert node.get_parameter("backend.sigma_px").value == 0.3
    if name == "link_emulator":
        assert node.get_parameter("link.loss").value == 0.2


def test_a_parameter_that_is_no_setting_leaves_the_configuration_alone(start: Callable[..., Any]) -> None:
    """Each topic declares some, of its QoS: building and checking the whole for each is most of a node's start."""
    node = start("slam_backend")
    before = node._settings.config
    node.declare_parameter("mine", 1)
    assert node._settings.config is before


def test_qos_that_is_overridden_for_one_output_is_not_that_of_others(start: Callable[..., Any]) -> None:
    node = start("slam_backend", "qos_overrides./uav1/odometry.publisher.reliability:=best_effort")
    offered = {one.topic_name: one.qos_profile.reliability for one in node.publishers}
    assert offered["/uav1/odometry"] == ReliabilityPolicy.BEST_EFFORT
    assert offered["/uav1/joint_information"] == offered["/uav1/slam/correction"] == ReliabilityPolicy.RELIABLE


@pytest.mark.parametrize(
    ("parameter", "said"),
    [
        ("backend.sigma_pxx:=1.0", "unknown key backend.sigma_pxx; did you mean backend.sigma_px?"),
        ("mode:=none", "unknown key mode; did you mean fusion.mode?"),
        ("fusion.mode:=radio", "fusion.mode = 'radio' is not allowed; use one of wideband, narrowband, none"),
        ("backend.sigma_px:=much", "backend.sigma_px = 'much' is not allowed; use a number of at least 0.01 [px]"),
        ("backend:=5", "backend must hold keys and values, not 5"),
        ("peers:=5", "peers = 5 is not allowed; use a list of texts"),
        ("radio_domain_id:=x", "radio_domain_id = 'x' is not allowed; use a whole number of at least -1"),
        ("peers:=[1, a]", "Couldn't parse parameter override rule"),
        ("use_sim_time:=5", "use_sim_time"),
        ("qos_overrides./uav1/fused/odometry.publisher.depth:=x", "qos_overrides./uav1/fused/odometry.publisher.depth"),
    ],
)
def test_a_wrong_parameter_ends_a_node_with_one_line(
    parameter: str,
    said: str,
    domain_id: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # pytest's own handlers stay
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    assert run_node(FusionNode, ["--ros-args", "-r", "__ns:=/uav1", "-p", parameter]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert said in lines[-1]
    assert "Traceback" not in "\n".join(lines)


def test_the_gates_of_the_front_end_follow_their_parameters(start: Callable[..., Any]) -> None:
    """Points lie 70 m below; each gate, set so that it must reject them, does so with the next pair."""
    vehicle = simulate_vehicle(Scenario(frames=12, scale=0.25), 0)
    node, frames = start("stereo_frontend", "frontend.search_scale:=1.0"), iter(RenderedFlight(vehicle))
    node._rig.rig = vehicle.rig

    def features() -> int:
        before = node.counts["features"]
        node._waiting.append(next(frames))
        node._work()
        return int(node.counts["features"] - before)

    for name, closed, wide in (
        ("frontend.epipolar_px", 1e-9, 2.0),
        ("frontend.min_depth_m", 200.0, 0.3),
        ("frontend.max_depth_m", 20.0, 500.0),
    ):
        assert features() > 50, name
        assert set_parameter(node, name, closed).successful
        assert features() == 0, name
        assert set_parameter(node, name, wide).successful
        features()  # finds points again


def test_the_filter_follows_its_parameters(start: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle = simulate_vehicle(Scenario(frames=12), 0)
    samples, zero = vehicle.imu.samples(), np.zeros(3)
    features = (seen for seen, _ in observe(vehicle, scatter_landmarks([vehicle])))
    stamps_ns, reports = [int(stamp_ns) for stamp_ns in vehicle.frame_stamps_ns], []
    node = start("slam_backend", "session:=1")
    node._rig.rig = vehicle.rig
    node._stage.start(vehicle.initial)
    monkeypatch.setattr(node, "_publish", lambda output: reports.append(output.report))
    node._stage.add_features(next(features))
    node._work()

    def report() -> FrameReport:
        begin_ns, end_ns = stamps_ns[len(reports) - 1 : len(reports) + 1]
        imu = node.config.imu
        node._stage.add_increment(preintegrate(samples, begin_ns, end_ns, gyro_bias=zero, accel_bias=zero, imu=imu))
        node._stage.add_features(next(features))
        node._work()
        return reports[-1]

    for _ in range(4):
        usual = report()
    assert usual.associated > 20
    assert not usual.relocalised
    assert set_parameter(node, "backend.max_observations", 5).successful
    assert report().associated == 5
    assert set_parameter(node, "backend.max_observations", 100).successful
    assert report().associated > 20
    assert set_parameter(node, "backend.sigma_px", 20.0).successful
    vague = report().innovation
    assert vague.nis / vague.dof < 0.1 * usual.innovation.nis / usual.innovation.dof  # 20 px expected, 1 px met
    assert set_parameter(node, "backend.sigma_px", 1.0).successful
    assert set_parameter(node, "backend.gate_probability", 1e-9).successful
    assert report().relocalised  # nothing passes the gate, so the whole map is searched
