# SPDX-License-Identifier: Apache-2.0
"""Settings that decide nothing with the others, or keep vehicles apart: said at start-up, or results would mislead."""

from collections.abc import Collection, Mapping

from uav_vslam.config.fleet import FleetConfig
from uav_vslam.config.settings import differences
from uav_vslam.config.vehicle import VehicleConfig

_WITH_TRACKS = {
    "frontend.matcher": "has no effect: klt finds the points of the right image by optical flow",
    "backend.association": "decides almost nothing: klt's tracks keep their landmarks from frame to frame, and "
    "only features whose track has none are associated",
}
_WITHOUT_TRACKS = {"frontend.anchored": "has no effect: only klt tracks points"}


def idle_settings(config: VehicleConfig) -> dict[str, str]:
    """Return by dotted name why a setting that differs from its default decides nothing, or almost."""
    changed = differences(config)
    tracking = config.frontend.method == "klt"
    reasons, remedy = (_WITH_TRACKS, "; use frontend.method = sift") if tracking else (_WITHOUT_TRACKS, "")
    return {name: f"{name} = {changed[name]} {reason}{remedy}" for name, reason in reasons.items() if name in changed}


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
