# SPDX-License-Identifier: Apache-2.0
"""Which gated matches agree with one another: one match at a time conditions the prediction of all the others.

A gate alone is no protection when the whole prediction may be off together: then every landmark has a wide gate, and
wrong matches slip in. But given one right match the others' predictions become sharp. Each match is tried as that one
(so nothing is drawn at random), and the largest set that passes the conditional gates wins; after the one-point RANSAC
of [civera10], which draws.

One match leaves the others' gates wide where the landmarks themselves are vague or the attitude is, so a few wrong ones
pass together with the right ones. All others together leave a narrow one: who does not pass that goes, the worst first.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.association.guided import STEREO_DOF
from uav_vslam.numerics import mahalanobis2

Array = NDArray[np.float64]


def consensus(nu: Array, S: Array, *, probability: float) -> NDArray[np.intp]:
    """Return the largest set of matches that agree, each with one of them and with all the others.

    Args:
        nu: (N, 4) innovations [px].
        S: (4N, 4N) their joint covariance, pixel noise included [px^2].
        probability: that a right match passes the gate that another right match leaves, or all the others.

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
        left = nu - gain @ nu[given]
        sharp = own - gain @ blocks[given]
        sharp[given] = own[given]  # nothing is left of itself: left is zero there, whatever the covariance
        distance2 = mahalanobis2(left, sharp)
        agree = np.flatnonzero(distance2 <= limit)
        if len(agree) > len(best):
            best = agree
    coordinates = (STEREO_DOF * best[:, None] + np.arange(STEREO_DOF)).ravel()
    return best[_supported(nu[best], S[np.ix_(coordinates, coordinates)], limit)]


def _supported(nu: Array, S: Array, limit: float) -> NDArray[np.intp]:
    """Return the rows that remain when the match farthest outside the gate that all others leave goes, again and again.

    With A = S^-1, match k lies A_kk^-1 (A nu)_k off what the others predict, with covariance A_kk^-1. Taking it out is
    a Schur complement of A.
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
