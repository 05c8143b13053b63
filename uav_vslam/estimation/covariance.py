# SPDX-License-Identifier: Apache-2.0
"""The covariance form of the Kalman filter, Eq. (4.2.1) to (4.2.3) of [thesis]."""

from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from uav_vslam.estimation.belief import (
    NO_ROWS,
    Indices,
    Marginals,
    Observation,
    Update,
    landmark_rows,
    propagated,
    share_left,
    state_rows,
    with_copies,
)
from uav_vslam.numerics import cholesky, inverse_spd, submatrix, symmetrise

Array = NDArray[np.float64]


class CovarianceBelief:
    """Holds `P`; prediction and marginalisation are cheap, an update is cubic in the number of observations."""

    def __init__(self, P: Array, vehicle: int) -> None:
        self.P, self.vehicle = P, vehicle

    @property
    def size(self) -> int:
        return len(self.P)

    @classmethod
    def from_covariance(cls, P: Array) -> Self:
        cholesky(P, "initial covariance")
        return cls(P.copy(), len(P))

    def covariance(self, landmarks: Indices) -> Array:
        return submatrix(self.P, state_rows(self.vehicle, landmarks))

    def marginals(self, landmarks: Indices) -> Marginals:
        m, P = self.vehicle, self.P
        own = landmark_rows(m, landmarks).reshape(-1, 3)
        return Marginals(P[:m, :m].copy(), P[own, :m].transpose(0, 2, 1), P[own[:, :, None], own[:, None, :]])

    def information(self, rows: Indices) -> Array:
        return inverse_spd(submatrix(self.P, rows), "covariance")

    def predicted(self, F: Array, Q: Array) -> Self:
        return type(self)(propagated(self.P, F, Q), self.vehicle)

    def cloned(self, rows: Indices, variance: Array) -> Self:
        return type(self)(with_copies(self.P, self.vehicle, rows, variance), self.vehicle + len(rows))

    def reset_rows(self, rows: Indices, variance: float) -> Self:
        P = self.P.copy()
        P[rows, :] = 0.0
        P[:, rows] = 0.0
        P[rows, rows] = variance
        return type(self)(P, self.vehicle)

    def column(self, row: int) -> Array:
        return self.P[:, row].copy()

    def information_changed(self, row: int, change: float) -> Self:
        """P <- P - p p^T change / (1 + change p_row) for the column p of P."""
        p = self.P[:, row]
        left = share_left(change, float(p[row]))
        return type(self)(self.P - np.outer(p, p) * (change / left), self.vehicle)

    def information_removed(self, B: Array) -> Self:
        """P <- P + W^T W, W = L^-1 B P with I - B P B^T = L L^T."""
        BP = B @ self.P[: self.vehicle]
        L = cholesky(np.eye(len(B)) - symmetrise(BP[:, : self.vehicle] @ B.T), "bound")
        W = solve_triangular(L, BP, lower=True, check_finite=False)
        return type(self)(self.P + W.T @ W, self.vehicle)

    def updated(self, observation: Observation) -> Update:
        """W = L^-1 H P with S = L L^T: delta = W^T L^-1 nu, P <- P - W^T W."""
        m, n = self.vehicle, self.size
        columns = m + 3 * observation.landmarks[:, None] + np.arange(3)
        Hv, Hl = observation.H_vehicle, observation.H_landmark
        HP = Hv @ self.P[:m] + Hl @ self.P[columns]
        S = np.einsum("mkc,pjc->mkpj", HP[:, :, :m], Hv, optimize=True)
        S += np.einsum("mkpc,pjc->mkpj", HP[:, :, columns], Hl, optimize=True)
        count, nu, excess = observation.nu.size, observation.nu.ravel(), 0.0
        S, HP = S.reshape(count, count), HP.reshape(count, n)
        if observation.of_vehicle is not None:
            H, more_nu, excess = observation.of_vehicle.rows()
            cross, more = HP[:, :m] @ H.T, H @ self.P[:m]
            S = np.block([[S, cross], [cross.T, more[:, :m] @ H.T]])
            HP, nu = np.vstack([HP, more]), np.concatenate([nu, more_nu])
        L = cholesky(symmetrise(S) + np.eye(len(S)), "innovation covariance")
        W = solve_triangular(L, HP, lower=True, check_finite=False)
        whitened = solve_triangular(L, nu, lower=True, check_finite=False)
        after = type(self)(symmetrise(self.P - W.T @ W), m)
        return Update(after, W.T @ whitened, float(whitened @ whitened) + excess)

    def appended(self, H_vehicle: Array, H_landmark: Array) -> Self:
        """Each new landmark's error is A e_vehicle + noise, A = -H_landmark^-1 H_vehicle."""
        m, n, count = self.vehicle, self.size, len(H_vehicle)
        Hl_inv = np.linalg.inv(H_landmark)
        A = (-Hl_inv @ H_vehicle).reshape(3 * count, m)
        P = np.zeros((n + 3 * count,) * 2)
        P[:n, :n] = self.P
        P[n:, :n] = A @ self.P[:m]
        P[:n, n:] = P[n:, :n].T
        P[n:, n:] = symmetrise(A @ self.P[:m, :m] @ A.T)
        own = n + 3 * np.arange(count)[:, None] + np.arange(3)
        P[own[:, :, None], own[:, None, :]] += Hl_inv @ Hl_inv.transpose(0, 2, 1)
        return type(self)(P, m)

    def marginalised(self, landmarks: Indices, vehicle_rows: Indices = NO_ROWS) -> Self:
        gone = np.concatenate([vehicle_rows, landmark_rows(self.vehicle, landmarks)])
        rows = np.delete(np.arange(self.size), gone)
        return type(self)(submatrix(self.P, rows), self.vehicle - len(vehicle_rows))

    def coordinates_changed(self, B: Array, columns: slice) -> Self:
        P = self.P - B @ self.P[columns]
        P = P - P[:, columns] @ B.T
        return type(self)(P, self.vehicle)
