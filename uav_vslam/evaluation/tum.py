# SPDX-License-Identifier: Apache-2.0
"""Trajectories as TUM text: `stamp x y z qx qy qz qw`, as read by evo and most tools."""

from pathlib import Path

from uav_vslam.evaluation.trajectory import Trajectory


def write_tum(trajectory: Trajectory, path: Path) -> Path:
    """Write a trajectory; stamps in seconds are printed from integer nanoseconds, without rounding."""
    w, x, y, z = trajectory.quaternions_wxyz.T
    rows = zip(trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), x, y, z, w, strict=True)
    lines = [f"{_seconds(stamp)} {_decimals(p, 9)} {_decimals(q, 12)}\n" for stamp, p, *q in rows]
    path.write_text("".join(lines), encoding="ascii")
    return path


def _seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 1_000_000_000}.{stamp_ns % 1_000_000_000:09d}"


def _decimals(values: list[float], digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)
