# SPDX-License-Identifier: Apache-2.0
"""A plane through points, and a similarity between points of a plane, in spite of outliers.

The similarity is the one of least median of squares [rousseeuw84], re-weighted.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.rotation import skew

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FEWEST_CHECKED = 4  # pairs that a similarity can contradict: it meets two of three, so that half of these agree
TRIALS = 3000  # random pairs of points, of each of which a similarity follows
SEED = 3
REWEIGHTINGS = 30


def ground_plane(points: Array) -> tuple[Array, Array]:
    """Return the unit normal of a plane through (P, 3) points, and a point on it, in spite of outliers."""
    weight = np.ones(len(points))
    for _ in range(REWEIGHTINGS):
        middle = weight @ points / weight.sum()
        apart = points - middle
        normal = np.linalg.eigh((apart * weight[:, None]).T @ apart)[1][:, 0]
        distance = np.abs(apart @ normal)
        weight = 1.0 / (1.0 + (distance / max(1.5 * float(np.median(distance)), 1e-12)) ** 2)
    return normal, middle


def plane_similarity(a: Array, b: Array) -> tuple[complex, complex]:
    """Return complex s (scale and rotation) and t (shift) of b = s a + t, where almost half of the pairs may be wrong.

    Of three points, any two are met: these are fitted by plain least squares, as nothing tells which one is wrong.

    Args:
        a, b: (N, 2) points; row k of `a` belongs to row k of `b`.
    """
    p, q = (points @ np.array([1.0, 1j]) for points in (a, b))
    if len(p) < FEWEST_CHECKED:
        return _fitted(p, q, np.ones(len(p)))
    rng = np.random.default_rng(SEED)
    i, j = rng.integers(len(p), size=(2, TRIALS))
    apart = np.abs(p[i] - p[j]) > 0.25 * np.abs(p - np.median(p.real) - 1j * np.median(p.imag)).max()
    i, j = i[apart], j[apart]
    turn = (q[j] - q[i]) / (p[j] - p[i])
    shift = q[i] - turn * p[i]
    errors = np.median(np.abs(turn[:, None] * p + shift[:, None] - q), axis=1)
    best = int(np.argmin(np.where(np.abs(turn) > 0.0, errors, np.inf)))
    return _refined(p, q, complex(turn[best]), complex(shift[best]))


def _refined(p: Complex, q: Complex, turn: complex, shift: complex) -> tuple[complex, complex]:
    """Return the re-weighted least-squares similarity near a given one."""
    for _ in range(REWEIGHTINGS):
        error = np.abs(turn * p + shift - q)
        weight = 1.0 / (1.0 + (error / max(2.0 * float(np.median(error)), 1e-9)) ** 2)
        turn, shift = _fitted(p, q, weight)
    return turn, shift


def _fitted(p: Complex, q: Complex, weight: Array) -> tuple[complex, complex]:
    """Return the least-squares similarity of weighted points."""
    p0, q0 = (weight @ points / weight.sum() for points in (p, q))
    turn = complex((weight * np.conj(p - p0)) @ (q - q0) / (weight @ np.abs(p - p0) ** 2))
    return turn, complex(q0 - turn * p0)


def rotation_to_up(normal: Array) -> Array:
    """Return the (3, 3) smallest rotation that turns a (3,) unit vector up, to z."""
    axis = np.cross(normal, [0.0, 0.0, 1.0])
    c = float(normal[2])
    if c < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    K = skew(axis)
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + c))
