# SPDX-License-Identifier: Apache-2.0
"""Consistency: normalised estimation error squared, NEES (Bar-Shalom, Li, Kirubarajan 2001, ch. 5.4).

All NEES here are divided by their 3 degrees of freedom: 1 is consistent, more is over-confident, less is conservative.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from uav_vslam.evaluation.attitude import lacks_attitude
from uav_vslam.evaluation.pairing import pair_with_truth
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import so3_log

Array = NDArray[np.float64]

DOF = 3
SKIPPED_KEYFRAMES = 20  # their covariance reflects the assumed start state more than the filter


@dataclass(frozen=True, slots=True)
class Nees:
    """NEES at every keyframe with ground truth.

    Attributes:
        stamps_ns: (N,) of the keyframes [ns].
        position: (N,) e^T P^-1 e / 3 of the position; NaN where P is not positive definite.
        rotation: (N,) the same for the map-frame rotation vector xi, R_true = Exp(xi) R; all NaN where the ground truth
            has no attitude.
    """

    stamps_ns: NDArray[np.int64]
    position: Array
    rotation: Array


@dataclass(frozen=True, slots=True)
class NeesSummary:
    """NEES of one run.

    Attributes:
        mean: over the keyframes after the 20th; NaN where there are none.
        end: at the last keyframe.
        invalid: keyframes whose covariance is not positive definite; they make the mean NaN.
    """

    mean: float
    end: float
    invalid: int


def nees(estimate: Trajectory, truth: Trajectory) -> Nees | None:
    """Return the NEES of position and rotation, or None without a covariance or ground truth."""
    paired, reference = pair_with_truth(estimate, truth)
    if paired.covariance is None or len(paired) == 0:
        return None
    position_error = reference.positions - paired.positions
    rotation_error = so3_log(reference.rotations @ paired.rotations.transpose(0, 2, 1))
    rotation = normalised(rotation_error, paired.covariance[:, 3:, 3:])
    if lacks_attitude(truth, estimate):
        rotation = np.full(len(paired), np.nan)
    return Nees(paired.stamps_ns, normalised(position_error, paired.covariance[:, :3, :3]), rotation)


def normalised(error: Array, covariance: Array) -> Array:
    """Return e^T P^-1 e / 3 for (N, 3) errors and (N, 3, 3) covariances; NaN where P is not positive definite."""
    P = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    finite = np.asarray(np.isfinite(P).all(axis=(1, 2)))
    P = np.where(finite[:, None, None], P, -np.eye(DOF))
    definite = np.linalg.eigvalsh(P)[:, 0] > 0
    P = np.where(definite[:, None, None], P, np.eye(DOF))
    whitened = np.linalg.solve(np.linalg.cholesky(P), error[..., None])[..., 0]
    return np.where(definite, np.sum(whitened**2, axis=1) / DOF, np.nan)


def summarise(values: Array) -> NeesSummary:
    """Return the mean of (N,) NEES after the first `SKIPPED_KEYFRAMES`, and the last value."""
    counted = values[SKIPPED_KEYFRAMES:]
    mean = float(np.mean(counted)) if len(counted) else float("nan")
    end = float(values[-1]) if len(values) else float("nan")
    return NeesSummary(mean, end, int(np.isnan(values).sum()))


def chi_square_band(runs: int, *, probability: float = 0.95) -> tuple[float, float]:
    """Return the two-sided band for the mean of `runs` independent NEES / DOF of a consistent filter.

    The sum over runs is chi-square with runs * DOF degrees of freedom. Keyframes of one run are correlated: the band
    holds for one keyframe over many runs, not for the mean over a run.
    """
    low, high = chi_square_bands(np.array(runs * DOF), probability=probability)
    return float(low), float(high)


def chi_square_bands(degrees: Array, *, probability: float = 0.95) -> tuple[Array, Array]:
    """Return the two-sided bands of chi-square variables over their (...) degrees of freedom, all above zero."""
    half = 0.5 * (1.0 - probability)
    low, high = (2.0 * gammaincinv(0.5 * degrees, share) / degrees for share in (half, 1.0 - half))
    return np.asarray(low), np.asarray(high)
