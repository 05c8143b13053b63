# SPDX-License-Identifier: Apache-2.0
"""Shared landmarks that were removed from the filter's state, kept so that a peer's information on them is not lost.

A removed landmark is not measured again, unless it is a point still tracked, which may come back and is then no longer
remembered. What remains is its position relative to the landmarks that stay, which hardly changes: g = A x + e, with e
treated as independent of all later errors. (The part of e that is correlated with pose and biases is neglected: a
fraction of one measurement's error if many landmarks stay.) So the own belief at any later time and this conditional
form the joint belief over both; in information form they add:

    Y(x, g) = Y_own(x) + [A^T C^-1 A   -A^T C^-1]      C = cov(e)
                         [ -C^-1 A        C^-1  ]

It contains own measurements only: peers decide which landmarks are kept, not their estimates.
"""

import dataclasses
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.geometry.image_grid import spread_after
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.numerics import inverse_spd, solve_spd, symmetrise
from uav_vslam.search import rows_of
from uav_vslam.types import JointInformation

Array = NDArray[np.float64]
Ids = NDArray[np.uint32]
Rows = NDArray[np.intp]

OWN_SIGMA_M = 0.01  # added to C: lower bound for numerical stability


@dataclass(frozen=True, slots=True)
class _Conditional:
    """p(g | x): remembered landmarks given some that are in the state.

    Attributes:
        given: (R,) identifiers of the landmarks in the state, and `at` (R, 3) their positions at linearisation [m].
        ids, positions, descriptors: of the (G,) remembered ones, at linearisation.
        A: (3G, 3R), C_inv: (3G, 3G).
    """

    given: Ids
    at: Array
    ids: Ids
    positions: Array
    descriptors: NDArray[np.uint8]
    A: Array
    C_inv: Array


class LandmarkMemory:
    """Augments each belief of one vehicle with the remembered landmarks.

    Attributes:
        last: the newest belief, augmented; None before the first.
        in_state: (N,) identifiers of its landmarks that are in the filter's state.
    """

    def __init__(self, capacity: int) -> None:
        """Remember at most `capacity` landmarks, spread over the ground."""
        self._capacity = capacity
        self.last: JointInformation | None = None
        self.in_state: Ids = np.zeros(0, np.uint32)
        self._known: _Conditional | None = None

    def extended(
        self, joint: JointInformation, shared: Collection[int], offered: Collection[int] = ()
    ) -> JointInformation:
        """Return the belief with the remembered landmarks appended.

        Args:
            joint: the own belief, later than the last one.
            shared: landmarks matched with peers': remembered once they are removed.
            offered: landmarks that were sent to peers and may be matched later: remembered if capacity permits.
        """
        if self.last is not None and joint.session != self.last.session:
            self.last = self._known = None
        if self.last is not None:
            self._remember(self.last, joint, shared, offered)
        # A copy: its cached covariance is freed with it, while callers keep their record for the whole flight.
        extended = dataclasses.replace(joint) if self._known is None else _joined(joint, self._known)
        self.last, self.in_state = extended, joint.ids
        return extended

    def _remember(
        self, last: JointInformation, joint: JointInformation, shared: Collection[int], offered: Collection[int]
    ) -> None:
        """Condition the removed and the remembered landmarks on those in the state, where some have come back."""
        stay, own = np.isin(last.ids, joint.ids), np.isin(last.ids, self.in_state)
        old = ~own & ~stay
        left = own & ~stay & np.isin(last.ids, np.fromiter({*shared, *offered}, np.uint32))
        known = self._known
        fits = known is None or (np.isin(known.given, joint.ids).all() and not np.isin(known.ids, joint.ids).any())
        if fits and not left.any():
            return
        wanted = self._spread(last, np.flatnonzero(old | left), shared)
        if not stay.any() or len(wanted) == 0:  # the filter was re-initialised: no correlation with the past
            self._known = None
            return
        try:
            self._known = _conditional(last, np.flatnonzero(stay), wanted)
        except FilterDivergence:
            self._known = None

    def _spread(self, joint: JointInformation, rows: Rows, shared: Collection[int]) -> Rows:
        """Return rows up to the capacity, shared ones first, spread over the ground."""
        first = np.isin(joint.ids[rows], np.fromiter(shared, np.uint32, len(shared)))
        return spread_after(joint.positions, rows[first], rows[~first], self._capacity)


def _conditional(joint: JointInformation, given: Rows, wanted: Rows) -> _Conditional:
    P = joint.covariance
    x, g = landmark_rows(POSE_DIM, given), landmark_rows(POSE_DIM, wanted)
    P_xg = P[np.ix_(x, g)]
    A = solve_spd(P[np.ix_(x, x)], P_xg, "covariance of the landmarks that stay").T
    C = symmetrise(P[np.ix_(g, g)] - A @ P_xg) + OWN_SIGMA_M**2 * np.eye(len(g))
    return _Conditional(
        given=joint.ids[given],
        at=joint.positions[given],
        ids=joint.ids[wanted],
        positions=joint.positions[wanted],
        descriptors=joint.descriptors[wanted],
        A=A,
        C_inv=inverse_spd(C, "covariance of remembered landmarks"),
    )


def _joined(joint: JointInformation, known: _Conditional) -> JointInformation:
    """Return the joint belief over state and remembered landmarks."""
    rows = rows_of(known.given, joint.ids)
    moved = (joint.positions[rows] - known.at).ravel()
    CA = known.C_inv @ known.A
    n, g = len(joint.information), len(known.C_inv)
    Y = np.zeros((n + g, n + g))
    Y[:n, :n] = joint.information
    x = landmark_rows(POSE_DIM, rows)
    Y[np.ix_(x, x)] += symmetrise(known.A.T @ CA)
    Y[n:, x] = -CA
    Y[x, n:] = -CA.T
    Y[n:, n:] = known.C_inv
    return dataclasses.replace(
        joint,
        ids=np.concatenate([joint.ids, known.ids]),
        positions=np.vstack([joint.positions, known.positions + (known.A @ moved).reshape(-1, 3)]),
        information=Y,
        descriptors=np.vstack([joint.descriptors, known.descriptors]),
    )
