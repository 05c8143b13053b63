# SPDX-License-Identifier: Apache-2.0
"""Similarities of the plane."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_SPREAD = 1e-6  # sum of squared distances from the centre: below it, points coincide


def similarity_between(p: Array, q: Array) -> Array | None:
    """Return the (2, 2) scaled rotation that maps (N, 2) differences of points best; None if the points coincide."""
    a, b = (each - each.mean(axis=0) for each in (p, q))
    spread = float((a**2).sum())
    if spread < LEAST_SPREAD:
        return None
    c, s = float((a * b).sum()) / spread, float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()) / spread
    return np.array([[c, -s], [s, c]])
