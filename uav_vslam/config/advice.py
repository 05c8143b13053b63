# SPDX-License-Identifier: Apache-2.0
"""Settings that were changed but decide nothing with the others: said at start-up, or comparisons would mislead."""

from uav_vslam.config.settings import differences
from uav_vslam.config.vehicle import VehicleConfig


def idle_settings(config: VehicleConfig) -> dict[str, str]:
    """Return by dotted name why a setting that differs from its default decides nothing, or almost."""
    if config.frontend.method != "klt":
        return {}
    reasons = {
        "frontend.matcher": "has no effect: klt finds the points of the right image by optical flow",
        "backend.association": "decides almost nothing: klt's tracks keep their landmarks from frame to frame, and "
        "only features whose track has none are associated",
    }
    changed = differences(config)
    return {
        name: f"{name} = {changed[name]} {reason}; use frontend.method = sift"
        for name, reason in reasons.items()
        if name in changed
    }
