# SPDX-License-Identifier: Apache-2.0
"""What the documents say that a stranger on a vehicle's own domain can't do."""

from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from node_processes import Witness, running  # noqa: E402

from uav_vslam.cli.launch import discovery_environment  # noqa: E402
from uav_vslam.config import FleetConfig, ReplayConfig, VehicleConfig  # noqa: E402
from uav_vslam.ros.fleet_commands import node_specs, without_parameter_services  # noqa: E402
from uav_vslam.ros.transport import DISCOVERY_RANGE  # noqa: E402

pytestmark = pytest.mark.ros

SERVICES = {"describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters"}


def test_parameters_can_be_closed_to_others(domain_id: int, tmp_path: Path) -> None:
    fleet = FleetConfig({"uav1": VehicleConfig()}, ReplayConfig())
    (fusion,) = (spec for spec in node_specs(fleet) if spec.executable == "fusion")
    with Witness(domain_id) as stranger, running([without_parameter_services(fusion)], tmp_path, domain_id):
        assert stranger.sees(lambda: stranger.text("uav1: fusion"))

        def found() -> set[str]:
            if ("fusion", "/uav1") not in stranger.node.get_node_names_and_namespaces():
                return set()
            services = stranger.node.get_service_names_and_types_by_node("fusion", "/uav1")
            return {name.rpartition("/")[2] for name, _ in services}

        assert stranger.sees(lambda: "get_type_description" in found())  # offered by every node: the list is complete
        assert not found() & SERVICES


def test_launch_keeps_the_vehicles_domain_on_the_host_unless_told_otherwise() -> None:
    assert discovery_environment({}, own_radio=True) == {DISCOVERY_RANGE: "LOCALHOST"}
    assert discovery_environment({DISCOVERY_RANGE: "SUBNET"}, own_radio=True) == {}
    assert discovery_environment({}, own_radio=False) == {}  # the vehicles reach each other on it


def test_every_vehicle_node_is_closed_and_nothing_else_is_changed() -> None:
    fleet = FleetConfig({"uav1": VehicleConfig()}, ReplayConfig())
    for spec in node_specs(fleet, maps="maps"):
        closed = without_parameter_services(spec)
        assert closed.parameters == spec.parameters | {"parameter_services": False}
