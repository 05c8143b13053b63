# SPDX-License-Identifier: Apache-2.0
"""The square-root form: a factor `G` with P = G G^T; rounding cannot make the covariance indefinite."""

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
    share_left,
    state_rows,
)
from uav_vslam.numerics import cholesky, inverse_spd, square_root

Array = NDArray[np.float64]


class SquareRootBelief:
    """Holds `G` (size, k >= size); QR makes it triangular again after columns were added."""

    def __init__(self, G: Array, vehicle: int) -> None:
        self.G, self.vehicle = G, vehicle

    @property
    def size(self) -> int:
        return len(self.G)

    @classmethod
    def from_covariance(cls, P: Array) -> Self:
        return cls(cholesky(P, "initial covariance"), len(P))

    def covariance(self, landmarks: Indices) -> Array:
        G = self.G[state_rows(self.vehicle, landmarks)]
        return np.asarray(G @ G.T)

    def marginals(self, landmarks: Indices) -> Marginals:
        own = landmark_rows(self.vehicle, landmarks).reshape(-1, 3)
        return Marginals.of_factor(self.G[: self.vehicle], self.G[own])

    def information(self, rows: Indices) -> Array:
        return inverse_spd(self.G[rows] @ self.G[rows].T, "covariance")

    def predicted(self, F: Array, Q: Array) -> Self:
        k, G = len(F), self.G.copy()
        G[:k] = F @ G[:k]
        noise = np.zeros((self.size, k))
        noise[:k] = square_root(Q)
        return type(self)(_triangle(np.hstack([G, noise])), self.vehicle)

    def cloned(self, rows: Indices, variance: Array) -> Self:
        m, more = self.vehicle, len(rows)
        G = self.G[np.insert(np.arange(self.size), m, rows)]
        noise = np.zeros((len(G), more))
        noise[m + np.arange(more), np.arange(more)] = np.sqrt(variance)
        return type(self)(np.hstack([G, noise]), m + more)

    def reset_rows(self, rows: Indices, variance: float) -> Self:
        fresh = np.zeros((self.size, len(rows)))
        fresh[rows, np.arange(len(rows))] = np.sqrt(variance)
        G = self.G.copy()
        G[rows] = 0.0
        return type(self)(np.hstack([G, fresh]), self.vehicle)

    def column(self, row: int) -> Array:
        return np.asarray(self.G @ self.G[row])

    def information_changed(self, row: int, change: float) -> Self:
        """G <- G (I - a u u^T) with u the row of G: (I - a u u^T)^2 = I - u u^T change / (1 + change u^T u)."""
        u = self.G[row]
        length2 = float(u @ u)
        left = share_left(change, length2)
        return type(self)(self.G - np.outer(self.G @ u, u) * ((1.0 - left**-0.5) / length2), self.vehicle)

    def information_removed(self, B: Array) -> Self:
        BG = B @ self.G[: self.vehicle]
        L = cholesky(np.eye(len(B)) - BG @ BG.T, "bound")
        more = self.G @ solve_triangular(L, BG, lower=True, check_finite=False).T
        return type(self)(_triangle(np.hstack([self.G, more])), self.vehicle)

    def updated(self, observation: Observation) -> Update:
        """G <- G R^-1 with R^T R = I + (H G)^T (H G) by QR; then delta = G G^T H^T nu."""
        m = self.vehicle
        columns = m + 3 * observation.landmarks[:, None] + np.arange(3)
        HG = observation.H_vehicle @ self.G[:m] + observation.H_landmark @ self.G[columns]
        HG, nu, excess = HG.reshape(-1, self.G.shape[1]), observation.nu.ravel(), 0.0
        if observation.of_vehicle is not None:
            H, more_nu, excess = observation.of_vehicle.rows()
            HG, nu = np.vstack([HG, H @ self.G[:m]]), np.concatenate([nu, more_nu])
        R = np.linalg.qr(np.vstack([np.eye(self.G.shape[1]), HG]), mode="r")
        G = solve_triangular(R, self.G.T, trans="T", check_finite=False).T
        pulled = solve_triangular(R, HG.T @ nu, trans="T", check_finite=False)
        return Update(type(self)(G, m), G @ pulled, float(nu @ nu - pulled @ pulled) + excess)

    def appended(self, H_vehicle: Array, H_landmark: Array) -> Self:
        m, n, count = self.vehicle, self.size, len(H_vehicle)
        Hl_inv = np.linalg.inv(H_landmark)
        A = (-Hl_inv @ H_vehicle).reshape(3 * count, m)
        G = np.zeros((n + 3 * count, self.G.shape[1] + 3 * count))
        G[:n, : self.G.shape[1]] = self.G
        G[n:, : self.G.shape[1]] = A @ self.G[:m]
        own = 3 * np.arange(count)[:, None] + np.arange(3)
        G[n + own[:, :, None], self.G.shape[1] + own[:, None, :]] = Hl_inv
        return type(self)(G, m)

    def marginalised(self, landmarks: Indices, vehicle_rows: Indices = NO_ROWS) -> Self:
        gone = np.concatenate([vehicle_rows, landmark_rows(self.vehicle, landmarks)])
        return type(self)(np.delete(self.G, gone, axis=0), self.vehicle - len(vehicle_rows))

    def coordinates_changed(self, B: Array, columns: slice) -> Self:
        return type(self)(self.G - B @ self.G[columns], self.vehicle)


def _triangle(G: Array) -> Array:
    """Return the (n, n) lower triangle L with L L^T = G G^T."""
    return np.asarray(np.linalg.qr(G.T, mode="r")).T
