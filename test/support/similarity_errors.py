# SPDX-License-Identifier: Apache-2.0
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def similarity_errors(points: Array, truth: Array) -> Array:
    """Return the distances of (N, 3) points from the true ones after the best similarity."""
    a, b = points - points.mean(axis=0), truth - truth.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    scale = float((S * np.diag(D)).sum() / (a**2).sum())
    return np.asarray(np.linalg.norm(scale * a @ (U @ D @ Vt).T - b, axis=1))
