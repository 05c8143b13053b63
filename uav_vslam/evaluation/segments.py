# SPDX-License-Identifier: Apache-2.0
"""Relative errors over segments of the true path, which need no alignment: drift per distance, and by direction.

Drift (`segment_errors`): as in the KITTI odometry benchmark (Geiger, Lenz, Urtasun 2012), the mean over segments of
the error of the relative motion, per metre of the segment. Deviations: segments begin at every pose, end at the nearest
pose instead of the next, and count only if their true length is within a tenth of the wanted one (`evo` pairs so, the
tests' reference); they are divided by that true length.

By direction (`motion_error`), over the same segments: the error of the relative motion, as the toolbox of Zhang and
Scaramuzza (2018) has it, in the axes of the true world: along and across the segment's true chord, and in height.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import motion_errors, rms
from uav_vslam.search import nearest

Array = NDArray[np.float64]

KITTI_LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
SHARES = (0.1, 0.2, 0.3, 0.4, 0.5)  # of a path too short for KITTI's lengths
TOLERANCE = 0.1  # share of the length by which a segment may miss it


@dataclass(frozen=True, slots=True)
class SegmentError:
    """Mean drift over segments of one length.

    Attributes:
        length_m: wanted length of the segments [m].
        translation: error of the relative translation per metre of path [m/m]; NaN without segments.
        rotation: angle of the relative rotation's error per metre of path [rad/m].
        segments: number of segments.
    """

    length_m: float
    translation: float
    rotation: float
    segments: int


@dataclass(frozen=True, slots=True)
class MotionError:
    """Root mean square errors of the motion over segments of one length; NaN without segments.

    Attributes:
        along_m, across_m, height_m: of the displacement: along the true one's horizontal part, to its left, up [m].
        attitude_rad: angle of the relative rotation's error [rad].
        segments: number of segments.
    """

    along_m: float
    across_m: float
    height_m: float
    attitude_rad: float
    segments: int


def default_lengths_m(path_m: float) -> tuple[float, ...]:
    """Return KITTI's lengths up to the path's [m] if it has two of them, else shares of the path to two digits."""
    if path_m >= KITTI_LENGTHS_M[1]:
        return tuple(length for length in KITTI_LENGTHS_M if length <= path_m)
    return tuple(float(f"{share * path_m:.2g}") for share in SHARES if path_m > 0.0)


def segment_errors(paired: Trajectory, truth: Trajectory, lengths_m: Sequence[float]) -> list[SegmentError]:
    """Return the drift for each length.

    Args:
        paired, truth: the estimates and the true pose of each, from `pair_with_truth`.
        lengths_m: lengths of the segments, positive [m].
    """
    distance_m = distances_m(truth)
    return [_segment_error(paired, truth, distance_m, length_m) for length_m in lengths_m]


def pooled(errors: Sequence[SegmentError]) -> SegmentError:
    """Return the mean over the segments of all lengths, as KITTI ranks methods; its length is their mean."""
    counted = [error for error in errors if error.segments]
    if not counted:
        return SegmentError(float("nan"), float("nan"), float("nan"), 0)
    segments = [error.segments for error in counted]
    values = [(error.length_m, error.translation, error.rotation) for error in counted]
    length_m, translation, rotation = np.average(values, axis=0, weights=segments).tolist()
    return SegmentError(length_m, translation, rotation, sum(segments))


def motion_error(paired: Trajectory, truth: Trajectory, length_m: float) -> MotionError:
    """Return the errors by direction over segments of one length.

    Args:
        paired, truth: the estimates and the true pose of each, from `pair_with_truth`; z is up in the truth.
        length_m: length of the segments, positive [m].
    """
    first, second = _segments(distances_m(truth), length_m)
    if len(first) == 0:
        nan = float("nan")
        return MotionError(nan, nan, nan, nan, 0)
    t_error, angle = motion_errors(paired, truth, first, second)
    error = np.einsum("nij,nj->ni", truth.rotations[first], t_error)
    along, across, height = _by_direction(error, truth.positions[second] - truth.positions[first]).T
    return MotionError(rms(along), rms(across), rms(height), rms(angle), len(first))


def _by_direction(errors: Array, moved: Array) -> Array:
    """Return (N, 3) world vectors as parts along the horizontal motion, to its left, and up.

    A motion with no horizontal part counts as one along x.
    """
    heading = np.arctan2(moved[:, 1], moved[:, 0])
    c, s = np.cos(heading), np.sin(heading)
    x, y, z = errors.T
    return np.column_stack([c * x + s * y, c * y - s * x, z])


def distances_m(truth: Trajectory) -> Array:
    """Return (N,) path lengths from the first pose to each pose [m]."""
    steps = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)
    return np.concatenate([np.zeros(min(len(truth), 1)), np.cumsum(steps)])


def _segment_error(paired: Trajectory, truth: Trajectory, distance_m: Array, length_m: float) -> SegmentError:
    first, second = _segments(distance_m, length_m)
    if len(first) == 0:
        return SegmentError(length_m, float("nan"), float("nan"), 0)
    t_error, angle = motion_errors(paired, truth, first, second)
    travelled_m = distance_m[second] - distance_m[first]
    return SegmentError(
        length_m,
        translation=float(np.mean(np.linalg.norm(t_error, axis=1) / travelled_m)),
        rotation=float(np.mean(angle / travelled_m)),
        segments=len(first),
    )


def _segments(distance_m: Array, length_m: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return first and last rows: from every pose to the pose nearest to the length, if it is within the tolerance."""
    if len(distance_m) < 2:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    first = np.arange(len(distance_m) - 1)
    wanted = distance_m[first] + length_m
    second = nearest(wanted, distance_m)
    second = np.searchsorted(distance_m, distance_m[second])  # where the vehicle stands still, the first pose there
    good = (np.abs(distance_m[second] - wanted) <= TOLERANCE * length_m) & (second > first)
    return first[good], second[good]
