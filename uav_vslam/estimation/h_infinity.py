# SPDX-License-Identifier: Apache-2.0
"""The H-infinity bound of the unscented H-infinity filter; section 4.4 of [thesis], [simon06].

The filter keeps the ratio of error energy to disturbance energy below gamma^2 for any disturbance. In covariance terms
one step is P <- (P^-1 - gamma^-2 L^T L)^-1 before the update, where L picks and scales the
errors of interest. It exists only for gamma^2 > lambda_max(L P L^T). The thesis takes L = I over everything and a fixed
gamma, and its covariance turns indefinite (Eq. 4.4.4 with gamma < 2); here L is the navigation block in units of
`ERROR_SCALE`, and gamma^2 is kept well above the limit. gamma -> infinity recovers the unbounded filter.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.belief import NO_ROWS, Belief

Array = NDArray[np.float64]

ERROR_SCALE = (1.0, 0.1, 0.01)  # of position [m], velocity [m/s], attitude [rad]
MARGIN = 20.0  # least ratio of gamma^2 to the feasibility limit


def bounded(belief: Belief, gamma: float) -> tuple[Belief, float]:
    """Return the bounded belief and the ratio of gamma^2 to its feasibility limit.

    Args:
        belief: prior; its first rows are position, velocity and attitude, in every state model. Biases are not bounded.
        gamma: requested; gamma^2 is raised to at least `MARGIN` times the limit.
    """
    L = np.diag(1.0 / np.repeat(ERROR_SCALE, 3))
    P = belief.covariance(NO_ROWS)[: len(L), : len(L)]
    limit = float(np.linalg.eigvalsh(L @ P @ L.T)[-1])
    gamma2 = max(gamma**2, MARGIN * limit)
    B = np.zeros((len(L), belief.vehicle))
    B[:, : len(L)] = L / np.sqrt(gamma2)
    return belief.information_removed(B), gamma2 / limit
