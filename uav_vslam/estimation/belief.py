# SPDX-License-Identifier: Apache-2.0
"""The Gaussian over the errors of a vehicle and its landmarks, in one of three forms.

The first `vehicle` rows of the error belong to the vehicle, followed by three for each landmark. Beliefs are immutable;
each operation returns a new one, so a rejected step needs no undo. The forms are `information.InformationBelief`,
`covariance.CovarianceBelief` and `square_root.SquareRootBelief`.

Symbols: `P` covariance, `Y = P^-1`, `F, Q` process, `H` observation Jacobian, `nu` innovation. Observations are
whitened (unit noise covariance), so `S = H P H^T + I`.
"""

import dataclasses
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import FilterDivergence
from uav_vslam.numerics import submatrix, symmetrise

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

NO_ROWS: Indices = np.zeros(0, np.int64)
RANK_TOLERANCE = 1e-14  # of an eigenvalue of information, relative to the largest


@dataclass(frozen=True, slots=True)
class Observation:
    """Whitened linear observations of some landmarks, `nu = H_vehicle e_vehicle + H_landmark e_landmark + noise`.

    Attributes:
        landmarks: (M,) indices, each at most once.
        H_vehicle: (M, k, vehicle), H_landmark: (M, k, 3).
        nu: (M, k) innovations.
        of_vehicle: further observations, of the vehicle alone.
    """

    landmarks: Indices
    H_vehicle: Array
    H_landmark: Array
    nu: Array
    of_vehicle: "VehicleObservation | None" = None

    @property
    def norm2(self) -> float:
        """nu^T nu of all observations."""
        return float(np.sum(self.nu**2)) + (0.0 if self.of_vehicle is None else self.of_vehicle.norm2)

    def apply(self, error: Array) -> Array:
        """Return (M, k) H e for an error (vehicle + 3N,)."""
        m = self.H_vehicle.shape[2]
        at = error[m:].reshape(-1, 3)[self.landmarks]
        return np.asarray(self.H_vehicle @ error[:m] + np.einsum("nki,ni->nk", self.H_landmark, at))


@dataclass(frozen=True, slots=True)
class VehicleObservation:
    """Whitened linear observations `nu = H e_vehicle + noise` of the vehicle alone, as their normal equations.

    Attributes:
        Y: (vehicle, vehicle) H^T H.
        i: (vehicle,) H^T nu.
        norm2: nu^T nu.
        dof: number of observations.
    """

    Y: Array
    i: Array
    norm2: float
    dof: int

    def about(self, delta: Array) -> "VehicleObservation":
        """Return the same about e_vehicle + delta, for an error of a mean that is by delta (vehicle,) elsewhere."""
        added = self.Y @ delta
        norm2 = self.norm2 + float(delta @ (2.0 * self.i + added))
        return dataclasses.replace(self, i=self.i + added, norm2=norm2)

    def rows(self) -> tuple[Array, Array, float]:
        """Return H (K, vehicle) and nu (K,) with the same Y and i in as few rows as possible, and norm2 - nu^T nu."""
        values, vectors = np.linalg.eigh(self.Y)
        known = values > RANK_TOLERANCE * values[-1]
        root = np.sqrt(values[known])
        nu = (vectors[:, known].T @ self.i) / root
        return (vectors[:, known] * root).T, nu, self.norm2 - float(nu @ nu)


@dataclass(frozen=True, slots=True)
class Marginals:
    """Marginal covariances of the vehicle and of each of M landmarks: all that a gate needs.

    Attributes:
        vehicle: (vehicle, vehicle).
        cross: (M, vehicle, 3) of the vehicle with each landmark.
        landmarks: (M, 3, 3).
    """

    vehicle: Array
    cross: Array
    landmarks: Array

    @classmethod
    def of_factor(cls, G_vehicle: Array, G_landmarks: Array) -> "Marginals":
        """Return G G^T for the rows of the vehicle (vehicle, k) and of the landmarks (M, 3, k)."""
        cross = (G_vehicle @ G_landmarks.reshape(-1, G_vehicle.shape[1]).T).reshape(len(G_vehicle), -1, 3)
        own = np.einsum("mik,mjk->mij", G_landmarks, G_landmarks)
        return cls(G_vehicle @ G_vehicle.T, cross.transpose(1, 0, 2), own)

    def chosen(self, landmarks: Indices) -> "Marginals":
        """Return the marginals of some of the M landmarks."""
        return Marginals(self.vehicle.copy(), self.cross[landmarks], self.landmarks[landmarks])

    def without(self, vehicle_rows: Indices) -> "Marginals":
        """Return the marginals without some rows of the vehicle."""
        keep = np.delete(np.arange(len(self.vehicle)), vehicle_rows)
        return Marginals(submatrix(self.vehicle, keep), self.cross[:, keep], self.landmarks)

    def predicted(self, F: Array, Q: Array) -> "Marginals":
        """Return those after `Belief.predicted`."""
        cross = self.cross.copy()
        cross[:, : len(F)] = F @ cross[:, : len(F)]
        return Marginals(propagated(self.vehicle, F, Q), cross, self.landmarks)

    def cloned(self, rows: Indices, variance: Array) -> "Marginals":
        """Return those after `Belief.cloned`."""
        vehicle = with_copies(self.vehicle, len(self.vehicle), rows, variance)
        return Marginals(vehicle, np.concatenate([self.cross, self.cross[:, rows]], axis=1), self.landmarks)

    def reset_rows(self, rows: Indices, variance: float) -> "Marginals":
        """Return those after `Belief.reset_rows`."""
        vehicle, cross = self.vehicle.copy(), self.cross.copy()
        vehicle[rows], vehicle[:, rows], cross[:, rows] = 0.0, 0.0, 0.0
        vehicle[rows, rows] = variance
        return Marginals(vehicle, cross, self.landmarks)

    def appended(self, H_vehicle: Array, H_landmark: Array) -> "Marginals":
        """Return those after `Belief.appended`: the new landmarks' errors are A e_vehicle + H_landmark^-1 noise."""
        Hl_inv = np.linalg.inv(H_landmark)
        A = -Hl_inv @ H_vehicle
        cross = self.vehicle @ A.transpose(0, 2, 1)
        own = A @ cross + Hl_inv @ Hl_inv.transpose(0, 2, 1)
        return Marginals(
            self.vehicle, np.concatenate([self.cross, cross]), np.concatenate([self.landmarks, symmetrise(own)])
        )

    def coordinates_changed(self, B_vehicle: Array, B_landmarks: Array, columns: slice) -> "Marginals":
        """Return those after `Belief.coordinates_changed`, e <- e - B e_columns.

        Args:
            B_vehicle: (vehicle, 3) and B_landmarks (M, 3, 3), the rows of B.
            columns: those of the vehicle that B refers to.
        """
        B_T = B_landmarks.transpose(0, 2, 1)
        pulled = B_landmarks @ self.cross[:, columns]
        own = self.landmarks - pulled - pulled.transpose(0, 2, 1) + B_landmarks @ self.vehicle[columns, columns] @ B_T
        cross = self.cross - self.vehicle[:, columns] @ B_T
        vehicle = self.vehicle - B_vehicle @ self.vehicle[columns]
        vehicle = vehicle - vehicle[:, columns] @ B_vehicle.T
        return Marginals(vehicle, cross - B_vehicle @ cross[:, columns], own)


@dataclass(frozen=True, slots=True)
class Update:
    """The outcome of an update.

    Attributes:
        belief: posterior.
        delta: (vehicle + 3N,) correction of the mean.
        nis: nu^T S^-1 nu.
    """

    belief: "Belief"
    delta: Array
    nis: float


class Belief(Protocol):
    """One form of the Gaussian; operations raise `FilterDivergence` if positive definiteness is lost."""

    @property
    def vehicle(self) -> int:
        """Number of rows of the vehicle."""

    @property
    def size(self) -> int:
        """Total number of rows."""

    @classmethod
    def from_covariance(cls, P: Array) -> Self:
        """Return the belief over a vehicle without landmarks, from its (vehicle, vehicle) covariance."""

    def covariance(self, landmarks: Indices) -> Array:
        """Return (vehicle + 3M, vehicle + 3M), the covariance of the vehicle and the given landmarks; read-only."""

    def marginals(self, landmarks: Indices) -> Marginals:
        """Return only this covariance's vehicle block and the blocks of each landmark, at lower cost."""

    def information(self, rows: Indices) -> Array:
        """Return the (R, R) information over `rows`, the others marginalised."""

    def predicted(self, F: Array, Q: Array) -> Self:
        """Propagate the first k rows of the vehicle: P <- F P F^T + Q, with F and Q (k, k) and F invertible."""

    def cloned(self, rows: Indices, variance: Array) -> Self:
        """Append copies of some rows of the vehicle to it, each with independent noise of a (rows,) variance."""

    def reset_rows(self, rows: Indices, variance: float) -> Self:
        """Reset some rows of the vehicle: they become independent of all others, with the given variance."""

    def column(self, row: int) -> Array:
        """Return the covariances (size,) of a row of the vehicle with all rows."""

    def information_changed(self, row: int, change: float) -> Self:
        """Add information to a row of the vehicle, or take it away."""

    def information_removed(self, B: Array) -> Self:
        """Subtract information from the vehicle: P <- (P^-1 - B^T B)^-1 with B (k, vehicle)."""

    def updated(self, observation: Observation) -> Update:
        """Update with observations."""

    def appended(self, H_vehicle: Array, H_landmark: Array) -> Self:
        """Add landmarks without prior, by whitened observations (M, 3, vehicle) and (M, 3, 3)."""

    def marginalised(self, landmarks: Indices, vehicle_rows: Indices = NO_ROWS) -> Self:
        """Marginalise landmarks and some rows of the vehicle out."""

    def coordinates_changed(self, B: Array, columns: slice) -> Self:
        """Change coordinates to T e with T = I - B E^T, E selecting `columns`; `B` (size, 3) is zero in those rows."""


def state_rows(vehicle: int, landmarks: Indices) -> Indices:
    """Return the rows of the vehicle, then of some landmarks."""
    return np.concatenate([np.arange(vehicle), landmark_rows(vehicle, landmarks)])


def landmark_rows(vehicle: int, landmarks: Indices) -> Indices:
    """Return the 3M rows of M landmarks."""
    return np.asarray((vehicle + 3 * np.asarray(landmarks)[:, None] + np.arange(3)).ravel(), dtype=np.int64)


def propagated(P: Array, F: Array, Q: Array) -> Array:
    """Return the covariance P (size, size) after the process F, Q (k, k) of its first k rows."""
    k, P = len(F), P.copy()
    P[:k, :] = F @ P[:k, :]
    P[:, :k] = P[:, :k] @ F.T
    P[:k, :k] = symmetrise(P[:k, :k] + Q)
    return P


def with_copies(P: Array, at: int, rows: Indices, variance: Array) -> Array:
    """Return the covariance P with noisy copies of some rows inserted before row `at`, see `Belief.cloned`."""
    copied = np.insert(np.arange(len(P)), at, rows)
    P = submatrix(P, copied)
    own = at + np.arange(len(rows))
    P[own, own] += variance
    return P


def share_left(change: float, variance: float) -> float:
    """Return by what a variance is divided if information is added; see `Belief.information_changed`.

    Raises:
        FilterDivergence: more is taken away than there is.
    """
    left = 1.0 + change * variance
    if not left > 0.0:
        raise FilterDivergence(f"{-change:.3e} of information can't be taken from a variance of {variance:.3e}")
    return left


def add_normal_equations(Y: Array, observation: Observation, places: Indices) -> Array:
    """Add H^T H, dense in the vehicle and block-diagonal in the landmarks, to Y (size, size); return H^T nu (size,).

    Args:
        Y: modified in place.
        observation: of M landmarks.
        places: (M,) indices of these landmarks among those of Y, each once.
    """
    m = observation.H_vehicle.shape[2]
    Hv, Hl, nu = observation.H_vehicle, observation.H_landmark, observation.nu
    flat = Hv.reshape(-1, m)
    columns = m + 3 * places[:, None] + np.arange(3)
    cross = (Hv.transpose(0, 2, 1) @ Hl).transpose(1, 0, 2).reshape(m, -1)
    Y[:m, :m] += flat.T @ flat
    Y[:m, columns.ravel()] += cross
    Y[columns.ravel(), :m] += cross.T
    Y[columns[:, :, None], columns[:, None, :]] += Hl.transpose(0, 2, 1) @ Hl
    i = np.zeros(len(Y))
    i[:m] = flat.T @ nu.ravel()
    i[columns] = np.einsum("nka,nk->na", Hl, nu)
    if observation.of_vehicle is not None:
        Y[:m, :m] += observation.of_vehicle.Y
        i[:m] += observation.of_vehicle.i
    return i
