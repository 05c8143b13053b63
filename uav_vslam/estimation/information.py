# SPDX-License-Identifier: Apache-2.0
"""The information form: Eq. (4.5.1) to (4.5.8) of [thesis], with one Cholesky factor a frame.

An update factorises the posterior, Y = L L^T. The correction follows from the factor, and so do the marginals that the
next gate needs: P = G G^T with G = L^-T. Until the next update all operations carry the marginals on in closed form.

Landmarks are in the order of their first observation, so those in view are mostly the last rows. The trailing columns
of L^-1 are the inverse of the trailing triangle of L: nothing is inverted for older landmarks, out of view.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular

from uav_vslam.estimation.belief import (
    NO_ROWS,
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
    marginalise_information,
    square_root,
    subtract_product,
    symmetrise,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Known:
    """What one factor of Y determines.

    Attributes:
        first: index of the oldest landmark with known marginals.
        marginals: of the landmarks from `first` on.
    """

    first: int
    marginals: Marginals

    def then(self, marginals: Marginals, *, gone: int = 0) -> Self:
        """Return what is known with other marginals, after `gone` older landmarks were removed."""
        return type(self)(self.first - gone, marginals)


class InformationBelief:
    """Holds `Y`; an update is a sum. Its factor and what is known from it are caches: `Y` alone is the belief."""

    def __init__(self, Y: Array, vehicle: int, known: _Known | None = None) -> None:
        self.Y, self.vehicle = Y, vehicle
        self._factor: Array | None = None
        self._P_vehicle: Array | None = None  # (size, vehicle) columns of P
        self._known = known
        self._first_in_use = 0 if known is None else known.first  # oldest landmark asked for

    @property
    def size(self) -> int:
        return len(self.Y)

    @classmethod
    def from_covariance(cls, P: Array) -> Self:
        L, m = cholesky(P, "initial covariance"), len(P)
        alone = Marginals(P.copy(), np.zeros((0, m, 3)), np.zeros((0, 3, 3)))
        return cls(inverse_from_cholesky(L), m, _Known(0, alone))

    def covariance(self, landmarks: Indices) -> Array:
        if len(landmarks) == 0:
            return self.marginals(landmarks).vehicle
        G = inverse_of_triangle(self._cholesky()).T[state_rows(self.vehicle, landmarks)]
        return np.asarray(G @ G.T)

    def marginals(self, landmarks: Indices) -> Marginals:
        if len(landmarks):
            self._first_in_use = int(landmarks.min())
        known = self._known_from(self._first_in_use)
        return known.marginals.chosen(landmarks - known.first)

    def information(self, rows: Indices) -> Array:
        rest = np.delete(np.arange(self.size), rows)
        return marginalise_information(self.Y, rows, rest, "information")

    def predicted(self, F: Array, Q: Array) -> Self:
        """Apply the matrix inversion lemma to the vehicle; Q = B B^T may be singular and is not inverted.

        Y - Y_v B (I + B^T Y_vv B)^-1 B^T Y_v^T for the Y transformed by F^-1.
        """
        k, Y = len(F), self.Y.copy()
        F_inv, B = np.linalg.inv(F), square_root(Q)
        Y_k = F_inv.T @ Y[:k]
        Y_k[:, :k] = symmetrise(Y_k[:, :k] @ F_inv)
        Y[:k], Y[:, :k] = Y_k, Y_k.T
        L = cholesky(np.eye(k) + B.T @ Y_k[:, :k] @ B, "process noise")
        lost = solve_triangular(L, B.T @ Y_k, lower=True, check_finite=False)
        subtract_product(Y, lost)
        known = self._carried()
        return type(self)(Y, self.vehicle, known and known.then(known.marginals.predicted(F, Q)))

    def cloned(self, rows: Indices, variance: Array) -> Self:
        """Copies c = e + n add (c - e)^T diag(variance)^-1 (c - e) to the information."""
        m, more = self.vehicle, len(rows)
        copies, old = m + np.arange(more), np.r_[:m, m + more : self.size + more]
        Y = np.zeros((self.size + more,) * 2)
        Y[old[:, None], old] = self.Y
        Y[rows, rows] += 1.0 / variance
        Y[copies, copies] = 1.0 / variance
        Y[rows, copies] = Y[copies, rows] = -1.0 / variance
        known = self._carried()
        return type(self)(Y, m + more, known and known.then(known.marginals.cloned(rows, variance)))

    def reset_rows(self, rows: Indices, variance: float) -> Self:
        keep = np.delete(np.arange(self.size), rows)
        Y = np.zeros_like(self.Y)
        Y[np.ix_(keep, keep)] = marginalise_information(self.Y, keep, rows, "information of reset rows")
        Y[rows, rows] = 1.0 / variance
        known = self._carried()
        return type(self)(Y, self.vehicle, known and known.then(known.marginals.reset_rows(rows, variance)))

    def column(self, row: int) -> Array:
        return np.asarray(cho_solve((self._cholesky(), True), np.eye(1, self.size, row)[0], check_finite=False))

    def information_changed(self, row: int, change: float) -> Self:
        Y = self.Y.copy()
        Y[row, row] += change
        return type(self)(Y, self.vehicle)

    def information_removed(self, B: Array) -> Self:
        Y = self.Y.copy()
        Y[: self.vehicle, : self.vehicle] -= B.T @ B
        return type(self)(Y, self.vehicle)

    def updated(self, observation: Observation) -> Update:
        """Y <- Y + H^T H, delta = Y^-1 H^T nu."""
        Y = self.Y.copy()
        i = add_normal_equations(Y, observation, observation.landmarks)
        L = cholesky(Y, "information")
        solved = cho_solve((L, True), np.column_stack([i, np.eye(self.size, self.vehicle)]), check_finite=False)
        delta = solved[:, 0]
        nis = observation.norm2 - float(i @ delta)
        after = type(self)(Y, self.vehicle)
        after._factor, after._P_vehicle, after._first_in_use = L, solved[:, 1:], self._first_in_use
        return Update(after, delta, nis)

    def appended(self, H_vehicle: Array, H_landmark: Array) -> Self:
        n, count = self.size, len(H_vehicle)
        fresh = np.arange((n - self.vehicle) // 3, (n - self.vehicle) // 3 + count)
        Y = np.zeros((n + 3 * count,) * 2)
        Y[:n, :n] = self.Y
        add_normal_equations(Y, Observation(fresh, H_vehicle, H_landmark, np.zeros(H_vehicle.shape[:2])), fresh)
        known = self._carried()
        return type(self)(Y, self.vehicle, known and known.then(known.marginals.appended(H_vehicle, H_landmark)))

    def marginalised(self, landmarks: Indices, vehicle_rows: Indices = NO_ROWS) -> Self:
        gone = np.concatenate([vehicle_rows, landmark_rows(self.vehicle, landmarks)])
        keep = np.delete(np.arange(self.size), gone)
        Y = marginalise_information(self.Y, keep, gone, "information of marginalised states")
        known = self._carried()
        if known is not None:
            older = landmarks < known.first
            left = np.delete(np.arange(len(known.marginals.landmarks)), landmarks[~older] - known.first)
            marginals = known.marginals.chosen(left).without(vehicle_rows)
            known = known.then(marginals, gone=int(older.sum()))
        return type(self)(Y, self.vehicle - len(vehicle_rows), known)

    def coordinates_changed(self, B: Array, columns: slice) -> Self:
        """Y <- T^-T Y T^-1 with T^-1 = I + B E^T."""
        YB = self.Y @ B
        Y = self.Y.copy()
        Y[:, columns] += YB
        Y[columns, :] += YB.T
        Y[columns, columns] += B.T @ YB
        known = self._carried()
        if known is not None:
            m = self.vehicle
            B_landmarks = B[m + 3 * known.first :].reshape(-1, 3, 3)
            known = known.then(known.marginals.coordinates_changed(B[:m], B_landmarks, columns))
        return type(self)(Y, self.vehicle, known)

    def _cholesky(self) -> Array:
        if self._factor is None:
            self._factor = cholesky(self.Y, "information")
        return self._factor

    def _carried(self) -> _Known | None:
        """Return what is known for the next belief; nothing if it would take another factor."""
        if self._factor is not None:
            self._known_from(self._first_in_use)
        return self._known

    def _known_from(self, first: int) -> _Known:
        """Return what is known, with the marginals of the landmarks from `first` on."""
        if self._known is None or first < self._known.first:
            L, m, row = self._cholesky(), self.vehicle, self.vehicle + 3 * first
            if self._P_vehicle is None:
                self._P_vehicle = cho_solve((L, True), np.eye(self.size, m), check_finite=False)
            G = inverse_of_triangle(L[row:, row:]).T.reshape((self.size - row) // 3, 3, self.size - row)
            cross = self._P_vehicle[row:].reshape(len(G), 3, m).transpose(0, 2, 1)
            own = np.einsum("mik,mjk->mij", G, G)
            self._known = _Known(first, Marginals(symmetrise(self._P_vehicle[:m]), cross, own))
        return self._known
