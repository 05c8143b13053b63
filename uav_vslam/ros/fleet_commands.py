# SPDX-License-Identifier: Apache-2.0
"""The processes of a fleet: the one description behind `uav-vslam launch` and launch/fleet.launch.py.

It imports no ROS, because launch files are read by the system's Python, which need not have our libraries.
"""

import dataclasses
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from uav_vslam.config import FleetConfig, LinkConfig, VehicleConfig, differences, find_dds_profile
from uav_vslam.errors import ConfigError
from uav_vslam.ros.transport import PROFILES_FILE

VEHICLE_NODES = ("stereo_frontend", "ins_propagator", "slam_backend", "fusion")
IN_SHARED_MEMORY = frozenset({"stereo_frontend", "fusion", "mapper", "replay"})  # unless they have another DDS profile


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """One process of the graph.

    Attributes:
        executable: name in lib/uav_vslam, as `ros2 run uav_vslam` takes it, and of the node.
        namespace: of the vehicle, with its slash ("/uav1"); "/" for nodes of the whole fleet.
        parameters: ROS parameters by dotted name; absent ones keep their defaults.
        remappings: other topics to use, by the name that the node itself uses.
        environment: variables in addition to the launcher's.
    """

    executable: str
    namespace: str
    parameters: dict[str, Any]
    remappings: dict[str, str] = dataclasses.field(default_factory=dict)
    environment: dict[str, str] = dataclasses.field(default_factory=dict)

    def ros_arguments(self) -> list[str]:
        """Return the arguments that make `executable` this node."""
        arguments = ["--ros-args", "-r", f"__node:={self.executable}", "-r", f"__ns:={self.namespace}"]
        for topic, other in self.remappings.items():
            arguments += ["-r", f"{topic}:={other}"]
        for key, value in self.parameters.items():
            arguments += ["-p", f"{key}:={json.dumps(value)}"]  # JSON is YAML, and keeps "none" and "1" strings
        return arguments


def node_specs(
    fleet: FleetConfig,
    *,
    link: LinkConfig | None = None,
    vehicles: Collection[str] = (),
    use_sim_time: bool | None = None,
    record: str = "",
    maps: str = "",
) -> list[NodeSpec]:
    """List the nodes to start: four per vehicle, then those of the whole fleet.

    Args:
        fleet: with recordings, a replay of them comes last.
        link: emulated radio link; the vehicles then receive each other through it alone.
        vehicles: those of this computer, which reach the others by the fleet's radio; none: all, without a radio.
        use_sim_time: whether nodes take the time from /clock; None: with a replay.
        record: new bag for the estimates, whose recorder starts first; empty for none.
        maps: folder in which each vehicle's mapper makes its own; empty for no mappers.

    Raises:
        ConfigError: a vehicle is not in the fleet, or a link is to be emulated between computers or for one vehicle.
    """
    here = fleet.chosen(vehicles)
    if link is not None and len(fleet.vehicles) < 2:
        raise ConfigError("an emulated link connects vehicles, and the fleet has but one; leave out the link")
    if vehicles and link is not None:
        raise ConfigError("an emulated link needs all vehicles on one computer; leave out the vehicles or the link")
    sim_time = bool(fleet.replay.bags) if use_sim_time is None else use_sim_time
    specs = [NodeSpec("recorder", "/", {"output": record, "vehicles": list(here)})] if record else []
    of_vehicle = {
        name: {"vehicle": name, "use_sim_time": sim_time, **differences(config)} for name, config in here.items()
    }
    for name, parameters in of_vehicle.items():
        specs += _vehicle_specs(fleet, name, parameters, link)
    if maps:
        specs += [
            NodeSpec("mapper", f"/{name}", parameters | {"map.folder": f"{maps}/{name}"})
            for name, parameters in of_vehicle.items()
        ]
    if vehicles:
        specs = [_on_radio(fleet, spec) if spec.executable == "fusion" else spec for spec in specs]
    if link is not None:
        specs.append(_link_emulator_spec(fleet, link, sim_time=sim_time))
    if fleet.replay.bags:
        specs.append(_replay_spec(fleet, here))
    return specs


def _link_emulator_spec(fleet: FleetConfig, link: LinkConfig, *, sim_time: bool) -> NodeSpec:
    parameters = {"vehicles": list(fleet.vehicles), "use_sim_time": sim_time}
    parameters |= {f"link.{name}": value for name, value in differences(link).items()}
    return NodeSpec("link_emulator", "/", parameters)


def _replay_spec(fleet: FleetConfig, here: Mapping[str, VehicleConfig]) -> NodeSpec:
    """Return the replay for the vehicles of this computer; of those that find their start state none is replayed."""
    parameters = {"vehicles": list(here), **differences(fleet.replay)}
    finding = [name for name, config in here.items() if config.start.method != "given"]
    parameters |= {"finding_start": finding} if finding else {}
    return NodeSpec("replay", "/", parameters | _replay_inputs(here))


def _vehicle_specs(
    fleet: FleetConfig, vehicle: str, parameters: dict[str, Any], link: LinkConfig | None
) -> list[NodeSpec]:
    """Return the nodes of a vehicle; its fusion node listens to all others of the fleet, through the link if any."""
    peers = [name for name in fleet.vehicles if name != vehicle]
    own = {"peers": peers} if peers else {}  # ROS can't type an empty list
    via = {packets_of(peer): link_output(vehicle, peer) for peer in peers} if link else {}
    via |= {feedback_to(vehicle): link_output(vehicle, "feedback")} if via else {}
    *others, fusion = (NodeSpec(name, f"/{vehicle}", parameters) for name in VEHICLE_NODES)
    return [*others, dataclasses.replace(fusion, parameters=parameters | own, remappings=via)]


def _on_radio(fleet: FleetConfig, fusion: NodeSpec) -> NodeSpec:
    """Return a fusion node that reaches the other computers; see docs/radio.md."""
    if fleet.radio.domain_id < 0:
        return fusion
    vehicle = fusion.parameters["vehicle"]
    others = [address for name, address in fleet.addresses.items() if name != vehicle]
    radio = {f"radio_{name}": value for name, value in differences(fleet.radio).items()}
    radio |= {"radio_peers": others} if others else {}
    environment = {PROFILES_FILE: str(find_dds_profile("radio.xml"))} if others else {}
    return dataclasses.replace(fusion, parameters=fusion.parameters | radio, environment=environment)


def _replay_inputs(vehicles: Mapping[str, VehicleConfig]) -> dict[str, list[str]]:
    """Return the replay's parameter about inputs that are not the conventional ones."""
    entries = [
        f"{vehicle}:{key}:={json.dumps(value)}"
        for vehicle, config in vehicles.items()
        for key, value in differences(config.input).items()
    ]
    return {"inputs": entries} if entries else {}


def without_parameter_services(spec: NodeSpec) -> NodeSpec:
    """Return a node whose parameters nobody can change in flight; nodes of the whole fleet stay as they are."""
    if spec.namespace == "/":
        return spec
    return dataclasses.replace(spec, parameters=spec.parameters | {"parameter_services": False})


def vehicle_in(namespace: str) -> str:
    """Return the name of the vehicle whose nodes are in a namespace, unless their parameter `vehicle` gives another."""
    return namespace.strip("/").replace("/", "_")


def packets_of(vehicle: str) -> str:
    """Return the topic on which a vehicle sends its packets."""
    return f"/{vehicle}/landmark_information"


def feedback_to(vehicle: str) -> str:
    """Return the topic on which peers send a vehicle their feedback."""
    return f"/{vehicle}/fusion/feedback"


def link_output(receiver: str, sender: str) -> str:
    """Return the topic on which an emulated link delivers a sender's packets to a receiver."""
    return f"/{receiver}/received/{sender}"
