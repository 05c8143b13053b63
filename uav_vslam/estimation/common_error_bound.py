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
from uav_vslam.numerics import is_positive_definite, symmetrise

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
    M = _inverse(Q @ common @ Q.T + block_diagonal(own) - P)
    G_00, G_0i = Q.T @ M @ Q, (Q.T @ M).reshape(k, n, 3).transpose(1, 0, 2)
    G_ij = M.reshape(n, 3, n, 3).transpose(0, 2, 1, 3)
    inverse_common, inverse_own = _inverse(common), _inverse(own)
    S_k, S_3 = _symmetric_basis(k), _symmetric_basis(3)

    gradient_common = np.einsum("aij,ij->a", S_k, t * np.eye(k) - G_00 - inverse_common)
    gradient_own = np.einsum("aij,nij->na", S_3, t * np.eye(3) - diagonal_blocks(M) - inverse_own)
    H_00 = _curvature(G_00) + _curvature(inverse_common)
    H_0i = _curvature(G_0i).transpose(1, 0, 2).reshape(len(S_k), -1)
    H_ij = _curvature(G_ij)
    H_ij[np.arange(n), np.arange(n)] += _curvature(inverse_own)
    H = np.block([[H_00, H_0i], [H_0i.T, H_ij.transpose(0, 2, 1, 3).reshape(6 * n, 6 * n)]])

    gradient = np.concatenate([gradient_common, gradient_own.ravel()])
    step = -np.linalg.solve(H, gradient)
    steps_own = np.einsum("na,aij->nij", step[len(S_k) :].reshape(n, 6), S_3)
    return np.einsum("a,aij->ij", step[: len(S_k)], S_k), steps_own, float(-gradient @ step)


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
    """Return (..., A, B) of trace(S_a G S_b G^T) over the bases of symmetric matrices, for G (..., n_a, n_b).

    S_a has ones at (p, q) and (q, p), and both contribute the same: sum over (r, s) of G_pr S_b,rs G_qs.
    """
    n_a, n_b = G.shape[-2:]
    p, q = _lower(n_a)
    pairs = G[..., p, :, None] * G[..., q, None, :]
    summed = pairs.reshape(*pairs.shape[:-2], -1) @ _symmetric_basis(n_b).reshape(-1, n_b * n_b).T
    return np.asarray(np.where(p == q, 1.0, 2.0)[:, None] * summed)


@functools.cache
def _symmetric_basis(n: int) -> Array:
    """Return (n (n+1) / 2, n, n) unit symmetric matrices, in the order of `np.tril_indices`."""
    L = unpack_lower(np.eye(n * (n + 1) // 2))
    return np.maximum(L, L.transpose(0, 2, 1))


_lower = functools.cache(np.tril_indices)


def _inverse(A: Array) -> Array:
    return symmetrise(np.asarray(np.linalg.inv(A)))
