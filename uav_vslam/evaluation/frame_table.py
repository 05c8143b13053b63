# SPDX-License-Identifier: Apache-2.0
"""The record of a vehicle's frames as CSV, one row a frame; the columns name their units."""

from pathlib import Path
from typing import Any

import numpy as np

from uav_vslam.evaluation.consistency import nees
from uav_vslam.evaluation.flight_tables import TIME, time_cells, write_table
from uav_vslam.evaluation.quality import HEADING, innovation_bands
from uav_vslam.evaluation.result import VehicleResult
from uav_vslam.types import FrameQuality

COUNTS = ("features", "tracked", "associated", "downweighted", "landmarks", "closures")
FLAGS = ("coasted", "relocalised", "restarted")
SIGMAS = ("sigma_east_m", "sigma_north_m", "sigma_up_m", "sigma_heading_deg")  # claimed by S-SLAM
NIS = ("nis", "dof", "nis_per_dof", "band_low", "band_high")  # empty for a frame without an update
NEES = ("nees_position", "nees_rotation")  # over 3, of S-SLAM; empty without ground truth
CALIBRATION = ("time_offset_ms", "time_offset_sigma_ms", "disparity_error_px", "disparity_error_sigma_px")
COLUMNS = (*TIME, *COUNTS, *FLAGS, *NIS, *SIGMAS, *NEES, *CALIBRATION, "alarms", "events")


def write_frames(vehicle: VehicleResult, path: Path) -> None:
    """Write the frames of a vehicle that were recorded."""
    frames, sigmas, errors = vehicle.frames or (), _sigmas(vehicle), _nees(vehicle)
    alarms = vehicle.alarms or {}
    rows = (
        (
            *time_cells(frame.stamp_ns, vehicle.start_ns),
            *(getattr(frame, name) for name in COUNTS),
            *(int(getattr(frame, name)) for name in FLAGS),
            *_innovation(frame),
            *sigmas.get(frame.stamp_ns, [""] * len(SIGMAS)),
            *errors.get(frame.stamp_ns, [""] * len(NEES)),
            *_calibration(frame),
            "; ".join(alarms.get(frame.stamp_ns, ())),
            "; ".join(frame.events),
        )
        for frame in frames
    )
    write_table(path, COLUMNS, rows)


def _innovation(frame: FrameQuality) -> list[Any]:
    if frame.dof == 0:
        return [""] * len(NIS)
    low, high = innovation_bands(np.array([float(frame.dof)]), np.array([frame.gate_probability]))
    return [f"{frame.nis:.6g}", frame.dof, *(f"{value:.6g}" for value in (frame.nis / frame.dof, low[0], high[0]))]


def _calibration(frame: FrameQuality) -> list[str]:
    """Return the estimates with their standard deviations; empty where nothing is estimated."""
    offset_ms = 1e3 * frame.time_offset_s, 1e3 * frame.time_offset_sigma_s
    pairs = offset_ms, (frame.disparity_error_px, frame.disparity_error_sigma_px)
    return [f"{value:.6g}" if sigma > 0 else "" for mean, sigma in pairs for value in (mean, sigma)]


def _sigmas(vehicle: VehicleResult) -> dict[int, list[str]]:
    """Return the claimed standard deviations as text by stamp."""
    track = vehicle.s_slam
    if track.covariance is None:
        return {}
    sigma = np.sqrt(np.maximum(np.diagonal(track.covariance, axis1=1, axis2=2), 0.0))[:, [0, 1, 2, HEADING]]
    sigma[:, 3] = np.degrees(sigma[:, 3])
    rows = zip(track.stamps_ns.tolist(), sigma, strict=True)
    return {stamp_ns: [f"{value:.6g}" for value in row] for stamp_ns, row in rows}


def _nees(vehicle: VehicleResult) -> dict[int, list[str]]:
    """Return the NEES of position and attitude as text by stamp."""
    values = None if vehicle.truth is None else nees(vehicle.s_slam, vehicle.truth)
    if values is None:
        return {}
    rows = zip(values.stamps_ns.tolist(), values.position, values.rotation, strict=True)
    return {stamp_ns: [f"{position:.6g}", f"{rotation:.6g}"] for stamp_ns, position, rotation in rows}
