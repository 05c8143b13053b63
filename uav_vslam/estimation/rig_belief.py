# SPDX-License-Identifier: Apache-2.0
"""What a belief says about the rig's calibration: how far the disparity may be off, and the evidence against it.

Until the motion makes a wrong calibration likely, the estimate takes the right one for granted, which is more accurate.
What it claims must not: see `DisparityPrior`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from uav_vslam.estimation.belief import NO_ROWS, Belief
from uav_vslam.estimation.rig_errors import RigErrors, RigState
from uav_vslam.numerics import submatrix, symmetrise

Array = NDArray[np.float64]

MIN_VARIANCE_REDUCTION = 1e-6  # share of the prior variance: below it, a direction of the rig is unobserved
TOLERATED_RAD = np.deg2rad(0.001)  # attitude that a right calibration may be off by: 0.005 px at the edge of an image


@dataclass(frozen=True, slots=True)
class DisparityEstimate:
    """What is known of the disparity's constant error.

    Attributes:
        mean_px, sigma_px: estimate and standard deviation [px].
        miscalibrated: probability that the calibration is wrong.
    """

    mean_px: float
    sigma_px: float
    miscalibrated: float


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """Mean and standard deviation of exposure minus stamp, by the IMU's clock [s]."""

    mean_s: float
    sigma_s: float


def disparity_variance(belief: Belief, errors: RigErrors) -> float:
    """Return the variance of the disparity's error, which must be a state [px^2]."""
    row = errors.disparity.start
    return float(belief.covariance(NO_ROWS)[row, row])


def claimed_variance(variance: float, errors: RigErrors, disparity_px: float) -> float:
    """Return how far an estimate of the disparity's error, with that variance, may be off in mean square [px^2]."""
    return errors.disparity_prior.mean_square(disparity_px, variance, prior=errors.disparity_variance)


def claimed_covariance(belief: Belief, errors: RigErrors, state: RigState) -> Array:
    """Return the covariance (vehicle, vehicle) with the uncertainty of the calibration."""
    P = belief.covariance(NO_ROWS)
    return with_claims(P, errors.disparity.start, errors, state.disparity_px) if errors.has_disparity else P


def with_claims(P: Array, row: int, errors: RigErrors, disparity_px: float) -> Array:
    """Return the (n, n) covariance `P` with the uncertainty of the calibration; `row` is the disparity's error's."""
    variance = float(P[row, row])
    effect = P[:, row] / variance
    claimed = claimed_variance(variance, errors, disparity_px)
    return P + (claimed - variance) * np.outer(effect, effect)


def claimed_belief(belief: Belief, errors: RigErrors, state: RigState) -> Belief:
    """Return the belief with the uncertainty of the calibration."""
    if not errors.has_disparity:
        return belief
    variance = disparity_variance(belief, errors)
    claimed = claimed_variance(variance, errors, state.disparity_px)
    return belief.information_changed(errors.disparity.start, 1.0 / claimed - 1.0 / variance)


def rig_evidence(belief: Belief, errors: RigErrors, state: RigState) -> float:
    """Return the test statistic of the calibration, chi-square with a degree of freedom per state of `calibrated`.

    Under a correct prior the estimate has covariance P_0 - P, and an error e that is tolerated moves it by
    (P_0 - P) P_0^-1 e. Zero without such states.
    """
    rows = errors.calibrated
    prior = submatrix(errors.prior_covariance, rows - errors.rows.start)
    learnt = symmetrise(prior - submatrix(belief.covariance(NO_ROWS), rows))
    values, vectors = eigh(learnt, prior)
    known = values > MIN_VARIANCE_REDUCTION
    values, vectors = values[known], vectors[:, known]
    of_attitude = np.isin(rows, np.r_[errors.attitude])
    moved = TOLERATED_RAD * values[:, None] * vectors[of_attitude].T
    along = vectors.T @ errors.calibration(state)
    return float(along @ np.linalg.solve(np.diag(values) + moved @ moved.T, along))
