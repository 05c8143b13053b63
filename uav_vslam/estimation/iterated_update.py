# SPDX-License-Identifier: Apache-2.0
"""An update by landmarks, linearised again where it leads far from the mean, as in an iterated Kalman filter."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation.belief import Indices, Observation, Update
from uav_vslam.estimation.mean import Mean
from uav_vslam.estimation.weighted_update import huber_loss
from uav_vslam.geometry.pose import Pose
from uav_vslam.numerics import mahalanobis2

Array = NDArray[np.float64]

RELINEARISATIONS = 4  # at most
NEAR = 0.03  # of the landmarks' depth: an update that moves the position by less is linear enough


@dataclass(frozen=True, slots=True)
class Correction:
    """An update that is not applied yet.

    Attributes:
        mean: that it is linearised at.
        delta: (vehicle + 3N,) correction of that mean.
        update: of the belief about it.
        outliers: rows of the observations that the robust kernel has down-weighted.
        observation: of M landmarks, not whitened, about that mean.
        R: (M, 4, 4) its noise [px^2].
        weights: (M,) divide that.
    """

    mean: Mean
    delta: Array
    update: Update
    outliers: Indices
    observation: Observation
    R: Array
    weights: Array

    def cost(self, residual: Array) -> float:
        """Return the squared errors of the prior and, by Huber's kernel, of what is really left (M, 4) [px]."""
        R, predicted = self.R / self.weights[:, None, None], self.observation.nu - self.observation.apply(self.delta)
        really, linearly = (float(huber_loss(mahalanobis2(left, R)).sum()) for left in (residual, predicted))
        return self.update.nis + really - linearly


def iterated(
    first: Correction,
    *,
    depth_m: float,
    leads_to: Callable[[Correction], Pose],
    correct: Callable[[Pose], Correction],
    cost: Callable[[Correction], float],
) -> Correction:
    """Return an update linearised where it leads to, if that is far away and explains the pixels better.

    Args:
        first: linearised at the mean.
        depth_m: of the landmarks; NaN, as where pixels are, counts as near.
        leads_to: pose after an update.
        correct: computes the update linearised at a pose.
        cost: what is left of squared errors after an update, those of the prior included.
    """
    best, least = first, np.inf
    for _ in range(RELINEARISATIONS):
        there = leads_to(best)
        if not np.linalg.norm(there.t - best.mean.nav.T_map_body.t) > NEAR * depth_m:
            break
        if best is first:
            least = cost(first)
        try:
            again = correct(there)
        except (FilterDivergence, np.linalg.LinAlgError):  # too far
            break
        if not (left := cost(again)) < least:
            break
        best, least = again, left
    return best
