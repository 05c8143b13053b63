# SPDX-License-Identifier: Apache-2.0
"""Encoding of points and their covariance, so that the decoded covariance bounds the exact one.

A scalar factor in the packet compensates all rounding: s = max(1, lambda_max(R^-1 P)).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from uav_vslam.estimation.common_error_bound import smallest_common_bound
from uav_vslam.geometry.coded_points import (
    COMMON_NUMBERS,
    FACTOR_STEPS,
    OFFSET_STEP_M,
    OWN_NUMBERS,
    AnchoredPoints,
    DensePoints,
    pack_lower,
    similarity_jacobian,
    size_code,
    unpack_lower,
)
from uav_vslam.numerics import cholesky, symmetrise

Array = NDArray[np.float64]

MARGIN = 1e-9  # numerical error of the largest eigenvalue
ROUNDING_VARIANCE = OFFSET_STEP_M**2 / 12.0  # of an anchored offset, per axis [m^2]


def code_dense(offsets: Array, P: Array) -> tuple[DensePoints, float]:
    """Return offsets (N, 3) and covariance P (3N, 3N) in single precision, and the factor s of R."""
    factor = pack_lower(cholesky(symmetrise(P), "covariance of a packet")).astype(np.float32)
    return DensePoints(offsets.astype(np.float32), factor), bounding_scale(unpack_lower(factor.astype(float)), P)


def code_anchored(offsets: Array, P: Array) -> tuple[AnchoredPoints, float]:
    """Return offsets (N, 3) in steps of 2 cm, the common and own errors that bound P, and the factor s.

    P includes the variance of rounding the offsets.
    """
    rounded = np.round(offsets / OFFSET_STEP_M).astype(np.int16)
    if len(offsets) == 0:
        nothing = np.zeros((0, OWN_NUMBERS), np.int8)
        return AnchoredPoints(rounded, np.zeros(COMMON_NUMBERS, np.float32), nothing, np.zeros(0, np.uint16)), 1.0
    P = symmetrise(P) + ROUNDING_VARIANCE * np.eye(len(P))
    common, own = smallest_common_bound(P, similarity_jacobian(np.asarray(rounded * OFFSET_STEP_M, dtype=float)))
    points = AnchoredPoints(rounded, pack_lower(common).astype(np.float32), *_code_own(own))
    return points, bounding_scale(cholesky(symmetrise(points.covariance), "coded covariance of a packet"), P)


def bounding_scale(L: Array, P: Array) -> float:
    """Return max(1, lambda_max(R^-1 P)) for R = L L^T, rounded up to single precision."""
    if len(P) == 0:
        return 1.0
    half = solve_triangular(L, P, lower=True)
    largest = float(np.linalg.eigvalsh(symmetrise(solve_triangular(L, half.T, lower=True)))[-1])
    return float(np.nextafter(np.float32(max(1.0, largest * (1.0 + MARGIN))), np.float32(np.inf)))


def _code_own(factors: Array) -> tuple[NDArray[np.int8], NDArray[np.uint16]]:
    """Return the (N, 6) entries and (N,) sizes of factors (N, 3, 3), enlarged until each L L^T bounds its own.

    Each landmark's rounding is compensated by itself: through s the worst would inflate all.
    """
    packed = pack_lower(factors)
    sizes = np.abs(packed).max(axis=1)
    entries = np.round(packed / sizes[:, None] * FACTOR_STEPS)
    diagonal = np.cumsum(np.arange(1, 4)) - 1
    entries[:, diagonal] = np.maximum(entries[:, diagonal], 1.0)
    lost = np.linalg.solve(unpack_lower(entries / FACTOR_STEPS), factors)  # its norm: how much L is too small
    codes = size_code(np.linalg.norm(lost, ord=2, axis=(1, 2)))
    return entries.astype(np.int8), codes
