# SPDX-License-Identifier: Apache-2.0
"""Data snooping [baarda68]: those of a set of pairs that the others do not predict are rejected, one by one.

Pairwise consistency cannot replace it: what two pairs leave open, all others together may know well.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.geometry.coded_points import diagonal_blocks
from uav_vslam.numerics import mahalanobis2, submatrix, symmetrise

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


def predicted_by_others(information: Array, residuals: Array, gate: float, *, least: int) -> Rows:
    """Reject, one by one, the pair farthest from the others' prediction; return the ascending remaining rows.

    With information B of the residuals r, pair k deviates by B_kk^-1 (B r)_k from the prediction of the others, with
    covariance B_kk^-1. Removing it is a Schur complement of B.

    Args:
        information: (3K, 3K) of all residuals together [1/m^2].
        residuals: (K, 3) differences of the pairs' landmarks [m].
        gate: largest squared Mahalanobis distance of a pair from its prediction.
        least: so many pairs are always consistent, or judged elsewhere.
    """
    B, rows = information, np.arange(len(residuals))
    while len(rows) > least:
        k = np.arange(len(rows))
        pull, own = (B @ residuals[rows].ravel()).reshape(-1, 3), diagonal_blocks(B)
        distance2 = mahalanobis2(pull, own)
        worst = int(np.argmax(distance2))
        if distance2[worst] <= gate:
            break
        gone, kept = landmark_rows(0, k[worst : worst + 1]), landmark_rows(0, np.delete(k, worst))
        gain = np.linalg.solve(own[worst], submatrix(B, gone, kept))
        B = symmetrise(submatrix(B, kept) - submatrix(B, kept, gone) @ gain)
        rows = np.delete(rows, worst)
    return rows
