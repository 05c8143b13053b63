# SPDX-License-Identifier: Apache-2.0
"""Every parameter of a vehicle, a fleet and a node: the one home of defaults, units, ranges and texts.

settings    the metadata of a setting, and the checks made from it
imu, input, rig, frontend, backend, fusion    a vehicle's settings, by section
vehicle, fleet, nodes    all of a vehicle; of a fleet; of a node
advice      settings that decide nothing with the others, or keep vehicles apart
files       YAML files
reference   the reference page docs/reference/parameters.md
"""

from uav_vslam.config.advice import doubtful_settings, idle_radio, separate_maps
from uav_vslam.config.backend import ASSOCIATIONS, FILTERS, RETENTION_POLICIES, STATE_MODELS, BackendConfig
from uav_vslam.config.files import (
    difference_file,
    expanded,
    find_config,
    find_dds_profile,
    load_fleet,
    load_link,
    load_resolved,
    load_vehicle,
    parameter_file,
)
from uav_vslam.config.fleet import FleetConfig, LinkConfig, ReplayConfig
from uav_vslam.config.frontend import EXTRACTORS, FRONTEND_MATCHERS, FrontendConfig
from uav_vslam.config.fusion import (
    FUSION_ASSOCIATIONS,
    FUSION_SCHEMES,
    FUSION_WEIGHTS,
    MAX_PACKET_LANDMARKS,
    MODE_BUDGETS,
    FusionConfig,
)
from uav_vslam.config.imu import IMU_GRADES, ImuConfig
from uav_vslam.config.input import InputConfig
from uav_vslam.config.rig import EXACT_RIG, RigConfig
from uav_vslam.config.settings import differences, replaced
from uav_vslam.config.vehicle import StartConfig, VehicleConfig

__all__ = [
    "ASSOCIATIONS",
    "EXACT_RIG",
    "EXTRACTORS",
    "FILTERS",
    "FRONTEND_MATCHERS",
    "FUSION_ASSOCIATIONS",
    "FUSION_SCHEMES",
    "FUSION_WEIGHTS",
    "IMU_GRADES",
    "MAX_PACKET_LANDMARKS",
    "MODE_BUDGETS",
    "RETENTION_POLICIES",
    "STATE_MODELS",
    "BackendConfig",
    "FleetConfig",
    "FrontendConfig",
    "FusionConfig",
    "ImuConfig",
    "InputConfig",
    "LinkConfig",
    "ReplayConfig",
    "RigConfig",
    "StartConfig",
    "VehicleConfig",
    "difference_file",
    "differences",
    "doubtful_settings",
    "expanded",
    "find_config",
    "find_dds_profile",
    "idle_radio",
    "load_fleet",
    "load_link",
    "load_resolved",
    "load_vehicle",
    "parameter_file",
    "replaced",
    "separate_maps",
]
