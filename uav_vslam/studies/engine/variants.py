# SPDX-License-Identifier: Apache-2.0
"""Settings that more than one study compares, by name."""

FRONT_ENDS: dict[str, dict[str, object]] = {
    "klt": {"frontend.method": "klt"},
    "sift": {"frontend.method": "sift"},
}
CALIBRATIONS: dict[str, dict[str, object]] = {  # what the filter makes of the calibration that it is given
    "calibration judged": {"rig.flexing": False},
    "attitude estimated": {"rig.flexing": True},
    "calibration doubted": {"rig.miscalibrated_probability": 0.5},
}
