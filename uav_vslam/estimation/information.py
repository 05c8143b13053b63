# SPDX-License-Identifier: Apache-2.0
"""The information form: Eq. (4.5.1) to (4.5.8) of [thesis], without ever inverting the whole.

Observations concern the few landmarks in view. So the others are eliminated once a frame (Schur complement by a
Cholesky factor), and gate, update and covariance of the vehicle all work on what is left, the *focus*:

    [Y_rr  Y_rf] [e_r]          Y_focus = Y_ff - W^T W,   W = L^-1 Y_rf,   Y_rr = L L^T
    [Y_fr  Y_ff] [e_f]          delta_r = -L^-T W delta_f

An update adds to Y_ff only, so the elimination stays valid through it.
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
class _Focus:
    """The marginal over the vehicle and some landmarks.

    Attributes:
        landmarks: (K,) of the focus.
        rows, rest: of the focus and of all else.
        L: factor of the rest's information, W: (rest, focus) as above.
        Y: (vehicle + 3K, ...) information of the focus.
        factor: lower Cholesky factor of Y.
        marginals: of the focus, once they were asked for.
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
    """Holds `Y`; an update is a sum, and costs the cube of what is in view rather than of the whole map.

    Beside it are kept, once computed, a focus and the vehicle's covariance: `Y` alone is the belief.
    """

    def __init__(self, Y: Array, vehicle: int, P_vehicle: Array | None = None) -> None:
        self.Y, self.vehicle = Y, vehicle
        self._focus: _Focus | None = None
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
                self._P_vehicle = _vehicle_covariance(self._focused(landmarks).factor, self.vehicle)
            self._P_vehicle.flags.writeable = False
            return self._P_vehicle
        focus = self._focused(landmarks)
        return submatrix(inverse_from_cholesky(focus.factor), state_rows(self.vehicle, _places(focus, landmarks)))

    def marginals(self, landmarks: Indices) -> Marginals:
        focus = self._focused(landmarks)
        if focus.marginals is None:
            G = inverse_of_triangle(focus.factor).T
            focus.marginals = Marginals.of_factor(G[: self.vehicle], G[self.vehicle :].reshape(-1, 3, len(G)))
        return focus.marginals.chosen(_places(focus, landmarks))

    def information(self, rows: Indices) -> Array:
        rest = np.delete(np.arange(self.size), rows)
        return marginalise_information(self.Y, rows, rest, "information")

    def predicted(self, F: Array, Q: Array) -> Self:
        """Apply the matrix inversion lemma to the vehicle; Q = B B^T may be singular and is not inverted.

        Y - Y_v B (I + B^T Y_vv B)^-1 B^T Y_v^T for the Y that F^-1 has moved.
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
        Y[np.ix_(keep, keep)] = marginalise_information(self.Y, keep, rows, "information of renewed rows")
        Y[rows, rows] = 1.0 / variance
        return type(self)(Y, self.vehicle)

    def information_removed(self, B: Array) -> Self:
        Y = self.Y.copy()
        Y[: self.vehicle, : self.vehicle] -= B.T @ B
        return type(self)(Y, self.vehicle)

    def updated(self, observation: Observation) -> Update:
        """Y <- Y + H^T H, delta = Y^-1 H^T nu."""
        focus = self._focused(observation.landmarks)
        Y_focus = focus.Y.copy()
        i = add_normal_equations(Y_focus, observation, _places(focus, observation.landmarks))
        factor = cholesky(Y_focus, "information of what is in view")
        delta = np.zeros(self.size)
        delta[focus.rows] = cho_solve((factor, True), i, check_finite=False)
        Y = Y_focus
        if len(focus.rest) or not np.array_equal(focus.rows, np.arange(self.size)):
            pulled = focus.W @ delta[focus.rows]
            delta[focus.rest] = -solve_triangular(focus.L, pulled, lower=True, trans="T", check_finite=False)
            Y = self.Y.copy()
            add_normal_equations(Y, observation, observation.landmarks)
        nis = float(np.sum(observation.nu**2) - i @ delta[focus.rows])
        log_det = log_det_of(factor) - log_det_of(focus.factor)
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
        Y = marginalise_information(self.Y, keep, gone, "information of leaving landmarks")
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

    def _focused(self, landmarks: Indices) -> _Focus:
        """Return a focus that has the landmarks; the last one if it does."""
        if self._focus is None or not np.isin(landmarks, self._focus.landmarks).all():
            self._focus = self._eliminated(landmarks)
        return self._focus

    def _eliminated(self, landmarks: Indices) -> _Focus:
        rows = state_rows(self.vehicle, landmarks)
        rest = np.delete(np.arange(self.size), rows)
        whole = np.array_equal(rows, np.arange(self.size))
        Y = self.Y if whole else submatrix(self.Y, rows)
        L, W = np.zeros((0, 0)), np.zeros((0, len(rows)))
        if len(rest):
            L = cholesky(submatrix(self.Y, rest), "information of what is out of view")
            W = solve_triangular(L, submatrix(self.Y, rest, rows), lower=True, check_finite=False)
            Y -= W.T @ W
        return _Focus(landmarks, rows, rest, L, W, Y, cholesky(Y, "information"))


def _places(focus: _Focus, landmarks: Indices) -> Indices:
    """Return where landmarks stand in a focus."""
    order = np.argsort(focus.landmarks, kind="stable")
    return np.asarray(order[np.searchsorted(focus.landmarks, landmarks, sorter=order)], dtype=np.int64)


def _vehicle_covariance(factor: Array, vehicle: int) -> Array:
    """Return the leading block of (L L^T)^-1."""
    columns = solve_triangular(factor, np.eye(len(factor), vehicle), lower=True, check_finite=False)
    return np.asarray(columns.T @ columns)
