# SPDX-License-Identifier: Apache-2.0
"""One description of the fleet's processes, read by both launchers."""

import ast
import dataclasses
import json
from pathlib import Path

import pytest

from uav_vslam.config import BackendConfig, FleetConfig, LinkConfig, ReplayConfig, StartConfig, VehicleConfig
from uav_vslam.config.fleet import RadioConfig
from uav_vslam.errors import ConfigError
from uav_vslam.ros.command import node_command
from uav_vslam.ros.fleet_commands import VEHICLE_NODES, node_specs

ROOT = Path(__file__).parents[2]


def fleet(*names: str, bags: tuple[Path, ...] = (Path("sample"),)) -> FleetConfig:
    vehicles = {name: VehicleConfig(backend=BackendConfig(sigma_px=0.5)) for name in names}
    return FleetConfig(vehicles, ReplayConfig(bags))


def test_each_vehicle_has_its_four_nodes_and_the_fleet_one_replay() -> None:
    specs = node_specs(fleet("uav1", "uav2"))
    found = [(spec.namespace, spec.executable) for spec in specs]
    expected = [(f"/{vehicle}", node) for vehicle in ("uav1", "uav2") for node in VEHICLE_NODES]
    assert found == [*expected, ("/", "replay")]


def test_fusion_subscribes_to_every_vehicle_but_its_own() -> None:
    peers = {
        s.parameters["vehicle"]: s.parameters["peers"]
        for s in node_specs(fleet("a", "b", "c"))
        if "peers" in s.parameters
    }
    assert peers == {"a": ["b", "c"], "b": ["a", "c"], "c": ["a", "b"]}


def test_a_start_state_that_a_vehicle_estimates_itself_is_not_replayed() -> None:
    found = fleet("a", "b", "c")
    methods = {"a": "given", "b": "static", "c": "in_flight"}
    vehicles = {name: VehicleConfig(start=StartConfig(method=method)) for name, method in methods.items()}
    replay = node_specs(dataclasses.replace(found, vehicles=vehicles))[-1]
    assert replay.parameters["finding_start"] == ["b", "c"]
    assert "finding_start" not in node_specs(found)[-1].parameters


def test_a_lone_vehicle_has_no_peers_parameter_because_ros_cannot_type_an_empty_list() -> None:
    assert all("peers" not in spec.parameters for spec in node_specs(fleet("uav1")))


def test_without_recordings_nothing_is_replayed_and_the_wall_clock_counts() -> None:
    specs = node_specs(fleet("uav1", bags=()))
    assert [spec.executable for spec in specs] == list(VEHICLE_NODES)
    assert not any(spec.parameters["use_sim_time"] for spec in specs)


def test_only_what_differs_from_the_defaults_is_passed_on() -> None:
    *vehicle, replay = node_specs(fleet("uav1", bags=(Path("a"), Path("b"))))
    for spec in vehicle:
        assert spec.parameters == {"vehicle": "uav1", "use_sim_time": True, "backend.sigma_px": 0.5}
    assert replay.parameters == {"vehicles": ["uav1"], "bags": ["a", "b"]}


def test_arguments_name_the_node_and_keep_the_types_of_parameters() -> None:
    fusion = next(spec for spec in node_specs(fleet("uav1", "uav2")) if spec.executable == "fusion")
    arguments = fusion.ros_arguments()
    assert arguments[:5] == ["--ros-args", "-r", "__node:=fusion", "-r", "__ns:=/uav1"]
    assert set(arguments[5::2]) == {"-p"}
    values = dict(argument.split(":=", 1) for argument in arguments[6::2])
    assert {key: json.loads(value) for key, value in values.items()} == fusion.parameters


def test_with_an_emulated_link_the_vehicles_receive_each_other_through_it_alone() -> None:
    specs = node_specs(fleet("a", "b", "c"), link=LinkConfig(loss=0.2))
    assert [(spec.namespace, spec.executable) for spec in specs[-2:]] == [("/", "link_emulator"), ("/", "replay")]
    assert specs[-2].parameters == {"vehicles": ["a", "b", "c"], "use_sim_time": True, "link.loss": 0.2}
    remapped = {spec.namespace: spec.remappings for spec in specs if spec.remappings}
    assert remapped["/a"] == {
        "/b/landmark_information": "/a/received/b",
        "/c/landmark_information": "/a/received/c",
        "/a/fusion/feedback": "/a/received/feedback",
    }
    assert set(remapped) == {"/a", "/b", "/c"}
    fusion = next(spec for spec in specs if spec.executable == "fusion")
    assert "/b/landmark_information:=/a/received/b" in fusion.ros_arguments()
    assert not any(spec.remappings for spec in node_specs(fleet("a", "b", "c")))


@pytest.mark.ros
def test_rclpy_reads_the_arguments_as_the_parameters_that_were_meant() -> None:
    rclpy = pytest.importorskip("rclpy", reason="needs ROS")
    fusion = next(spec for spec in node_specs(fleet("uav1", "uav2")) if spec.executable == "fusion")
    context = rclpy.Context()
    context.init(args=fusion.ros_arguments())
    try:
        node = rclpy.create_node("x", context=context, automatically_declare_parameters_from_overrides=True)
        assert node.get_fully_qualified_name() == "/uav1/fusion"
        assert {name: node.get_parameter(name).value for name in fusion.parameters} == fusion.parameters
        node.destroy_node()
    finally:
        context.try_shutdown()


def test_a_vehicle_with_its_own_computer_is_started_alone_and_reaches_its_peers_by_radio() -> None:
    addresses = {"a": "10.77.0.1", "b": "10.77.0.2", "c": "10.77.0.3"}
    radio = RadioConfig(domain_id=42, interface="wlan0")
    whole = dataclasses.replace(fleet("a", "b", "c"), radio=radio, addresses=addresses)
    *vehicle, replay = node_specs(whole, vehicles=["b"])
    assert [(spec.namespace, spec.executable) for spec in vehicle] == [("/b", name) for name in VEHICLE_NODES]
    assert replay.parameters["vehicles"] == ["b"]
    *others, fusion = vehicle
    assert fusion.parameters["peers"] == ["a", "c"]
    assert fusion.parameters["radio_peers"] == ["10.77.0.1", "10.77.0.3"]
    assert (fusion.parameters["radio_domain_id"], fusion.parameters["radio_interface"]) == (42, "wlan0")
    assert Path(fusion.environment["FASTRTPS_DEFAULT_PROFILES_FILE"]).is_file()
    assert node_command(fusion).environment == fusion.environment
    assert not any(spec.environment for spec in others)
    assert not any("radio_domain_id" in spec.parameters for spec in node_specs(whole))


def test_a_vehicle_that_is_not_in_the_fleet_and_a_link_between_computers_are_refused() -> None:
    with pytest.raises(ConfigError, match="'d' is not in the fleet file, which has a, b"):
        node_specs(fleet("a", "b"), vehicles=["d"])
    with pytest.raises(ConfigError, match="one computer"):
        node_specs(fleet("a", "b"), vehicles=["a"], link=LinkConfig())


@pytest.mark.parametrize(("vehicles", "recorded"), [((), ["a", "b", "c"]), (["c", "a"], ["a", "c"])])
def test_a_recorder_starts_first_and_records_the_vehicles_of_this_computer(vehicles, recorded) -> None:
    first, *others = node_specs(fleet("a", "b", "c"), vehicles=vehicles, record="out/bag")
    assert (first.namespace, first.executable) == ("/", "recorder")
    assert first.parameters == {"output": "out/bag", "vehicles": recorded}
    assert others == node_specs(fleet("a", "b", "c"), vehicles=vehicles)


def test_the_clock_of_others_is_used_if_asked_for() -> None:
    specs = node_specs(fleet("uav1", bags=()), use_sim_time=True)
    assert all(spec.parameters["use_sim_time"] for spec in specs)


@pytest.mark.parametrize(("name", "one"), [("fleet", False), ("vehicle", True)])
def test_the_launch_files_read_the_same_description(name: str, one: bool) -> None:
    """`launch` comes with a ROS installation only, so their syntax tree has to do."""
    tree = ast.parse((ROOT / "launch" / f"{name}.launch.py").read_text())
    (function,) = (node for node in tree.body if isinstance(node, ast.FunctionDef))
    assert function.name == "generate_launch_description"
    assert ast.unparse(function.body[-1]) == f"return description(one_vehicle={one})"
    source = (ROOT / "uav_vslam" / "ros" / "launch_description.py").read_text()
    called = {
        node.func.id for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call) and hasattr(node.func, "id")
    }
    assert {"node_specs", "load_fleet", "load_link"} <= called
