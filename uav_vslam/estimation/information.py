# SPDX-License-Identifier: Apache-2.0
"""The information form: Eq. (4.5.1) to (4.5.8) of [thesis], without inverting the full matrix.

Observations concern the few landmarks in view. The others are eliminated once a frame (Schur complement by a Cholesky
factor); gate, update and the vehicle's covariance all use this *active* marginal (a) without the rest (r):

    [Y_rr  Y_ra] [e_r]          Y_active = Y_aa - W^T W,   W = L^-1 Y_ra,   Y_rr = L L^T
    [Y_ar  Y_aa] [e_a]          delta_r = -L^-T W delta_a

An update adds to Y_aa only, so the elimination stays valid.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.blas import dgemm

from uav_vslam.estimation.belief import (
    Indices,
    Marginals,
    Observation,
    Update,
    add_normal_equations,
    landmark_rows,
    state_rows,
)
from uav_vslam.numerics import (
    cholesky,
    inverse_from_cholesky,
    inverse_of_triangle,
    inverse_spd,
    log_det_of,
    marginalise_information,
    square_root,
    submatrix,
    symmetrise,
)

Array = NDArray[np.float64]


@dataclass(slots=True)
class _ActiveMarginal:
    """The marginal over the vehicle and the active landmarks.

    Attributes:
        landmarks: (K,) active ones.
        rows, rest: rows of the active states and of all others.
        L: factor of the rest's information, W: (rest, active) as above.
        Y: (vehicle + 3K, ...) marginal information.
        factor: lower Cholesky factor of Y.
        marginals: cached.
    """

    landmarks: Indices
    rows: Indices
    rest: Indices
    L: Array
    W: Array
    Y: Array
    factor: Array
    marginals: Marginals | None = None


class InformationBelief:
    """Holds `Y`; an update is a sum, cubic in the landmarks in view rather than in the whole map.

    The active marginal and the vehicle's covariance are caches: `Y` alone is the belief.
    """

    def __init__(self, Y: Array, vehicle: int, P_vehicle: Array | None = None) -> None:
        self.Y, self.vehicle = Y, vehicle
        self._active: _ActiveMarginal | None = None
        self._P_vehicle = P_vehicle

    @property
    def size(self) -> int:
        return len(self.Y)

    @classmethod
    def from_covariance(cls, P: Array) -> Self:
        return cls(inverse_spd(P, "initial covariance"), len(P), P.copy())

    def covariance(self, landmarks: Indices) -> Array:
        if len(landmarks) == 0:
            if self._P_vehicle is None:
                self._P_vehicle = _vehicle_covariance(self._active_marginal(landmarks).factor, self.vehicle)
            self._P_vehicle.flags.writeable = False
            return self._P_vehicle
        active = self._active_marginal(landmarks)
        return submatrix(inverse_from_cholesky(active.factor), state_rows(self.vehicle, _places(active, landmarks)))

    def marginals(self, landmarks: Indices) -> Marginals:
        active = self._active_marginal(landmarks)
        if active.marginals is None:
            G = inverse_of_triangle(active.factor).T
            active.marginals = Marginals.of_factor(G[: self.vehicle], G[self.vehicle :].reshape(-1, 3, len(G)))
        return active.marginals.chosen(_places(active, landmarks))

    def information(self, rows: Indices) -> Array:
        rest = np.delete(np.arange(self.size), rows)
        return marginalise_information(self.Y, rows, rest, "information")

    def predicted(self, F: Array, Q: Array) -> Self:
        """Apply the matrix inversion lemma to the vehicle; Q = B B^T may be singular and is not inverted.

        Y - Y_v B (I + B^T Y_vv B)^-1 B^T Y_v^T for the Y transformed by F^-1.
        """
        m, Y = self.vehicle, self.Y.copy()
        F_inv = np.linalg.inv(F)
        Y[:m, :] = F_inv.T @ Y[:m, :]
        Y[:, :m] = Y[:, :m] @ F_inv
        B = square_root(Q)
        YB = Y[:, :m] @ B
        L = cholesky(np.eye(m) + B.T @ YB[:m], "process noise")
        lost = solve_triangular(L, YB.T, lower=True, check_finite=False)
        Y = dgemm(-1.0, lost, lost, 1.0, Y.T, trans_a=True, overwrite_c=True).T  # Y -= lost^T lost, in place
        Y[:m, :m] = symmetrise(Y[:m, :m])
        P_vehicle = None if self._P_vehicle is None else symmetrise(F @ self._P_vehicle @ F.T + Q)
        return type(self)(Y, m, P_vehicle)

    def reset_rows(self, rows: Indices, variance: float) -> Self:
        keep = np.delete(np.arange(self.size), rows)
        Y = np.zeros_like(self.Y)
        Y[np.ix_(keep, keep)] = marginalise_information(self.Y, keep, rows, "information of reset rows")
        Y[rows, rows] = 1.0 / variance
        return type(self)(Y, self.vehicle)

    def information_removed(self, B: Array) -> Self:
        Y = self.Y.copy()
        Y[: self.vehicle, : self.vehicle] -= B.T @ B
        return type(self)(Y, self.vehicle)

    def updated(self, observation: Observation) -> Update:
        """Y <- Y + H^T H, delta = Y^-1 H^T nu."""
        active = self._active_marginal(observation.landmarks)
        Y_active = active.Y.copy()
        i = add_normal_equations(Y_active, observation, _places(active, observation.landmarks))
        factor = cholesky(Y_active, "information in view")
        delta = np.zeros(self.size)
        delta[active.rows] = cho_solve((factor, True), i, check_finite=False)
        Y = Y_active
        if len(active.rest) or not np.array_equal(active.rows, np.arange(self.size)):
            pulled = active.W @ delta[active.rows]
            delta[active.rest] = -solve_triangular(active.L, pulled, lower=True, trans="T", check_finite=False)
            Y = self.Y.copy()
            add_normal_equations(Y, observation, observation.landmarks)
        nis = float(np.sum(observation.nu**2) - i @ delta[active.rows])
        log_det = log_det_of(factor) - log_det_of(active.factor)
        after = type(self)(Y, self.vehicle, _vehicle_covariance(factor, self.vehicle))
        return Update(after, delta, nis, log_det)

    def appended(self, H_vehicle: Array, H_landmark: Array) -> Self:
        n, count = self.size, len(H_vehicle)
        fresh = np.arange((n - self.vehicle) // 3, (n - self.vehicle) // 3 + count)
        Y = np.zeros((n + 3 * count,) * 2)
        Y[:n, :n] = self.Y
        add_normal_equations(Y, Observation(fresh, H_vehicle, H_landmark, np.zeros(H_vehicle.shape[:2])), fresh)
        return type(self)(Y, self.vehicle, self._P_vehicle)

    def marginalised(self, landmarks: Indices) -> Self:
        gone = landmark_rows(self.vehicle, landmarks)
        keep = np.delete(np.arange(self.size), gone)
        Y = marginalise_information(self.Y, keep, gone, "information of marginalised landmarks")
        return type(self)(Y, self.vehicle, self._P_vehicle)

    def coordinates_changed(self, B: Array, columns: slice) -> Self:
        """Y <- T^-T Y T^-1 with T^-1 = I + B E^T."""
        YB = self.Y @ B
        Y = self.Y.copy()
        Y[:, columns] += YB
        Y[columns, :] += YB.T
        Y[columns, columns] += B.T @ YB
        P = self._P_vehicle
        if P is not None:
            P = P - B[: self.vehicle] @ P[columns]
            P = P - P[:, columns] @ B[: self.vehicle].T
        return type(self)(Y, self.vehicle, P)

    def _active_marginal(self, landmarks: Indices) -> _ActiveMarginal:
        """Return a marginal that contains the landmarks; the cached one if it does."""
        if self._active is None or not np.isin(landmarks, self._active.landmarks).all():
            self._active = self._eliminated(landmarks)
        return self._active

    def _eliminated(self, landmarks: Indices) -> _ActiveMarginal:
        rows = state_rows(self.vehicle, landmarks)
        rest = np.delete(np.arange(self.size), rows)
        whole = np.array_equal(rows, np.arange(self.size))
        Y = self.Y if whole else submatrix(self.Y, rows)
        L, W = np.zeros((0, 0)), np.zeros((0, len(rows)))
        if len(rest):
            L = cholesky(submatrix(self.Y, rest), "information out of view")
            W = solve_triangular(L, submatrix(self.Y, rest, rows), lower=True, check_finite=False)
            Y -= W.T @ W
        return _ActiveMarginal(landmarks, rows, rest, L, W, Y, cholesky(Y, "information"))


def _places(active: _ActiveMarginal, landmarks: Indices) -> Indices:
    """Return the indices of landmarks within a marginal."""
    order = np.argsort(active.landmarks, kind="stable")
    return np.asarray(order[np.searchsorted(active.landmarks, landmarks, sorter=order)], dtype=np.int64)


def _vehicle_covariance(factor: Array, vehicle: int) -> Array:
    """Return the leading block of (L L^T)^-1."""
    columns = solve_triangular(factor, np.eye(len(factor), vehicle), lower=True, check_finite=False)
    return np.asarray(columns.T @ columns)
