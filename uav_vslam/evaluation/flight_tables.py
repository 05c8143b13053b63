# SPDX-License-Identifier: Apache-2.0
"""Tables of a vehicle's flight as CSV: traffic by epoch, time by frame, landmarks; the columns name their units."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uav_vslam.types import NS_PER_S, LinkEpoch, MappedLandmarks

TIME = ("stamp_ns", "time_s")
TRAFFIC = ("packets_sent", "bytes_sent", "packets_received", "bytes_received", "packets_used")  # since the start
COVARIANCE = ("cov_x_x", "cov_x_y", "cov_x_z", "cov_y_y", "cov_y_z", "cov_z_z")
UPPER = np.triu_indices(3)


def write_link(epochs: Sequence[LinkEpoch], path: Path, *, start_ns: int) -> Path:
    """Write the traffic of a vehicle up to each fusion epoch, one row an epoch; its time counts from `start_ns`."""
    rows = ((*time_cells(epoch.stamp_ns, start_ns), *(getattr(epoch, name) for name in TRAFFIC)) for epoch in epochs)
    return write_table(path, (*TIME, *TRAFFIC), rows)


def write_timing(stage_s: Mapping[str, Mapping[int, float]], path: Path, *, start_ns: int) -> Path:
    """Write each stage's processor time on each frame [ms], empty for a stage that did not run.

    The time of a frame counts from `start_ns`, and is negative before.
    """
    stamps_ns = sorted({stamp_ns for seconds in stage_s.values() for stamp_ns in seconds})
    rows = (
        (
            *time_cells(stamp_ns, start_ns),
            *(f"{1000.0 * seconds[stamp_ns]:.3f}" if stamp_ns in seconds else "" for seconds in stage_s.values()),
        )
        for stamp_ns in stamps_ns
    )
    return write_table(path, (*TIME, *(f"{stage}_ms" for stage in stage_s)), rows)


def write_landmarks(landmarks: MappedLandmarks, path: Path) -> Path:
    """Write each landmark in the map frame, with its covariance [m^2]."""
    rows = zip(landmarks.ids.tolist(), landmarks.positions.tolist(), landmarks.covariances, strict=True)
    cells = ((key, *(f"{x:.4f}" for x in p), *(f"{x:.6g}" for x in P[UPPER].tolist())) for key, p, P in rows)
    return write_table(path, ("id", "x_m", "y_m", "z_m", *COVARIANCE), cells)


def time_cells(stamp_ns: int, start_ns: int) -> tuple[int, str]:
    """Return the stamp, and the time since `start_ns` [s]."""
    return stamp_ns, f"{(stamp_ns - start_ns) / NS_PER_S:.6f}"


def write_table(path: Path, titles: Sequence[str], rows: Iterable[Sequence[Any]]) -> Path:
    """Write rows of cells below their titles."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(titles)
        writer.writerows(rows)
    return path
