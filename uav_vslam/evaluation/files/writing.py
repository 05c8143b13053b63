# SPDX-License-Identifier: Apache-2.0
"""Writes trajectories as TUM, as CSV in EuRoC's order with covariance, and as KITTI; figures as JSON."""

import json
from collections.abc import Iterable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from uav_vslam.evaluation.files.kitti_axes import to_kitti
from uav_vslam.evaluation.files.reading import UPPER, times_beside
from uav_vslam.evaluation.files.whole import whole
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.types import NS_PER_S

POSE_TITLES = ("#stamp_ns", "x_m", "y_m", "z_m", "q_w", "q_x", "q_y", "q_z")
ERROR_PARTS = ("x", "y", "z", "rx", "ry", "rz")  # of a covariance: position, map-frame rotation vector
COVARIANCE_TITLES = tuple(f"cov_{ERROR_PARTS[i]}_{ERROR_PARTS[j]}" for i, j in zip(*UPPER, strict=True))


def write_json(path: Path, tree: dict[str, Any]) -> None:
    """Write a tree as JSON, which holds neither NaN nor infinity."""
    text = json.dumps(tree, indent=2, allow_nan=False) + "\n"
    with whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_tum(trajectory: Trajectory, path: Path) -> Path:
    """Write `stamp x y z qx qy qz qw`, as read by evo and most tools; stamps are exact."""
    w, x, y, z = trajectory.quaternions_wxyz.T
    rows = zip(trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), x, y, z, w, strict=True)
    return _write(path, (f"{_seconds(stamp)} {_decimals(p, 9)} {_decimals(q, 12)}\n" for stamp, p, *q in rows))


def write_csv(trajectory: Trajectory, path: Path) -> Path:
    """Write EuRoC's columns `stamp_ns,x,y,z,qw,qx,qy,qz`, then the upper triangle of the covariance if it is known."""
    titles = POSE_TITLES if trajectory.covariance is None else POSE_TITLES + COVARIANCE_TITLES
    return _write(path, [",".join(titles) + "\n", *_csv_rows(trajectory)])


def write_kitti(trajectory: Trajectory, path: Path) -> Path:
    """Write the 12 numbers of each pose in KITTI's axes, and the stamps [s] into `<name>_times.txt` beside it."""
    positions, rotations = to_kitti(trajectory.positions, trajectory.rotations)
    T = np.concatenate([rotations, positions[:, :, None]], axis=2).reshape(-1, 12)
    _write(times_beside(path), (f"{_seconds(stamp)}\n" for stamp in trajectory.stamps_ns.tolist()))
    return _write(path, (" ".join(f"{value:.12e}" for value in row) + "\n" for row in T.tolist()))


def _csv_rows(trajectory: Trajectory) -> Iterable[str]:
    rows = zip(
        trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), trajectory.quaternions_wxyz.tolist(), strict=True
    )
    for k, (stamp, p, q) in enumerate(rows):
        numbers = [*(f"{value:.9f}" for value in p), *(f"{value:.12f}" for value in q)]
        if trajectory.covariance is not None:
            numbers += [f"{value:.12e}" for value in trajectory.covariance[k][UPPER].tolist()]
        yield f"{stamp},{','.join(numbers)}\n"


def _write(path: Path, lines: Iterable[str]) -> Path:
    with whole(path) as partial:
        partial.write_text("".join(lines), encoding="ascii")
    return path


def _seconds(stamp_ns: int) -> str:
    return f"{Decimal(stamp_ns) / NS_PER_S:.9f}"


def _decimals(values: Iterable[float], digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)
