# SPDX-License-Identifier: Apache-2.0
"""Consensus of gated matches: one match at a time conditions the prediction of all others.

Individual gates do not protect against a large common error of the prediction: all gates are then wide and wrong
matches pass. Given one correct match, the others' predictions become precise. Each match is tried as the condition; the
largest set that passes the conditional gates wins: the one-point RANSAC of [civera10], but exhaustive.

If landmarks or attitude are uncertain, gates conditioned on one match are still wide and some wrong matches pass. Gates
conditioned on all others are narrow: matches outside them are removed, the worst first.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.geometry.stereo import STEREO_DOF
from uav_vslam.numerics import mahalanobis2

Array = NDArray[np.float64]


def consensus(nu: Array, S: Array, *, probability: float) -> NDArray[np.intp]:
    """Return the largest set of matches, each consistent with one of them and with all others.

    Args:
        nu: (N, 4) innovations [px].
        S: (4N, 4N) their joint covariance, pixel noise included [px^2].
        probability: that a correct match passes the gate conditioned on another correct one, or on all others.

    Returns:
        (K,) ascending rows.
    """
    count = len(nu)
    if count == 0:
        return np.zeros(0, np.intp)
    blocks = S.reshape(count, STEREO_DOF, count, STEREO_DOF).transpose(0, 2, 1, 3)
    own = blocks[np.arange(count), np.arange(count)]
    limit = chdtri(STEREO_DOF, 1.0 - probability)
    best = np.zeros(0, np.intp)
    for given in range(count):
        gain = blocks[:, given] @ np.linalg.inv(own[given])
        residual = nu - gain @ nu[given]
        conditional = own - gain @ blocks[given]
        conditional[given] = own[given]  # a match is consistent with itself: its residual is zero for any covariance
        distance2 = mahalanobis2(residual, conditional)
        agree = np.flatnonzero(distance2 <= limit)
        if len(agree) > len(best):
            best = agree
    coordinates = (STEREO_DOF * best[:, None] + np.arange(STEREO_DOF)).ravel()
    return best[_leave_one_out(nu[best], S[np.ix_(coordinates, coordinates)], limit)]


def _leave_one_out(nu: Array, S: Array, limit: float) -> NDArray[np.intp]:
    """Return the rows left after removing, one by one, the match farthest outside its gate conditioned on all others.

    With A = S^-1, match k has the leave-one-out residual A_kk^-1 (A nu)_k, with covariance A_kk^-1. Removing it is a
    Schur complement of A.
    """
    rows, A = np.arange(len(nu)), np.linalg.inv(S)
    while len(rows):
        pull = (A @ nu[rows].ravel()).reshape(-1, STEREO_DOF)
        own = A.reshape(len(rows), STEREO_DOF, len(rows), STEREO_DOF)[np.arange(len(rows)), :, np.arange(len(rows))]
        distance2 = mahalanobis2(pull, own)
        worst = int(np.argmax(distance2))
        if distance2[worst] <= limit:
            break
        gone = STEREO_DOF * worst + np.arange(STEREO_DOF)
        A = A - A[:, gone] @ np.linalg.solve(A[np.ix_(gone, gone)], A[gone])
        A = np.delete(np.delete(A, gone, axis=0), gone, axis=1)
        rows = np.delete(rows, worst)
    return rows
