# SPDX-License-Identifier: Apache-2.0
"""The records of a saved map."""

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.common_error_bound import smallest_common_bound
from uav_vslam.geometry.coded_points import block_diagonal, pack_lower, rigid_jacobian, unpack_lower
from uav_vslam.numerics import cholesky
from uav_vslam.types import source_of

Array = NDArray[np.float64]

HASH_CHARACTERS = 16  # 64 bits of SHA-256: it names a map, and detects damage but not attacks


@dataclass(frozen=True, slots=True)
class MapOrigin:
    """Where a map comes from.

    Attributes:
        vehicle, session: name of the vehicle that flew, and number of its start.
        frame: of the positions: its name in TF; local ENU, z up.
        stamp_ns: time of the newest belief inside [ns].
        other_sources: "vehicle/session" of older measurements inside: those of a map that the flight was started from.
        datum: (latitude [deg], longitude [deg], ellipsoidal height [m]) of the frame's origin; None if not known.
    """

    vehicle: str
    session: int
    frame: str
    stamp_ns: int
    other_sources: tuple[str, ...] = ()
    datum: tuple[float, float, float] | None = None

    @property
    def sources(self) -> tuple[str, ...]:
        """Provenance keys of all measurements inside."""
        own = source_of(self.vehicle, self.session)
        return (own, *(source for source in self.other_sources if source != own))


@dataclass(frozen=True, slots=True)
class MapSection:
    """Landmarks of one place with a bound of their joint covariance, J P_T J^T + blkdiag(D_i).

    Attributes:
        anchor: (3,) point about which the common error rotates [m].
        common_factor: (6, 6) lower factor of P_T, order shift [m], rotation [rad], in map axes.
        ids: (N,) uint32 landmark identifiers of the flight.
        positions: (N, 3) in the map frame [m].
        own_factors: (N, 3, 3) lower factors of D_i [m].
        descriptors: (N, D) uint8.
        observations: (N,) frames that showed each landmark.
    """

    anchor: Array
    common_factor: Array
    ids: NDArray[np.uint32]
    positions: Array
    own_factors: Array
    descriptors: NDArray[np.uint8]
    observations: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def covariance(self) -> Array:
        """(3N, 3N) of the positions [m^2]."""
        loading = rigid_jacobian(self.positions - self.anchor) @ self.common_factor
        return np.asarray(loading @ loading.T + block_diagonal(self.own_covariances))

    @property
    def own_covariances(self) -> Array:
        """(N, 3, 3) D_i [m^2]."""
        return np.asarray(self.own_factors @ self.own_factors.transpose(0, 2, 1))

    def common_covariance(self, at: Array) -> Array:
        """Return the (6, 6) covariance of the common error of shift [m] and rotation [rad] about a point (3,)."""
        moved = np.eye(6)
        moved[:3] = rigid_jacobian((at - self.anchor)[None])
        factor = moved @ self.common_factor
        return np.asarray(factor @ factor.T)


@dataclass(frozen=True, slots=True)
class MappedPlace:
    """Landmarks of one place with their joint covariance.

    A flight makes a thousand of them an hour, so the covariance is kept as its Cholesky factor, in single precision:
    that is a quarter of its size, and stays positive definite.

    Attributes:
        ids: (N,) uint32 landmark identifiers of the flight; N > 0.
        positions: (N, 3) in the map frame [m].
        factor: (3N (3N + 1) / 2,) float32, rows of the lower factor [m].
        descriptors: (N, D) uint8.
        observations: (N,) frames that showed each landmark.
    """

    ids: NDArray[np.uint32]
    positions: Array
    factor: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    observations: NDArray[np.uint32]

    @classmethod
    def of(
        cls,
        ids: NDArray[np.uint32],
        positions: Array,
        covariance: Array,
        *,
        descriptors: NDArray[np.uint8],
        observations: NDArray[np.uint32],
    ) -> Self:
        """Return landmarks with a covariance (3N, 3N) [m^2].

        Raises:
            FilterDivergence: the covariance is not positive definite.
        """
        factor = pack_lower(cholesky(covariance, "covariance of mapped landmarks")).astype(np.float32)
        return cls(ids, positions, factor, descriptors, observations)

    @property
    def covariance(self) -> Array:
        """(3N, 3N) of the positions [m^2]."""
        L = unpack_lower(self.factor.astype(float))
        return np.asarray(L @ L.T)

    def section(self) -> MapSection:
        """Return them with a bound of their covariance.

        Raises:
            FilterDivergence: none was found.
        """
        anchor = self.positions.mean(axis=0)
        common, own = smallest_common_bound(self.covariance, rigid_jacobian(self.positions - anchor))
        return MapSection(anchor, common, self.ids, self.positions, own, self.descriptors, self.observations)


@dataclass(frozen=True)  # no slots: the hash is cached
class SavedMap:
    """All landmarks that a flight mapped.

    Attributes:
        origin: whose map it is.
        sections: in the order of the flight; a landmark is in one of them.
    """

    origin: MapOrigin
    sections: tuple[MapSection, ...] = field(default=())

    def __len__(self) -> int:
        return sum(len(section) for section in self.sections)

    @cached_property
    def hash(self) -> str:
        """Name of this very map: it is the `prior_id` of whatever depends on it."""
        digest = hashlib.sha256(repr(self.origin).encode())
        for section in self.sections:
            for array in (section.anchor, section.common_factor, section.ids, section.positions, section.own_factors):
                digest.update(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())
            digest.update(np.ascontiguousarray(section.descriptors).tobytes())
            digest.update(np.ascontiguousarray(section.observations, "<u4").tobytes())
            digest.update(str(section.descriptors.shape).encode())
        return digest.hexdigest()[:HASH_CHARACTERS]

    @property
    def descriptor_size(self) -> int:
        """Bytes of one descriptor; 0 for an empty map."""
        return self.sections[0].descriptors.shape[1] if self.sections else 0


@dataclass(frozen=True, slots=True)
class Mapped:
    """All landmarks that a flight mapped, before the time is spent on bounding their covariances.

    Attributes:
        origin: whose they are.
        places: in the order of the flight; a landmark is in one of them.
    """

    origin: MapOrigin
    places: tuple[MappedPlace, ...] = ()

    def saved_map(self) -> SavedMap:
        """Return the map of them; this takes a second for some ten places.

        Raises:
            FilterDivergence: no bound of a covariance was found.
        """
        return SavedMap(self.origin, tuple(place.section() for place in self.places))
