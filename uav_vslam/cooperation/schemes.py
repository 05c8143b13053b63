# SPDX-License-Identifier: Apache-2.0
"""Schemes that fuse a peer's packet with the own belief; none writes back into the filter.

The thesis's forms, which do write back, are in `studies.engine.write_back`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.estimation.covariance_intersection import (
    WEIGHTS,
    Fused,
    Split,
    inverse_covariance_intersection,
    split_covariance_intersection,
)
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.numerics import mahalanobis2, symmetrise

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

FALSE_ALARM = 1e-8  # probability that right evidence is said to contradict the own state, per packet


@dataclass(frozen=True, slots=True)
class Evidence:
    """A packet as a measurement of the own state x.

    Attributes:
        E: (k, n) measurement matrix.
        innovation: (k,) its estimate minus E x [m].
        R: (k, k) its covariance [m^2].
        floor: (k, k) independent error: two matched descriptors rarely show exactly the same point [m^2].
        dependent: some of its measurements, or a prior, are in the own belief already.
    """

    E: Array
    innovation: Array
    R: Array
    floor: Array
    dependent: bool

    @staticmethod
    def of_landmarks(
        own: Array, rows: Rows, peer: Array, R: Array, *, floor_sigma_m: float, dependent: bool
    ) -> "Evidence":
        """Return a peer's estimate of some own landmarks as evidence on position, rotation and landmarks.

        Args:
            own: (N, 3) own landmarks [m].
            rows: (K,) of those that the peer shares.
            peer, R: (K, 3) and (3K, 3K) its estimate and covariance of them, in the own frame [m], [m^2].
            floor_sigma_m: of each pair: two detections are never of exactly the same point [m].
            dependent: see `Evidence`.
        """
        columns = landmark_rows(POSE_DIM, rows)
        E = np.zeros((len(columns), POSE_DIM + own.size))
        E[np.arange(len(columns)), columns] = 1.0
        floor = floor_sigma_m**2 * np.eye(len(columns))
        return Evidence(E, (peer - own[rows]).ravel(), R, floor, dependent)

    def with_known_floor(self) -> "Evidence":
        """Return it with a floor that may be in the own belief already: feedback comes over pairs of a packet."""
        return replace(self, R=self.R + self.floor, floor=np.zeros_like(self.floor))

    def contradicts(self, P: Array) -> bool:
        """Return whether the innovation is impossible given the (n, n) covariance P of the own state.

        Each pair may pass its gate where all together can't be right. Of dependent evidence the correlation is unknown:
        (a + b)(a + b)^T <= 2 (a a^T + b b^T).
        """
        S = symmetrise(self.E @ P @ self.E.T) + self.R + self.floor
        limit = chdtri(len(S), FALSE_ALARM) * (2.0 if self.dependent else 1.0)
        return bool(mahalanobis2(self.innovation, S) > limit)


def split_ci(own: Split, evidence: Evidence, weigh: str) -> Fused:
    """Add independent evidence, intersect dependent: always consistent, and as good as a sum where a sum is valid."""
    return (full_ci if evidence.dependent else overlay)(own, evidence, weigh)


def full_ci(own: Split, evidence: Evidence, weigh: str) -> Fused:
    """Intersect the whole joint belief with every packet, one weight for all: always consistent, and cautious."""
    dependent = Split(np.zeros_like(own.total), own.total)
    peer = Split(evidence.floor, evidence.R)
    return split_covariance_intersection(dependent, evidence.E, evidence.innovation, peer, weigh=WEIGHTS[weigh])


def overlay(own: Split, evidence: Evidence, weigh: str) -> Fused:
    """Add every packet: consistent only if no two beliefs ever shared a measurement or a prior."""
    del weigh
    R = evidence.R + evidence.floor
    return split_covariance_intersection(own, evidence.E, evidence.innovation, Split(R, np.zeros_like(R)))


def inverse_ci(own: Split, evidence: Evidence, weigh: str) -> Fused:
    """Inverse covariance intersection: consistent if beliefs are correlated by common information alone [noack17]."""
    del weigh
    R = evidence.R + evidence.floor
    return inverse_covariance_intersection(own.total, evidence.E, evidence.innovation, R)


SCHEMES: dict[str, Callable[[Split, Evidence, str], Fused]] = {
    "split_ci": split_ci,
    "full_ci": full_ci,
    "overlay": overlay,
    "inverse_ci": inverse_ci,
}
