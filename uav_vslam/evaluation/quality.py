# SPDX-License-Identifier: Apache-2.0
"""How good a run is without ground truth: its innovations, the frames it coasted through, and what it claims.

The innovations of a consistent filter are white, so the NIS of a frame is chi-square with its degrees of freedom, and
the sum over a run with the sum of theirs (Bar-Shalom, Li, Kirubarajan 2001, ch. 5.4). Observations outside the gate
never reach the filter: the lower bounds are reduced by what the gate takes from the mean.
"""

from collections import Counter
from collections.abc import Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtr, chdtri

from uav_vslam.evaluation.consistency import chi_square_bands
from uav_vslam.evaluation.result import VehicleResult
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.stereo import STEREO_DOF
from uav_vslam.types import NS_PER_S, FrameQuality

Array = NDArray[np.float64]
Figures = dict[str, object]

HEADING = 5  # row of a pose covariance: rotation about the map's vertical
CONSISTENT, OVER_CONFIDENT, CONSERVATIVE = "consistent", "over-confident", "conservative"


def quality_figures(vehicle: VehicleResult) -> Figures | None:
    """Return the figures of one vehicle's run for `summary.json`, None if its frames were not recorded."""
    frames = vehicle.frames
    if frames is None:
        return None
    runs = [len(list(run)) for coasted, run in groupby(frames, lambda frame: frame.coasted) if coasted]
    counts = {key: _median(frames, key) for key in ("features", "tracked", "associated", "landmarks")}
    start_ns = frames[0].stamp_ns if frames else 0
    return {
        **innovation_figures(frames),
        "frames_coasted": sum(runs),
        "coasted_longest": max(runs, default=0),
        "without_update_s": longest_without_update_s(frames),
        **{f"{key}_median": value for key, value in counts.items()},
        "downweighted": sum(frame.downweighted for frame in frames),
        "closures": sum(frame.closures for frame in frames),
        "relocalisations": sum(frame.relocalised for frame in frames),
        "restarts": sum(frame.restarted for frame in frames),
        "calibration": _calibration(frames),
        "events": [
            {"time_s": (frame.stamp_ns - start_ns) / NS_PER_S, "text": text}
            for frame in frames
            for text in frame.events
        ],
        "alarms": None if vehicle.alarms is None else alarm_counts(vehicle.alarms),
        "dropped": dict(sorted(vehicle.dropped.items())),
    }


def _calibration(frames: Sequence[FrameQuality]) -> Figures:
    """Return the last estimates of the calibration; None for what was not estimated."""
    offset = next((frame for frame in reversed(frames) if frame.time_offset_sigma_s > 0), None)
    disparity = next((frame for frame in reversed(frames) if frame.disparity_error_sigma_px > 0), None)
    return {
        "time_offset_ms": 1e3 * offset.time_offset_s if offset else None,
        "time_offset_sigma_ms": 1e3 * offset.time_offset_sigma_s if offset else None,
        "disparity_error_px": disparity.disparity_error_px if disparity else None,
        "disparity_error_sigma_px": disparity.disparity_error_sigma_px if disparity else None,
    }


def innovation_figures(frames: Sequence[FrameQuality]) -> Figures:
    """Return the pooled NIS / dof with its band and verdict, and the share of frames outside their own bands."""
    nis, dof, gate = _updates(frames)
    if len(dof) == 0:
        return {"nis_per_dof": None, "nis_band": None, "nis_verdict": None, "nis_outside_share": None}
    value, band = float(nis.sum() / dof.sum()), _pooled_band(dof, gate)
    low, high = innovation_bands(dof, gate)
    return {
        "nis_per_dof": value,
        "nis_band": list(band),
        "nis_verdict": verdict(value, band),
        "nis_outside_share": float(np.mean((nis / dof < low) | (nis / dof > high))),
    }


def innovation_bands(dof: Array, gate_probability: Array) -> tuple[Array, Array]:
    """Return the (N,) bounds of NIS / dof that 95 % of a consistent filter's frames keep.

    Args:
        dof: (N,) degrees of freedom, above zero.
        gate_probability: (N,) of the gate on each observation.
    """
    low, high = chi_square_bands(dof)
    return np.asarray(low * mean_within_gate(gate_probability)), high


def mean_within_gate(probability: Array) -> Array:
    """Return the mean of one observation's NIS / dof if only the (...) share inside the gate is used; 1 for no gate.

    The mean of a chi-square variable of n degrees of freedom below its quantile q is n F_(n+2)(q) / F_n(q).
    """
    gate = chdtri(STEREO_DOF, 1.0 - np.asarray(probability))
    return np.asarray(chdtr(STEREO_DOF + 2, gate) / probability)


def verdict(nis_per_dof: float, band: tuple[float, float]) -> str:
    """Say on which side of its band a NIS / dof is."""
    low, high = band
    return CONSERVATIVE if nis_per_dof < low else OVER_CONFIDENT if nis_per_dof > high else CONSISTENT


def longest_without_update_s(frames: Sequence[FrameQuality]) -> float:
    """Return the longest time between visual updates, from the first frame to the last [s]."""
    if not frames:
        return 0.0
    ends_ns = [frames[0].stamp_ns, *(frame.stamp_ns for frame in frames if not frame.coasted), frames[-1].stamp_ns]
    return float(np.diff(ends_ns).max()) / NS_PER_S


def alarm_counts(alarms: dict[int, tuple[str, ...]]) -> dict[str, int]:
    """Return the number of frames with each alarm."""
    return dict(sorted(Counter(subject for subjects in alarms.values() for subject in subjects).items()))


def claimed_figures(track: Trajectory, distance_m: float) -> Figures:
    """Return what an estimate claims of its last pose: standard deviations, and that of the position per 100 m flown.

    That of the position is the square root of the trace of its covariance, to be compared with an error's length.
    """
    known = track.covariance is not None and len(track) > 0
    position, heading = claimed_sigma(track) if known else (np.full(1, np.nan), np.full(1, np.nan))
    return {
        "sigma_end_m": float(position[-1]),
        "sigma_per_100m_m": float(100.0 * position[-1] / distance_m) if distance_m > 0 else None,
        "sigma_heading_end_deg": float(np.degrees(heading[-1])),
    }


def claimed_sigma(track: Trajectory) -> tuple[Array, Array]:
    """Return the (N,) claimed standard deviations of position [m] and heading [rad] of a track with a covariance."""
    assert track.covariance is not None
    variances = np.maximum(np.diagonal(track.covariance, axis1=1, axis2=2), 0.0)
    return np.sqrt(variances[:, :3].sum(axis=1)), np.sqrt(variances[:, HEADING])


def _updates(frames: Sequence[FrameQuality]) -> tuple[Array, Array, Array]:
    """Return NIS, degrees of freedom and gate of the frames with an update."""
    rows = [(frame.nis, frame.dof, frame.gate_probability) for frame in frames if frame.dof > 0]
    nis, dof, gate = np.array(rows, float).reshape(-1, 3).T
    return nis, dof, gate


def _pooled_band(dof: Array, gate_probability: Array) -> tuple[float, float]:
    low, high = chi_square_bands(dof.sum())
    kept = float(np.average(mean_within_gate(gate_probability), weights=dof))
    return float(low) * kept, float(high)


def _median(frames: Sequence[FrameQuality], key: str) -> float | None:
    return float(np.median([getattr(frame, key) for frame in frames])) if frames else None
