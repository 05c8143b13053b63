# SPDX-License-Identifier: Apache-2.0
"""The parameters of each ROS node: its own, and those of the vehicle's settings that it uses."""

from dataclasses import dataclass, field

from uav_vslam.config.fleet import LinkConfig, ReplayConfig
from uav_vslam.config.settings import Settings, all_settings, is_vehicle_name, refuse, setting
from uav_vslam.config.vehicle import VehicleConfig


@dataclass(frozen=True, slots=True)
class VehicleNodeConfig(Settings):
    """Parameters of every node of a vehicle."""

    vehicle: str = setting(
        "", "name by which peers know the vehicle; empty: its namespace, `/fleet/uav1` as fleet_uav1"
    )
    parameter_services: bool = setting(
        True, "whether others on the domain can read and change parameters, such as the communication mode"
    )
    autostart: bool = setting(
        True, "use messages at once; otherwise wait to be configured and activated (ros2 lifecycle)"
    )
    resume: bool = setting(
        False,
        "go on from what a process that died left: live settings, a pause, the back end's checkpoint, the mapper's "
        "folder; the launcher sets it when it restarts a node",
    )

    def _check_together(self) -> None:
        if self.vehicle and not is_vehicle_name(self.vehicle):
            refuse("vehicle", self.vehicle, "a valid ROS namespace: letters, digits, underscores")


@dataclass(frozen=True, slots=True)
class InsNodeConfig(VehicleNodeConfig):
    """Parameters of ins_propagator."""

    odometry_rate_hz: float = setting(
        50.0, "rate of ins/odometry and of the transforms; 0: at each IMU reading", unit="Hz", at_least=0
    )


@dataclass(frozen=True, slots=True)
class BackendNodeConfig(VehicleNodeConfig):
    """Parameters of slam_backend."""

    session: int = setting(0, "number of this start of the vehicle; 0: above all earlier ones", at_least=0)
    checkpoint_s: float = setting(1.0, "period of checkpoints, in the time of the images", unit="s", above=0)
    map_file: str = setting("", "file that the service save_map writes and load_map reads", live=True)


@dataclass(frozen=True, slots=True)
class FusionNodeConfig(VehicleNodeConfig):
    """Parameters of fusion."""

    peers: tuple[str, ...] = setting((), "names of the other vehicles")
    radio_domain_id: int = setting(-1, "ROS domain of the radio; -1: the vehicle's own", at_least=-1, at_most=232)
    radio_peers: tuple[str, ...] = setting((), "addresses of the other vehicles on the radio's domain")
    radio_interface: str = setting("", "network interface whose traffic is reported; empty for none")

    def _check_together(self) -> None:
        VehicleNodeConfig._check_together(self)
        _check_fleet("peers", self.peers)


@dataclass(frozen=True, slots=True)
class MapConfig(Settings):
    """The map of the surface."""

    folder: str = setting("", "new folder of the map; empty: it is kept in memory and published only")
    cell_m: float = setting(0.5, "side of a cell of the height grid", unit="m", above=0, at_most=100)
    # Heights are read in cells under whole blocks of pixels: under larger ones they take gigabytes.
    pixel_m: float = setting(
        0.25, "side of a pixel of the orthomosaic in flight; 0: none", unit="m", at_least=0, at_most=50
    )
    publish_s: float = setting(
        5.0, "period at which the map's tiles are saved and the map is published, if it has grown", unit="s", above=0
    )


@dataclass(frozen=True, slots=True)
class MapperNodeConfig(VehicleNodeConfig):
    """Parameters of mapper."""

    map: MapConfig = field(default_factory=MapConfig)


@dataclass(frozen=True, slots=True)
class ReplayNodeConfig(ReplayConfig):
    """Parameters of replay."""

    vehicles: tuple[str, ...] = setting((), "names of the vehicles; empty: all in the recordings")
    wait_for: tuple[str, ...] = setting(
        ("odometry", "fused/odometry"), "outputs of each vehicle to wait for after each frame; they pace lock-step"
    )
    finding_start: tuple[str, ...] = setting((), "vehicles that estimate their start state themselves")
    inputs: tuple[str, ...] = setting(
        (), "settings of `input` that the vehicles' nodes have, as VEHICLE:KEY:=VALUE (uav1:topics.left:=/camera/left)"
    )

    def _check_together(self) -> None:
        _check_fleet("vehicles", self.vehicles)


@dataclass(frozen=True, slots=True)
class LinkNodeConfig(Settings):
    """Parameters of link_emulator."""

    vehicles: tuple[str, ...] = setting((), "names of the vehicles, two or more")
    link: LinkConfig = field(default_factory=LinkConfig)

    def _check_together(self) -> None:
        _check_fleet("vehicles", self.vehicles)


@dataclass(frozen=True, slots=True)
class RecorderNodeConfig(Settings):
    """Parameters of recorder."""

    output: str = setting("", "folder to create")
    vehicles: tuple[str, ...] = setting((), "names of the vehicles")

    def _check_together(self) -> None:
        _check_fleet("vehicles", self.vehicles)


@dataclass(frozen=True, slots=True)
class NodeParameters:
    """What a node declares.

    Attributes:
        own: class of its own parameters.
        uses: sections ("backend") and single settings ("fusion.epoch_s") of a vehicle's configuration.
    """

    own: type[Settings]
    uses: tuple[str, ...] = ()

    @property
    def used_names(self) -> list[str]:
        """Dotted names of the vehicle's settings that the node uses."""
        return [name for name in all_settings(VehicleConfig) if {name, *_parts(name)} & set(self.uses)]


def _check_fleet(name: str, vehicles: tuple[str, ...]) -> None:
    """Refuse repeated vehicles, whose messages would count twice."""
    if len(set(vehicles)) < len(vehicles):
        refuse(name, list(vehicles), "each name once")


def _parts(name: str) -> list[str]:
    """Return the sections that a setting is in: "input" and "input.topics" of "input.topics.left"."""
    words = name.split(".")
    return [".".join(words[:k]) for k in range(1, len(words))]


NODES: dict[str, NodeParameters] = {
    "stereo_frontend": NodeParameters(VehicleNodeConfig, ("input", "rig", "frontend")),
    "ins_propagator": NodeParameters(InsNodeConfig, ("input", "frames", "start", "imu")),
    "slam_backend": NodeParameters(
        BackendNodeConfig, ("input", "frames", "start", "imu", "rig", "backend", "frontend.ratio", "fusion.epoch_s")
    ),
    "fusion": NodeParameters(
        FusionNodeConfig,
        ("input.frames.base", "input.on_time_jump", "frames", "start.map", "fusion", "frontend.extractor"),
    ),
    "mapper": NodeParameters(MapperNodeConfig, ("input", "frames", "rig")),
    "replay": NodeParameters(ReplayNodeConfig),
    "link_emulator": NodeParameters(LinkNodeConfig),
    "recorder": NodeParameters(RecorderNodeConfig),
}
