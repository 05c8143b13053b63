# SPDX-License-Identifier: Apache-2.0
"""KITTI's axes (x right, y down, z forward, of world and body) and ours (x forward, y left, z up)."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

R_FLU_RDF = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def from_kitti(positions: Array, rotations: Array) -> tuple[Array, Array]:
    """Return (N, 3) positions [m] and (N, 3, 3) rotations in our axes: p = A p_kitti, R = A R_kitti A^T."""
    return positions @ R_FLU_RDF.T, R_FLU_RDF @ rotations @ R_FLU_RDF.T


def to_kitti(positions: Array, rotations: Array) -> tuple[Array, Array]:
    """Return positions and rotations of ours in KITTI's axes, the inverse of `from_kitti`."""
    return positions @ R_FLU_RDF, R_FLU_RDF.T @ rotations @ R_FLU_RDF
