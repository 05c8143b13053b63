# SPDX-License-Identifier: Apache-2.0
"""Absolute and relative trajectory errors (Sturm et al. 2012; definitions as in `evo`, the tests' reference)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.alignment import ALIGNMENTS
from uav_vslam.evaluation.pairing import pair_with_truth
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.search import nearest

Array = NDArray[np.float64]

DELTA_TOLERANCE = 0.1  # share of the delta by which the two poses of a pair may miss it


@dataclass(frozen=True, slots=True)
class AbsoluteError:
    """Position error over a flight.

    Attributes:
        ate_m: root mean square of the distances [m].
        end_m: distance at the last pair [m].
        max_m: largest distance [m].
        height_rms_m: root mean square of the errors of the height, z [m].
        height_step_m: largest change of the height's error from one pose to the next [m]; 0 for a single pose.
        rotation_rms_rad: root mean square of the angles [rad].
        pairs: number of estimates with ground truth.
    """

    ate_m: float
    end_m: float
    max_m: float
    height_rms_m: float
    height_step_m: float
    rotation_rms_rad: float
    pairs: int


@dataclass(frozen=True, slots=True)
class RelativeError:
    """Drift over a time.

    Attributes:
        translation_rms_m: root mean square of the relative translations' errors [m].
        rotation_rms_rad: root mean square of the relative rotations' errors [rad].
        pairs: number of pairs.
    """

    translation_rms_m: float
    rotation_rms_rad: float
    pairs: int


def absolute_error(estimate: Trajectory, truth: Trajectory, *, alignment: str = "none") -> AbsoluteError | None:
    """Compare an estimate with the truth.

    Args:
        estimate, truth: trajectories; in one frame unless aligned.
        alignment: a name of `ALIGNMENTS`: transform of the whole estimate that is removed.

    Returns:
        The errors, or None if no estimate has ground truth.
    """
    if alignment not in ALIGNMENTS:
        raise ValueError(f"alignment {alignment!r} is not known; use one of {', '.join(ALIGNMENTS)}")
    paired, reference = pair_with_truth(estimate, truth)
    if len(paired) == 0:
        return None
    T_truth_estimate = ALIGNMENTS[alignment](paired.positions, reference.positions)
    error = T_truth_estimate.apply(paired.positions) - reference.positions
    distance = np.linalg.norm(error, axis=1)
    angle = _angles(reference.rotations.transpose(0, 2, 1) @ T_truth_estimate.R @ paired.rotations)
    return AbsoluteError(
        ate_m=rms(distance),
        end_m=float(distance[-1]),
        max_m=float(distance.max()),
        height_rms_m=rms(error[:, 2]),
        height_step_m=float(np.abs(np.diff(error[:, 2])).max(initial=0.0)),
        rotation_rms_rad=rms(angle),
        pairs=len(paired),
    )


def relative_error(estimate: Trajectory, truth: Trajectory, *, delta_s: float) -> RelativeError | None:
    """Compare the motion over a time, from every pose, with the true one: E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j).

    Args:
        estimate, truth: trajectories; alignment doesn't matter.
        delta_s: from the first to the second pose, which is the nearest to it [s].

    Returns:
        The errors, or None if no two poses are that far apart.
    """
    if not delta_s > 0:
        raise ValueError(f"delta_s = {delta_s} must be positive")
    paired, reference = pair_with_truth(estimate, truth)
    first, second = _index_pairs(paired.stamps_ns, delta_s)
    if len(first) == 0:
        return None
    t_error, angle = motion_errors(paired, reference, first, second)
    return RelativeError(
        translation_rms_m=rms(np.linalg.norm(t_error, axis=1)),  # R_true^T doesn't change a length
        rotation_rms_rad=rms(angle),
        pairs=len(first),
    )


def _index_pairs(stamps_ns: NDArray[np.int64], delta_s: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return first and second rows of all pairs, within `DELTA_TOLERANCE` of the delta."""
    rows = np.arange(len(stamps_ns))
    if len(rows) < 2:
        return rows[:0], rows[:0]
    wanted = stamps_ns + round(delta_s * 1e9)
    second = nearest(wanted, stamps_ns)
    near = np.abs(stamps_ns[second] - wanted) <= round(DELTA_TOLERANCE * delta_s * 1e9)
    good = near & (wanted <= stamps_ns[-1]) & (second > rows)
    return rows[good], second[good]


def motion_errors(
    estimate: Trajectory, truth: Trajectory, first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Return errors of T_first_second for each pair of rows: (N, 3) translation [m], and (N,) angle [rad]."""
    R_moved, t_moved = _motion(estimate, first, second)
    R_true, t_true = _motion(truth, first, second)
    return t_moved - t_true, _angles(R_true.transpose(0, 2, 1) @ R_moved)


def _motion(trajectory: Trajectory, first: NDArray[np.intp], second: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return rotation and translation of T_first_second for each pair of rows."""
    R, p = trajectory.rotations, trajectory.positions
    R_first_map = R[first].transpose(0, 2, 1)
    return R_first_map @ R[second], np.einsum("nij,nj->ni", R_first_map, p[second] - p[first])


def _angles(R: Array) -> Array:
    """Return the (N,) angles [rad] of (N, 3, 3) rotations."""
    return np.asarray(np.linalg.norm(so3_log(R), axis=-1))


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
