# SPDX-License-Identifier: Apache-2.0
"""All settings of one vehicle, section by section."""

from dataclasses import dataclass, field

from uav_vslam.config.backend import BackendConfig
from uav_vslam.config.frontend import SIFT_EXTRACTORS, FrontendConfig
from uav_vslam.config.fusion import FusionConfig
from uav_vslam.config.imu import ImuConfig
from uav_vslam.config.input import InputConfig
from uav_vslam.config.rig import RigConfig
from uav_vslam.config.settings import Settings, refuse, setting

START_METHODS = ("given", "static", "in_flight", "map")


@dataclass(frozen=True, slots=True)
class StartConfig(Settings):
    """How a vehicle gets its start state."""

    method: str = setting(
        "given",
        "given: topic initial_state; static: gravity at rest; in_flight: gravity and stereo odometry; map: as "
        "in_flight, with the pose in the map of start.map",
        choices=START_METHODS,
    )
    rest_s: float = setting(1.0, "static: time over which readings are averaged", unit="s", above=0)
    map: str = setting(
        "",
        "file of a map to fly in, relative to the configuration file: fusion corrects by it, and method map starts in "
        "it; empty for none",
    )
    velocity_sigma: float = setting(
        5.0,
        "in_flight: prior standard deviation of the start's velocity, per axis; map: largest one of a usable window",
        unit="m/s",
        above=0,
    )

    @property
    def defines_map(self) -> bool:
        """Whether the start state is the origin of the map frame, and its heading east."""
        return self.method in ("static", "in_flight")

    @property
    def searches(self) -> bool:
        """Whether the vehicle finds its start state itself, in flight."""
        return self.method in ("in_flight", "map")


@dataclass(frozen=True, slots=True)
class OutputFramesConfig(Settings):
    """Names of the frames that the nodes publish (REP-105); that of the body is `input.frames.base`."""

    world: str = setting(
        "",
        "frame of the fused estimate; empty: world, which the fleet shares, or VEHICLE/world without a common origin",
    )
    map: str = setting("", "frame of the vehicle's own map; empty: VEHICLE/map")
    odom: str = setting("", "frame in which the own pose has no jumps; empty: VEHICLE/odom")

    def _check_together(self) -> None:
        names = [name for name in (self.world, self.map, self.odom) if name]
        if twice := next((name for name in names if names.count(name) > 1), ""):
            refuse("map", twice, "a name for each frame: TF rejects one that is its own parent")

    def map_of(self, vehicle: str) -> str:
        """Return the name of a vehicle's map frame."""
        return self.map or f"{vehicle}/map"

    def world_of(self, vehicle: str, *, common: bool) -> str:
        """Return the name of the frame of a vehicle's fused estimate, whose origin may be common to the fleet."""
        return self.world or ("world" if common else f"{vehicle}/world")


@dataclass(frozen=True, slots=True)
class VehicleConfig(Settings):
    """Everything that one vehicle's nodes, or its offline twin, need besides calibration and start state."""

    input: InputConfig = field(default_factory=InputConfig)
    frames: OutputFramesConfig = field(default_factory=OutputFramesConfig)
    start: StartConfig = field(default_factory=StartConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    rig: RigConfig = field(default_factory=RigConfig)
    frontend: FrontendConfig = field(default_factory=FrontendConfig)
    backend: BackendConfig = field(default_factory=BackendConfig)
    fusion: FusionConfig = field(default_factory=FusionConfig)

    def _check_together(self) -> None:
        if self.start.map and self.fusion.prior_id:
            refuse("fusion.prior_id", self.fusion.prior_id, "none beside start.map: the map's own hash is used")
        if self.fusion.mode == "narrowband" and self.frontend.extractor not in SIFT_EXTRACTORS:
            allowed = f"one of {', '.join(SIFT_EXTRACTORS)} in narrowband mode, whose descriptors are made of SIFT's"
            refuse("frontend.extractor", self.frontend.extractor, allowed)
