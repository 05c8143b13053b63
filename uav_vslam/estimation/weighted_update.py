# SPDX-License-Identifier: Apache-2.0
"""Weighted stereo observations, and the consistency of an update with the prediction."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.estimation.belief import NO_ROWS, Indices, Observation, VehicleObservation
from uav_vslam.estimation.linearisation import PredictedObservation
from uav_vslam.geometry.stereo import STEREO_DOF

Array = NDArray[np.float64]

HUBER_PROBABILITY = 0.999  # of a correct observation to keep full weight
HUBER_BOUND = np.sqrt(chdtri(STEREO_DOF, 1.0 - HUBER_PROBABILITY))


@dataclass(frozen=True, slots=True)
class Innovation:
    """Consistency of an update with the prediction.

    Attributes:
        nis: nu^T S^-1 nu, chi-square with `dof` degrees of freedom.
        dof: number of pixel coordinates.
        accepted: whether the update was applied.
        outliers: rows of the observations that the robust kernel has down-weighted.
    """

    nis: float
    dof: int
    accepted: bool = True
    outliers: Indices = field(default_factory=NO_ROWS.copy)

    @property
    def downweighted(self) -> int:
        """Number of observations down-weighted."""
        return len(self.outliers)


def whitened(
    predicted: PredictedObservation, nu: Array, weights: Array, *, of_vehicle: VehicleObservation | None = None
) -> Observation:
    """Return the observation with unit noise: divided by the factor of R, times the square root of its weight.

    Args:
        predicted: of M landmarks.
        nu: (M, 4) innovations [px].
        weights: (M,) divide the noise variance.
        of_vehicle: further observations, of the vehicle alone.
    """
    L_inv = np.linalg.inv(np.linalg.cholesky(predicted.R)) * np.sqrt(weights)[:, None, None]
    return Observation(
        predicted.landmarks,
        L_inv @ predicted.H_vehicle,
        L_inv @ predicted.H_landmark,
        np.einsum("nij,nj->ni", L_inv, nu),
        of_vehicle,
    )


def huber_weights(observation: Observation, delta: Array) -> Array:
    """Return the (M,) weights of Huber's kernel [huber64], 1 or less, for the residuals at a correction `delta`."""
    residual = np.linalg.norm(observation.nu - observation.apply(delta), axis=1)
    return np.asarray(np.minimum(1.0, HUBER_BOUND / np.maximum(residual, 1e-12)))


def huber_loss(residual2: Array) -> Array:
    """Return Huber's loss of squared residuals over their noise: themselves, or linear in the root beyond the bound."""
    return np.where(residual2 < HUBER_BOUND**2, residual2, HUBER_BOUND * (2.0 * np.sqrt(residual2) - HUBER_BOUND))
