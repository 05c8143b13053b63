# SPDX-License-Identifier: Apache-2.0
"""Points with a joint covariance, quantised for the radio in two forms, and how both are decoded.

dense     the Cholesky factor of the whole (3N, 3N) covariance
anchored  J P_T J^T + blkdiag(D_i): an error common to all points of shift, rotation and scale, J_i = [I, -[x_i]x, x_i]
          with x_i measured from the origin, plus an independent error of each point; a landmark takes 14 bytes

Factors are coded, never covariances: L L^T stays positive semidefinite under any rounding.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RIGID_DOF = 6
COMMON_DOF = RIGID_DOF + 1
COMMON_NUMBERS = COMMON_DOF * (COMMON_DOF + 1) // 2
OWN_NUMBERS = 6  # of a 3x3 lower factor

OFFSET_STEP_M = 0.02
OFFSET_LIMIT_M = np.iinfo(np.int16).max * OFFSET_STEP_M
FACTOR_STEPS = 127  # an own factor's largest entry
SMALLEST_SIZE_M = 1e-4  # of an own factor
SIZES_PER_OCTAVE = 2048


@dataclass(frozen=True, slots=True)
class DensePoints:
    """Points and their joint covariance in single precision.

    Attributes:
        offsets: (N, 3) float32, from the origin [m].
        factor: (3N (3N+1) / 2,) float32 rows of the lower Cholesky factor [m].
    """

    offsets: NDArray[np.float32]
    factor: NDArray[np.float32]

    @property
    def offsets_m(self) -> Array:
        """(N, 3) points, from the origin [m]."""
        return self.offsets.astype(float)

    @property
    def covariance(self) -> Array:
        """(3N, 3N) [m^2]."""
        L = unpack_lower(self.factor.astype(float))
        return np.asarray(L @ L.T)


@dataclass(frozen=True, slots=True)
class AnchoredPoints:
    """Points with a common error of shift, rotation and scale about the origin, and an independent error each.

    Attributes:
        offsets: (N, 3) int16, from the origin [2 cm].
        common_factor: (28,) float32 rows of the lower factor of P_T, order shift [m], rotation [rad], scale.
        own_factors: (N, 6) int8 rows of the lower factor of D_i, in 127ths of its size.
        own_sizes: (N,) uint16 code of the size, see `size_m`.
    """

    offsets: NDArray[np.int16]
    common_factor: NDArray[np.float32]
    own_factors: NDArray[np.int8]
    own_sizes: NDArray[np.uint16]

    @property
    def offsets_m(self) -> Array:
        """(N, 3) points, from the origin [m]."""
        return np.asarray(self.offsets * OFFSET_STEP_M, dtype=float)

    @property
    def covariance(self) -> Array:
        """(3N, 3N) [m^2]."""
        loading = similarity_jacobian(self.offsets_m) @ unpack_lower(self.common_factor.astype(float))
        own = unpack_lower(self.own_factors.astype(float)) * (size_m(self.own_sizes) / FACTOR_STEPS)[:, None, None]
        return np.asarray(loading @ loading.T + block_diagonal(own @ own.transpose(0, 2, 1)))


CodedPoints = DensePoints | AnchoredPoints


def size_m(code: NDArray[np.uint16]) -> Array:
    """Decode sizes [m]: every code is valid, from 0.1 mm in steps of 0.03 %."""
    return np.asarray(SMALLEST_SIZE_M * np.exp2(code / SIZES_PER_OCTAVE))


def size_code(least_m: Array) -> NDArray[np.uint16]:
    """Encode sizes [m], rounded up to the next step; saturates at the largest code."""
    steps = np.ceil(np.log2(np.maximum(least_m, SMALLEST_SIZE_M) / SMALLEST_SIZE_M) * SIZES_PER_OCTAVE)
    return np.minimum(steps, np.iinfo(np.uint16).max).astype(np.uint16)


def rigid_jacobian(points: Array) -> Array:
    """Return (3N, 6) d(points)/d(shift, rotation) of a rigid body about the origin: J_i = [I, -[x_i]x]."""
    x, y, z = points.T
    J = np.zeros((len(points), 3, RIGID_DOF))
    J[:, range(3), range(3)] = 1.0
    J[:, 0, 4], J[:, 0, 5] = z, -y
    J[:, 1, 3], J[:, 1, 5] = -z, x
    J[:, 2, 3], J[:, 2, 4] = y, -x
    return J.reshape(-1, RIGID_DOF)


def similarity_jacobian(points: Array) -> Array:
    """Return (3N, 7) d(points)/d(shift, rotation, scale) about the origin: J_i = [I, -[x_i]x, x_i]."""
    return np.hstack([rigid_jacobian(points), points.reshape(-1, 1)])


def pack_lower(L: Array) -> Array:
    """Return the rows of lower triangles (..., n, n), concatenated: (..., n (n+1) / 2)."""
    rows, columns = np.tril_indices(L.shape[-1])
    return L[..., rows, columns]


def unpack_lower(packed: Array) -> Array:
    """Return lower triangles (..., n, n) from their packed rows (..., n (n+1) / 2)."""
    n = (int(np.sqrt(8 * packed.shape[-1] + 1)) - 1) // 2
    L = np.zeros((*packed.shape[:-1], n, n))
    rows, columns = np.tril_indices(n)
    L[..., rows, columns] = packed
    return L


def block_diagonal(blocks: Array) -> Array:
    """Return (N k, N k) with (N, k, k) blocks on the diagonal."""
    n, k, _ = blocks.shape
    out = np.zeros((n, k, n, k))
    out[np.arange(n), :, np.arange(n), :] = blocks
    return out.reshape(n * k, n * k)


def diagonal_blocks(A: Array) -> Array:
    """Return the (N, 3, 3) blocks on the diagonal of A (3N, 3N)."""
    n = len(A) // 3
    return A.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n), :]
