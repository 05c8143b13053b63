# SPDX-License-Identifier: Apache-2.0
"""What a run shows of its quality without ground truth, in a few sentences for the terminal."""

import math

from uav_vslam.evaluation.quality import CONSERVATIVE, CONSISTENT, OVER_CONFIDENT
from uav_vslam.evaluation.summary import Figures

SIDES = {CONSERVATIVE: "below", CONSISTENT: "in", OVER_CONFIDENT: "above"}  # of the 95 % band


def quality_lines(vehicle: Figures) -> list[str]:
    """Return sentences about one vehicle of a `build_summary` result; none without records of its frames."""
    quality = vehicle["quality"]
    if quality is None:
        return []
    lines = [innovation_line(quality), coasting_line(quality, vehicle["frames_processed"]), claim_line(vehicle)]
    return [*lines, *calibration_lines(quality.get("calibration", {})), *health_lines(quality)]


def innovation_line(quality: Figures) -> str:
    """Return the verdict on the innovations."""
    value, band = quality["nis_per_dof"], quality["nis_band"]
    if value is None:
        return "no visual update: nothing can be said about consistency"
    side = SIDES[quality["nis_verdict"]]
    text = f"innovations {quality['nis_verdict']}: NIS/dof {value:.3g} {side} [{band[0]:.2f}, {band[1]:.2f}]"
    if quality["nis_verdict"] != CONSISTENT:
        text += f", {math.sqrt(value):.3g} x claimed"
    return f"{text}; {100 * quality['nis_outside_share']:.0f} % of frames outside"


def coasting_line(quality: Figures, frames: int) -> str:
    """Return how much the cameras contributed."""
    medians = [f"{quality[f'{key}_median'] or 0:.0f} {key}" for key in ("features", "tracked", "associated")]
    text = f"median {', '.join(medians)}; coasted {quality['frames_coasted']} of {frames} frames"
    if quality["frames_coasted"] == 0:
        return text
    return f"{text} (longest {quality['coasted_longest']}, {quality['without_update_s']:.1f} s)"


def claim_line(vehicle: Figures) -> str:
    """Return what the best estimate claims at the end."""
    name, track = ("C-SLAM", vehicle["c_slam"]) if vehicle["c_slam"] else ("S-SLAM", vehicle["s_slam"])
    if track["sigma_end_m"] is None:
        return f"{name} claims nothing of its uncertainty"
    rate = track["sigma_per_100m_m"]
    growth = "" if rate is None else f" ({rate:.3g} m/100 m)"
    return (
        f"{name} claims 1 sigma of {track['sigma_end_m']:.3g} m after {vehicle['distance_m']:.0f} m{growth}, "
        f"heading {track['sigma_heading_end_deg']:.3g} deg"
    )


def calibration_lines(calibration: Figures) -> list[str]:
    """Return what was found of the calibration in flight; nothing if it was not estimated, or by an older version."""
    found = []
    if (sigma_ms := calibration.get("time_offset_sigma_ms")) is not None:
        found.append(f"exposure {calibration['time_offset_ms']:+.2f} ± {sigma_ms:.2f} ms from the stamp")
    if (sigma_px := calibration.get("disparity_error_sigma_px")) is not None:
        found.append(f"disparity off by {calibration['disparity_error_px']:+.3f} ± {sigma_px:.3f} px")
    return [f"calibration estimated: {', '.join(found)}"] if found else []


def health_lines(quality: Figures) -> list[str]:
    """Return closures and problems; nothing if there were none."""
    counts = [
        f"{what} {count}"
        for count, what in (
            (quality["closures"], "closures"),
            (quality["restarts"], "re-initialisations"),
            (quality["relocalisations"], "relocalisations"),
            *((count, f"alarm {subject}") for subject, count in (quality["alarms"] or {}).items()),
            *((count, f"dropped {reason}") for reason, count in quality["dropped"].items()),
        )
        if count
    ]
    return [", ".join(counts)] if counts else []
