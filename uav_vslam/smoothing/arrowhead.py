# SPDX-License-Identifier: Apache-2.0
"""Normal equations of a long chain: block-tridiagonal, with a border of variables that touch distant blocks.

        | D0  B0'         C0 |        D diagonal, B below the diagonal,
    H = | B0  D1  B1'     C1 |        C coupling of each block with the border,
        |     B1  D2      C2 |        E the border alone
        | C0' C1' C2'     E  |

Blocks are eliminated in order, the border last, so the cost is linear in the length of the chain. The marginal
covariances come from the same factors: the needed part of the inverse, backwards [takahashi73].
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from uav_vslam.numerics import cholesky, inverse_spd, symmetrise

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Arrowhead:
    """H and g of `H x = g`; filled in place while factors are added.

    Attributes:
        diagonal: (N, n, n) D.
        below: (N-1, n, n) B; row k couples block k+1 with block k.
        coupling: (N, n, m) C.
        border: (m, m) E.
        rhs: (N, n), of the blocks.
        border_rhs: (m,).
    """

    diagonal: Array
    below: Array
    coupling: Array
    border: Array
    rhs: Array
    border_rhs: Array

    @staticmethod
    def zeros(blocks: int, size: int, border: int) -> "Arrowhead":
        """Return H = 0 and g = 0."""
        return Arrowhead(
            np.zeros((blocks, size, size)),
            np.zeros((max(blocks - 1, 0), size, size)),
            np.zeros((blocks, size, border)),
            np.zeros((border, border)),
            np.zeros((blocks, size)),
            np.zeros(border),
        )


@dataclass(frozen=True, slots=True)
class Factor:
    """Cholesky factors of an arrowhead.

    Attributes:
        own: (N, n, n) lower factor L of each block given those before it.
        on_next: (N-1, n, n) L^-1 B^T.
        on_border: (N, n, m) L^-1 (what is left of C).
        solution: (N, n) and
        border_solution: (m,) of H x = g.
        border_covariance: (m, m).
    """

    own: Array
    on_next: Array
    on_border: Array
    solution: Array
    border_solution: Array
    border_covariance: Array


def factorise(system: Arrowhead) -> Factor:
    """Eliminate block after block, then solve.

    The factors take the place of D, B and C in the system: those of a long flight fill the memory once, not twice.

    Raises:
        FilterDivergence: H is not positive definite.
    """
    blocks = len(system.diagonal)
    own, on_next, on_border = system.diagonal, system.below, system.coupling
    forward = np.empty_like(system.rhs)
    D, C, g = system.diagonal[0], system.coupling[0], system.rhs[0]
    E, border_rhs = system.border.copy(), system.border_rhs.copy()
    for k in range(blocks):
        own[k] = cholesky(D, f"normal equations, block {k} of {blocks}")
        on_border[k], forward[k] = _forward(own[k], C), _forward(own[k], g)
        E -= on_border[k].T @ on_border[k]
        border_rhs -= on_border[k].T @ forward[k]
        if k + 1 < blocks:
            on_next[k] = _forward(own[k], system.below[k].T)
            D = system.diagonal[k + 1] - on_next[k].T @ on_next[k]
            C = system.coupling[k + 1] - on_next[k].T @ on_border[k]
            g = system.rhs[k + 1] - on_next[k].T @ forward[k]
    border_covariance = inverse_spd(E, "normal equations of the border") if len(E) else E
    border_solution = border_covariance @ border_rhs
    solution = _back_substituted(own, on_next, on_border, forward, border_solution)
    return Factor(own, on_next, on_border, solution, border_solution, border_covariance)


@dataclass(frozen=True, slots=True)
class Marginals:
    """Covariances, each including what all other variables contribute.

    Attributes:
        blocks: (N, n, n) of each block.
        with_border: (N, n, m) of each block with the border.
    """

    blocks: Array
    with_border: Array


def marginal_covariances(factor: Factor) -> Marginals:
    """Return the covariances of the blocks."""
    blocks, size, border = factor.on_border.shape
    P, with_border = np.empty((blocks, size, size)), np.empty((blocks, size, border))
    for k in reversed(range(blocks)):
        # W = L^-T [on_next, on_border] maps the variables eliminated later onto this block, with a minus
        later, P_later = factor.on_border[k], factor.border_covariance
        if k + 1 < blocks:
            later = np.hstack([factor.on_next[k], later])
            P_later = np.block([[P[k + 1], with_border[k + 1]], [with_border[k + 1].T, P_later]])
        W = _backward(factor.own[k], later)
        L_inverse = _forward(factor.own[k], np.eye(size))
        moved = W @ P_later
        P[k] = symmetrise(L_inverse.T @ L_inverse + moved @ W.T)
        with_border[k] = -moved[:, moved.shape[1] - border :]
    return Marginals(P, with_border)


def covariance_of(factor: Factor, marginals: Marginals, first: int, of_blocks: Array, of_border: Array) -> Array:
    """Return the (r, r) covariance of linear functions of successive blocks and the border.

    Block after block is replaced by the ones after it, x_k = -L^-T (on_next x_k+1 + on_border y) + L^-T n with n white,
    until the last one and the border are left, whose covariance is known.

    Args:
        factor, marginals: of the system.
        first: block that `of_blocks` begins with.
        of_blocks: (K, r, n) rows of the functions by each of K > 0 blocks.
        of_border: (r, m) the same by the border.
    """
    last = first + len(of_blocks) - 1
    A, of_border = of_blocks[0], of_border.copy()
    P = np.zeros((len(A), len(A)))
    for k in range(first, last):
        white = _forward(factor.own[k], A.T).T
        P += white @ white.T
        A = of_blocks[k + 1 - first] - white @ factor.on_next[k]
        of_border -= white @ factor.on_border[k]
    cross = A @ marginals.with_border[last] @ of_border.T
    P += A @ marginals.blocks[last] @ A.T + cross + cross.T + of_border @ factor.border_covariance @ of_border.T
    return symmetrise(P)


def _back_substituted(own: Array, on_next: Array, on_border: Array, forward: Array, border: Array) -> Array:
    x = np.empty_like(forward)
    for k in reversed(range(len(own))):
        rest = forward[k] - on_border[k] @ border
        if k + 1 < len(own):
            rest = rest - on_next[k] @ x[k + 1]
        x[k] = _backward(own[k], rest)
    return x


def _forward(L: Array, b: Array) -> Array:
    return np.asarray(solve_triangular(L, b, lower=True, check_finite=False))


def _backward(L: Array, b: Array) -> Array:
    return np.asarray(solve_triangular(L, b, lower=True, trans=1, check_finite=False))
