# SPDX-License-Identifier: Apache-2.0
"""The smallest covariance of the form J P_T J^T + blkdiag(D_i) that is an upper bound of a given one.

A least-squares or maximum-likelihood fit to P misses the one or two directions in which landmark errors are correlated
in another way, such as a stretch along the track; inflating the fit until it bounds those too (ten times, for beliefs
of our filter) loses the most valuable part, the common error. So the bound is a constraint: minimise trace(W R) subject
to R >= P, a small semidefinite program, by Newton's method on

    t trace(W R) - log det(R - P) - log det P_T - sum_i log det D_i,    t -> infinity,

see [boyd04], section 11.6. W = blkdiag(P_ii + q^2 I)^-1 penalises growth of each landmark's own covariance
relative to q, the accuracy that a receiver can use.
"""

import functools

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import FilterDivergence
from uav_vslam.geometry.coded_points import block_diagonal, diagonal_blocks, unpack_lower
from uav_vslam.numerics import inverse_spd, is_positive_definite, solve_spd, symmetrise

Array = NDArray[np.float64]

INDIFFERENCE_M = 0.3  # q: two vehicles' keypoints are not at exactly the same point
TOLERANCE = 0.05  # relative excess of the cost over its minimum
SHARPENING = 20.0  # factor on t each time that Newton's method has converged
CONVERGED = 4.0  # square of the Newton decrement at which it has
MAX_STEPS = 60
STAY_INSIDE = 0.9  # largest share of the way to the boundary in one step
SHORTEST_STEP = 1e-12  # share of a step below which the search fails
RANK_TOLERANCE = 1e-9  # of J: one or two points do not observe all parts of a common error


def smallest_common_bound(P: Array, J: Array) -> tuple[Array, Array]:
    """Return lower factors of P_T (k, k) and D_i (N, 3, 3) with J P_T J^T + blkdiag(D_i) >= P up to rounding.

    P_T may be singular: few points do not observe all parts of the common error.

    Args:
        P: (3N, 3N) positive definite [m^2], N > 0.
        J: (3N, k) Jacobian of the points by the common error.

    Raises:
        FilterDivergence: P is not positive definite.
    """
    # Scaled so that W is the identity and J has orthonormal columns: all values are of order one.
    C = np.linalg.cholesky(symmetrise(diagonal_blocks(P)) + INDIFFERENCE_M**2 * np.eye(3))
    unit = block_diagonal(np.linalg.inv(C))
    U, s, Vt = np.linalg.svd(unit @ J, full_matrices=False)
    seen = s > RANK_TOLERANCE * s[0]
    common, own = _smallest_unit_bound(symmetrise(unit @ P @ unit.T), U[:, seen])
    root = (Vt[seen].T / s[seen]) @ np.linalg.cholesky(common)  # P_T = root root^T, made lower triangular by QR
    triangle = np.zeros((J.shape[1], J.shape[1]))
    triangle[:, : root.shape[1]] = np.linalg.qr(root.T)[1].T
    return triangle, C @ np.linalg.cholesky(own)


def _smallest_unit_bound(P: Array, Q: Array) -> tuple[Array, Array]:
    """Minimise trace(X_0) + sum_i trace(X_i) subject to Q X_0 Q^T + blkdiag(X_i) >= P, for orthonormal columns Q."""
    n, k = len(P) // 3, Q.shape[1]
    largest = float(np.linalg.eigvalsh(P)[-1])
    if not largest > 0:
        raise FilterDivergence(f"covariance of a packet is not positive definite: largest eigenvalue {largest:.3e}")
    common, own = largest * np.eye(k), np.tile(1.1 * largest * np.eye(3), (n, 1, 1))
    constraints = 2 * 3 * n + k  # total rows of the matrices that must stay positive definite
    t = constraints / (np.trace(common) + np.trace(own, axis1=1, axis2=2).sum())
    for _ in range(MAX_STEPS):
        step_common, step_own, decrement = _newton_step(P, Q, common, own, t)
        common, own, full_step = _line_search(P, Q, common, own, step_common, step_own)
        if full_step and decrement < CONVERGED:
            if constraints / t < TOLERANCE * (np.trace(common) + np.trace(own, axis1=1, axis2=2).sum()):
                break
            t *= SHARPENING
    return common, own


def _newton_step(P: Array, Q: Array, common: Array, own: Array, t: float) -> tuple[Array, Array, float]:
    """Return the steps of X_0 and X_i, and the Newton decrement squared."""
    n, k = len(own), len(common)
    M = inverse_spd(Q @ common @ Q.T + block_diagonal(own) - P, "excess of a bound")
    G_00, G_0i = Q.T @ M @ Q, (Q.T @ M).reshape(k, n, 3).transpose(0, 2, 1)
    inverse_common, inverse_own = _inverse(common), _inverse(own)
    S_k, S_3 = _symmetric_basis(k), _symmetric_basis(3)

    gradient_common = np.einsum("aij,ij->a", S_k, t * np.eye(k) - G_00 - inverse_common)
    gradient_own = np.einsum("aij,nij->an", S_3, t * np.eye(3) - diagonal_blocks(M) - inverse_own)
    m = len(S_k)
    H = np.empty((m + 6 * n,) * 2)  # of X_0, then of all X_i: element by element, of each all landmarks
    H[:m, :m] = _curvature(G_00) + _curvature(inverse_common)
    H[:m, m:] = _curvature(G_0i).reshape(m, 6 * n)
    H[m:, :m] = H[:m, m:].T
    _set_curvature(H[m:, m:], M)
    rows = m + np.arange(6 * n).reshape(6, n)
    H[rows[:, None], rows[None]] += _curvature(inverse_own.transpose(1, 2, 0))

    gradient = np.concatenate([gradient_common, gradient_own.ravel()])
    step = -solve_spd(H, gradient, "curvature of a bound's cost")
    steps_own = np.einsum("an,aij->nij", step[m:].reshape(6, n), S_3)
    return np.einsum("a,aij->ij", step[:m], S_k), steps_own, float(-gradient @ step)


def _line_search(P: Array, Q: Array, common: Array, own: Array, step_common: Array, step_own: Array) -> tuple:
    """Shorten a step until it stays well inside the feasible set; also return whether the full step was taken."""
    share = 1.0
    while True:
        X_0, X_i = common + share * step_common, own + share * step_own
        if all(is_positive_definite(A) for A in (X_0, X_i, Q @ X_0 @ Q.T + block_diagonal(X_i) - P)):
            break
        share *= 0.7
        if share < SHORTEST_STEP:
            raise FilterDivergence("no such bound was found for the covariance of a packet")
    if share == 1.0:
        return X_0, X_i, True
    share *= STAY_INSIDE
    return common + share * step_common, own + share * step_own, False


def _curvature(G: Array) -> Array:
    """Return (A, B, ...) of trace(S_a G S_b G^T) over the bases of symmetric matrices, for G (n_a, n_b, ...).

    S_a has ones at (p, q) and (q, p), S_b at (r, s) and (s, r): the trace is 2 (G_pr G_qs + G_ps G_qr), halved for each
    of the two that has a single one.
    """
    (p, q), (r, s) = _lower(G.shape[0]), _lower(G.shape[1])
    of_p, of_q = G[p], G[q]
    factor = 2.0 * np.outer(np.where(p == q, 0.5, 1.0), np.where(r == s, 0.5, 1.0))
    return factor.reshape(factor.shape + (1,) * (G.ndim - 2)) * (of_p[:, r] * of_q[:, s] + of_p[:, s] * of_q[:, r])


def _set_curvature(H: Array, M: Array) -> None:
    """Set H (6n, 6n) to the `_curvature` of all 3x3 blocks of M (3n, 3n), row by row to stay in the cache."""
    n, (r, s) = len(M) // 3, _lower(3)
    G = np.ascontiguousarray(M.reshape(n, 3, n, 3).transpose(1, 3, 0, 2))
    share = np.where(r == s, 0.5, 1.0)
    for a, (p, q) in enumerate(zip(r, s, strict=True)):
        row = G[p, r] * G[q, s]
        row += G[p, s] * G[q, r]
        row *= (2.0 * share[a] * share)[:, None, None]
        H[n * a : n * (a + 1)] = row.transpose(1, 0, 2).reshape(n, 6 * n)


@functools.cache
def _symmetric_basis(n: int) -> Array:
    """Return (n (n+1) / 2, n, n) unit symmetric matrices, in the order of `np.tril_indices`."""
    L = unpack_lower(np.eye(n * (n + 1) // 2))
    return np.maximum(L, L.transpose(0, 2, 1))


_lower = functools.cache(np.tril_indices)


def _inverse(A: Array) -> Array:
    return symmetrise(np.asarray(np.linalg.inv(A)))
