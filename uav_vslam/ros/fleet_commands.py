# SPDX-License-Identifier: Apache-2.0
"""The processes of a fleet: the one description behind `uav-vslam launch` and launch/fleet.launch.py.

It imports no ROS, because launch files are read by the system's Python, which need not have our libraries.
"""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from uav_vslam.config import FleetConfig, LinkConfig, VehicleConfig, differences

VEHICLE_NODES = ("stereo_frontend", "ins_propagator", "slam_backend", "fusion")


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """One process of the graph.

    Attributes:
        executable: name in lib/uav_vslam, as `ros2 run uav_vslam` takes it.
        name: node name.
        namespace: of the vehicle, with its slash ("/uav1"); "/" for nodes of the whole fleet.
        parameters: ROS parameters by dotted name; absent ones keep their defaults.
        remappings: other topics to use, by the name that the node itself uses.
    """

    executable: str
    name: str
    namespace: str
    parameters: dict[str, Any]
    remappings: dict[str, str] = dataclasses.field(default_factory=dict)

    def ros_arguments(self) -> list[str]:
        """Return the arguments that make `executable` this node."""
        arguments = ["--ros-args", "-r", f"__node:={self.name}", "-r", f"__ns:={self.namespace}"]
        for topic, other in self.remappings.items():
            arguments += ["-r", f"{topic}:={other}"]
        for key, value in self.parameters.items():
            arguments += ["-p", f"{key}:={json.dumps(value)}"]  # JSON is YAML, and keeps "none" and "1" strings
        return arguments


def node_specs(fleet: FleetConfig, *, link: LinkConfig | None = None) -> list[NodeSpec]:
    """List every node of the fleet: four per vehicle, then those of the whole fleet.

    Args:
        fleet: with recordings, a replay of them comes last.
        link: emulated radio link; the vehicles then receive each other through it alone.
    """
    replayed = bool(fleet.replay.bags)
    specs = []
    for vehicle, config in fleet.vehicles.items():
        shared = {"vehicle": vehicle, "use_sim_time": replayed, **differences(config)}
        for executable in VEHICLE_NODES:
            peers = [name for name in fleet.vehicles if name != vehicle]
            own = {"peers": peers} if executable == "fusion" and peers else {}  # ROS can't type an empty list
            via = {packets_of(p): link_output(vehicle, p) for p in peers} if executable == "fusion" and link else {}
            via |= {feedback_to(vehicle): link_output(vehicle, "feedback")} if via else {}
            specs.append(NodeSpec(executable, executable, f"/{vehicle}", {**shared, **own}, via))
    if link is not None:
        parameters = {"vehicles": list(fleet.vehicles), "use_sim_time": replayed}
        parameters |= {f"link.{name}": value for name, value in differences(link).items()}
        specs.append(NodeSpec("link_emulator", "link_emulator", "/", parameters))
    if replayed:
        parameters = {"vehicles": list(fleet.vehicles), **differences(fleet.replay)}
        finding = [name for name, config in fleet.vehicles.items() if config.start.method != "given"]
        parameters |= {"finding_start": finding} if finding else {}
        parameters |= _replay_inputs(fleet.vehicles)
        specs.append(NodeSpec("replay", "replay", "/", parameters))
    return specs


def _replay_inputs(vehicles: Mapping[str, VehicleConfig]) -> dict[str, list[str]]:
    """Return the replay's parameter about inputs that are not the conventional ones."""
    entries = [
        f"{vehicle}:{key}:={json.dumps(value)}"
        for vehicle, config in vehicles.items()
        for key, value in differences(config.input).items()
    ]
    return {"inputs": entries} if entries else {}


def packets_of(vehicle: str) -> str:
    """Return the topic on which a vehicle sends its packets."""
    return f"/{vehicle}/landmark_information"


def feedback_to(vehicle: str) -> str:
    """Return the topic on which peers send a vehicle their feedback."""
    return f"/{vehicle}/fusion/feedback"


def link_output(receiver: str, sender: str) -> str:
    """Return the topic on which an emulated link delivers a sender's packets to a receiver."""
    return f"/{receiver}/received/{sender}"
