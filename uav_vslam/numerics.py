# SPDX-License-Identifier: Apache-2.0
"""Symmetric positive definite linear algebra by Cholesky factors, robust statistics."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.blas import dgemm, dtrmm
from scipy.linalg.lapack import dpotrf, dpotri, dtrtri

from uav_vslam.errors import FilterDivergence

Array = NDArray[np.float64]

NORMAL_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
INVERTED_WHOLE = 128  # rows of a triangle


def symmetrise(A: Array) -> Array:
    """Return (A + A^T) / 2 over the last two axes."""
    return 0.5 * (A + np.swapaxes(A, -1, -2))


def cholesky(A: Array, what: str) -> Array:
    """Return the lower Cholesky factor.

    Args:
        A: (n, n) symmetric positive definite.
        what: named in the error, e.g. "information at 12.3 s".

    Raises:
        FilterDivergence: A is not positive definite or not finite; the text names the smallest eigenvalue.
    """
    L, failed = dpotrf(A.T, lower=1, clean=1)  # LAPACK is column-major: A^T avoids a copy
    if failed or not np.isfinite(np.diagonal(L)).all():  # OpenBLAS lets NaN pass
        smallest = float(np.linalg.eigvalsh(A)[0]) if np.isfinite(A).all() else float("nan")
        raise FilterDivergence(f"{what} is not positive definite: smallest eigenvalue {smallest:.3e} of {len(A)} rows")
    return np.asarray(L)


def is_positive_definite(A: Array) -> bool:
    """Return whether a finite symmetric matrix, or each of a stack of them, is positive definite."""
    try:
        np.linalg.cholesky(A)
    except np.linalg.LinAlgError:
        return False
    return True


def inverse_spd(A: Array, what: str) -> Array:
    """Return the symmetric (n, n) inverse of a positive definite A (n, n); `what` names it if `cholesky` fails."""
    return inverse_from_cholesky(cholesky(A, what))


def inverse_from_cholesky(L: Array) -> Array:
    """Return (L L^T)^-1 for a lower factor L (n, n)."""
    if len(L) == 0:  # LAPACK would complain on the terminal
        return np.zeros((0, 0))
    lower, _ = dpotri(L, lower=1)  # the upper triangle keeps L's zeros
    inverse = lower + lower.T
    inverse.flat[:: len(L) + 1] *= 0.5
    return np.asarray(inverse)


def inverse_of_triangle(L: Array) -> Array:
    """Return the inverse of a lower triangle L (n, n); a large one by halves: LAPACK takes half as long again."""
    n, middle = len(L), len(L) // 2
    if n == 0:  # LAPACK would complain on the terminal
        return np.zeros((0, 0))
    if n <= INVERTED_WHOLE:
        return np.asarray(dtrtri(L, lower=1)[0])
    inverse = np.zeros((n, n), order="F")
    inverse[:middle, :middle] = first = inverse_of_triangle(L[:middle, :middle])
    inverse[middle:, middle:] = second = inverse_of_triangle(L[middle:, middle:])
    across = dtrmm(1.0, first, L[middle:, :middle], side=1, lower=1)
    inverse[middle:, :middle] = dtrmm(-1.0, second, across, lower=1, overwrite_b=1)
    return inverse


def log_det_of(L: Array) -> float:
    """Return log det(L L^T) for a triangular factor L (n, n)."""
    return 2.0 * float(np.log(np.diagonal(L)).sum())


def square_root(A: Array) -> Array:
    """Return B (n, n) with B B^T = A for a positive semidefinite A (n, n), which may be singular."""
    values, vectors = np.linalg.eigh(symmetrise(A))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def solve_spd(A: Array, b: Array, what: str) -> Array:
    """Return x with A x = b for a positive definite A (n, n) and b (n,) or (n, k)."""
    return np.asarray(cho_solve((cholesky(A, what), True), b, check_finite=False))


def mahalanobis2(residual: Array, S: NDArray[np.floating]) -> Array:
    """Return r^T S^-1 r of (..., n) small residuals r, each with a covariance (..., n, n); by batched LU."""
    return np.asarray(np.einsum("...i,...i->...", residual, np.linalg.solve(S, residual[..., None])[..., 0]))


def subtract_product(Y: Array, W: Array) -> None:
    """Y -= W^T W, in place and without another matrix of that size; Y (n, n) is C-contiguous and symmetric."""
    dgemm(-1.0, W, W, 1.0, Y.T, trans_a=True, overwrite_c=True)


def submatrix(A: Array, rows: NDArray[np.int64], columns: NDArray[np.int64] | None = None) -> Array:
    """Return a copy of A's rows and columns, by default the same; three times as fast as `A[np.ix_(...)]`."""
    return np.asarray(A.take(rows, 0).take(rows if columns is None else columns, 1))


def marginalise_information(Y: Array, keep: NDArray[np.int64], drop: NDArray[np.int64], what: str) -> Array:
    """Return the information over `keep` by the Schur complement, Y_kk - Y_kd Y_dd^-1 Y_dk.

    Args:
        Y: (n, n) information.
        keep, drop: rows of Y, none in both.
        what: names Y over `drop` if it is not positive definite.
    """
    if len(drop) == 0:
        return submatrix(Y, keep)
    L = cholesky(submatrix(Y, drop), what)
    W = solve_triangular(L, submatrix(Y, drop, keep), lower=True, check_finite=False)
    Y_kept = submatrix(Y, keep)
    subtract_product(Y_kept, W)
    return Y_kept


def robust_sigma(residuals: Array) -> float:
    """Return the standard deviation of normal residuals of mean zero by their median absolute value."""
    return NORMAL_MAD * float(np.median(np.abs(residuals)))
