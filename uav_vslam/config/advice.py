# SPDX-License-Identifier: Apache-2.0
"""Settings that decide nothing, claim too much, or keep vehicles apart: said at start-up, or results would mislead."""

from collections.abc import Collection, Mapping

from uav_vslam.config.fleet import FleetConfig
from uav_vslam.config.settings import differences, flatten
from uav_vslam.config.vehicle import VehicleConfig

_WITH_TRACKS = {
    "frontend.matcher": "has no effect: klt finds the points of the right image by optical flow",
    "backend.association": "decides almost nothing: klt's tracks keep their landmarks from frame to frame, and "
    "only features whose track has none are associated",
}
_WITHOUT_TRACKS = {"frontend.anchored": "has no effect: only klt tracks points"}
# Methods that are there to be compared with, by what they do (docs/measured/estimator.md, together.md).
_NINE_STATES = "makes the filter over-confident, with a position NEES of 30 and more: use it to compare, not to fly"
_DESCRIPTORS_ALONE = (
    "compares descriptors alone, and with its wrong pairs the fused estimate is worse than the own one, and sure of "
    "itself: use it to compare, not to fly"
)
_BASELINES = {
    "backend.model": {"euler9": _NINE_STATES},
    "fusion.association": dict.fromkeys(("nn", "cds", "coarse_fine"), _DESCRIPTORS_ALONE),
}


def doubtful_settings(config: VehicleConfig) -> dict[str, str]:
    """Return by dotted name what `idle_settings` and `overclaiming_settings` say."""
    return idle_settings(config) | overclaiming_settings(config)


def idle_settings(config: VehicleConfig) -> dict[str, str]:
    """Return by dotted name why a setting that differs from its default decides nothing, or almost."""
    changed = differences(config)
    tracking = config.frontend.method == "klt"
    reasons, remedy = (_WITH_TRACKS, "; use frontend.method = sift") if tracking else (_WITHOUT_TRACKS, "")
    return {name: f"{name} = {changed[name]} {reason}{remedy}" for name, reason in reasons.items() if name in changed}


def overclaiming_settings(config: VehicleConfig) -> dict[str, str]:
    """Return by dotted name why a setting makes a vehicle claim to know more than it does."""
    values = flatten(config)
    idle = {"fusion.association"} if config.fusion.mode == "none" else set()
    return {
        name: f"{name} = {values[name]} {reasons[values[name]]}"
        for name, reasons in _BASELINES.items()
        if values[name] in reasons and name not in idle
    }


def separate_maps(configs: Mapping[str, VehicleConfig]) -> str:
    """Return why vehicles, by name, that cooperate in one frame do not have one; empty if they may have it."""
    apart = [
        name
        for name, config in configs.items()
        if config.start.defines_map and config.fusion.common_origin and config.fusion.mode != "none"
    ]
    if len(apart) < 2:
        return ""
    return (
        f"{', '.join(apart)} each start in a map frame of their own (start.method = static or in_flight), so peers' "
        "landmarks can't be associated: set fusion.common_origin = false, or give start states in one frame"
    )


def idle_radio(fleet: FleetConfig, vehicles: Collection[str]) -> str:
    """Return why a fleet's radio is not used where some of its vehicles are started, none for all; empty if it is."""
    if fleet.radio.domain_id < 0 or vehicles:
        return ""
    return (
        "radio is not used: all vehicles start on this computer, on one ROS domain; if each has its own, start it "
        "there with --vehicle NAME"
    )
