# SPDX-License-Identifier: Apache-2.0
"""Reads a trajectory file; the format is recognised by the content.

    TUM       stamp x y z qx qy qz qw                       separated by white space; stamps in seconds
    KITTI     the 12 numbers of the upper rows of T_world_camera, row by row; no stamps; x right, y down, z forward
    EuRoC     stamp_ns, x, y, z, qw, qx, qy, qz, ...        separated by commas; further columns are left out

A title that names the quaternion's parts in the order x, y, z, w is honoured in a file with commas, as are stamps in
seconds with a decimal point. Columns called cov_… hold the covariance, as `writing.write_csv` writes it.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import TrajectoryFileError
from uav_vslam.evaluation.files.kitti_axes import from_kitti
from uav_vslam.evaluation.files.rows import Rows, read_rows
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation

Array = NDArray[np.float64]

TUM_COLUMNS, KITTI_COLUMNS, CSV_COLUMNS = 8, 12, 8
UPPER = np.triu_indices(6)  # the cells of a covariance that a file holds
KITTI_PERIOD_NS = 100_000_000  # KITTI's cameras run at 10 Hz
ROUNDING = 0.01  # of the length of a quaternion and of a rotation matrix's rows


def read_trajectory(
    path: Path, *, times: Path | None = None, reference: Trajectory | None = None, numbered: bool = False
) -> Trajectory:
    """Read a trajectory.

    Args:
        path: the file.
        times: a file with a stamp a line [s], for KITTI; None for NAME_times.txt beside it, if there is one.
        reference: gives a KITTI file without times its stamps, where both have the same number of poses.
        numbered: gives a KITTI file without both the stamps of 10 Hz; they only serve to pair the rows of two files.

    Raises:
        TrajectoryFileError: the file is missing or malformed, or has no stamps; the text names the line.
    """
    rows = read_rows(path)
    if _has_kitti_columns(rows):
        return _kitti(rows, _kitti_stamps(rows, times, reference, numbered=numbered))
    if not rows.commas and rows.columns == TUM_COLUMNS:
        return _poses(rows, rows.stamps_ns(seconds=True), wxyz=_has_title_wxyz(rows))
    if rows.commas and rows.columns >= CSV_COLUMNS:
        return _csv(rows)
    raise TrajectoryFileError(
        f"{rows.at(0)}: {rows.columns} columns are no pose; expected 8 (TUM: stamp x y z qx qy qz qw), 12 (KITTI), or "
        "8 or more with commas (EuRoC: stamp,x,y,z,qw,qx,qy,qz,...)"
    )


def times_beside(path: Path) -> Path:
    """Return where `export` writes the stamps of a KITTI file."""
    return path.with_name(f"{path.stem}_times.txt")


def is_kitti(path: Path) -> bool:
    """Return whether a trajectory file is KITTI's, which has no stamps of its own."""
    return _has_kitti_columns(read_rows(path))


def _has_kitti_columns(rows: Rows) -> bool:
    return not rows.commas and rows.columns == KITTI_COLUMNS


def _csv(rows: Rows) -> Trajectory:
    seconds = any("." in cells[0] for cells in rows.cells)
    found = _poses(rows, rows.stamps_ns(seconds=seconds), wxyz=_is_wxyz(rows))
    first = next((k for k, name in enumerate(rows.header) if name.startswith("cov_")), None)
    if first is None:
        return found
    if rows.columns != first + len(UPPER[0]):
        raise TrajectoryFileError(
            f"{rows.at(0)}: {rows.columns - first} columns of covariance, expected {len(UPPER[0])}"
        )
    covariance = np.zeros((len(found), 6, 6))
    covariance[:, UPPER[0], UPPER[1]] = covariance[:, UPPER[1], UPPER[0]] = rows.numbers(first, rows.columns)
    return Trajectory(found.stamps_ns, found.positions, found.quaternions_wxyz, covariance)


def _has_title_wxyz(rows: Rows) -> bool:
    """Return whether a TUM file has a title, not just any comment, that names the quaternion's real part first."""
    return len(rows.header) == TUM_COLUMNS and rows.header[4].lower() in {"qw", "q_w", "w"}


def _is_wxyz(rows: Rows) -> bool:
    """Return whether the quaternion's real part is first, as in EuRoC's files and where no title says."""
    if len(rows.header) < CSV_COLUMNS:
        return True
    name = rows.header[4].partition("[")[0].strip().lower()
    if not name.endswith(("w", "x")):
        raise TrajectoryFileError(
            f"{rows.path}: column 5 is called {rows.header[4]!r}; expected q_w (or q_x) of an orientation after "
            "stamp, x, y, z"
        )
    return name.endswith("w")


def _poses(rows: Rows, stamps_ns: NDArray[np.int64], *, wxyz: bool) -> Trajectory:
    values = rows.numbers(1, 8)
    quaternions = values[:, 3:] if wxyz else values[:, [6, 3, 4, 5]]
    length = np.linalg.norm(quaternions, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > ROUNDING)
    if len(wrong):
        raise TrajectoryFileError(
            f"{rows.at(wrong[0])}: the quaternion in columns 5 to 8 has length {length[wrong[0]]:.3g}, expected 1; "
            "check the order of the columns"
        )
    return Trajectory(stamps_ns, values[:, :3].copy(), quaternions / length[:, None])


def _kitti(rows: Rows, stamps_ns: NDArray[np.int64]) -> Trajectory:
    T = rows.numbers(0, KITTI_COLUMNS).reshape(-1, 3, 4)
    R = T[:, :, :3]
    off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    wrong = np.flatnonzero((off > ROUNDING) | (np.linalg.det(R) < 0.0))
    if len(wrong):
        raise TrajectoryFileError(
            f"{rows.at(wrong[0])}: columns 1-3, 5-7 and 9-11 are not a rotation; expected KITTI's r11 r12 r13 x r21 ..."
        )
    positions, rotations = from_kitti(T[:, :, 3], R)
    return Trajectory(stamps_ns, positions, quaternion_wxyz_from_rotation(rotations))


def _kitti_stamps(rows: Rows, times: Path | None, reference: Trajectory | None, *, numbered: bool) -> NDArray[np.int64]:
    count, beside = len(rows.cells), times_beside(rows.path)
    if times is None and beside.is_file():
        times = beside
    if times is not None:
        found = read_rows(times)
        if found.columns != 1 or len(found.cells) != count:
            raise TrajectoryFileError(
                f"{times}: {len(found.cells)} lines of {found.columns} columns, but {rows.path} has {count} poses; "
                "expected one stamp [s] for each"
            )
        return found.stamps_ns(seconds=True)
    if reference is not None and len(reference) == count:
        return reference.stamps_ns
    if reference is None and numbered:
        return KITTI_PERIOD_NS * np.arange(count, dtype=np.int64)
    known = "" if reference is None else f", and its {count} poses are not the {len(reference)} of the ground truth"
    raise TrajectoryFileError(f"{rows.path} is a KITTI file, which has no stamps{known}; give --times FILE")
