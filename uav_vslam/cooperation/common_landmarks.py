# SPDX-License-Identifier: Apache-2.0
"""Data association between a peer's map and ours: descriptors, then gate, then consistency of the matches.

The ratio test precedes the gate, which would leave it no second neighbour. Covariance intersection protects against
correlation, not against outliers, so the matches must be pairwise consistent, cf. [mangelson18], each must be where all
others together predict it, and they must be closer together than wrong ones come by chance: in the wide gates of a map
that is very uncertain, these agree, too.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, gammaln

from uav_vslam.association.clique import largest_clique
from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.data_snooping import predicted_by_others
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.received_map import PeerLandmarks
from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.numerics import inverse_spd, mahalanobis2, submatrix
from uav_vslam.types import LandmarkPacket
from uav_vslam.vision.compact_descriptors import RAW, in_basis, load_basis, single_distance
from uav_vslam.vision.matching.nn_ratio import match_descriptors

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]

POINT_DOF = 3
GROUND_DOF = 2
MAX_GATE_SHARE = 0.5  # of the map: a match whose gate covers more of it, given the others, is no evidence
LOG_CHANCE = np.log(1e-3)  # largest expected number of sets of matches that agree as well, of wrong ones alone


def find_common(own: OwnLandmarks, packet: LandmarkPacket, *, config: FusionConfig) -> Pairs:
    """Match own landmarks with a packet's: the default of `peer_associators`, which has the others.

    Args:
        own: in the common frame.
        packet: the peer's.
        config: ratio and gate.

    Returns:
        (K, 2) rows of own landmarks and of the packet.
    """
    pairs = descriptor_matches(own.descriptors, packet, config.ratio)
    proposed, peer_covariance = len(pairs), packet.covariance
    maps = own.positions, own.covariance, packet.positions, peer_covariance
    pairs = pairs[gated(pairs, *maps, config)]
    pairs = pairs[consistent(pairs, *maps, config)]
    pairs = pairs[jointly_consistent(pairs, *maps, config)]
    S = ground_covariance(pairs, own.covariance, peer_covariance, config)
    return pairs[beyond_chance(S, proposed, map_area(own.positions), config)]


def gated(pairs: Pairs, own: Array, P: Array, peer: Array, R: Array, config: FusionConfig) -> Pairs:
    """Return the rows of (K, 2) pairs whose landmarks coincide within E P E^T + R + floor.

    Args:
        pairs: rows of own landmarks and of the peer's.
        own, P: (N, 3) and (3N, 3N) own landmarks and their covariance [m], [m^2].
        peer, R: (M, 3) and (3M, 3M) the peer's, in the same frame.
        config: gate and floor.
    """
    a, b = pairs[:, 0], pairs[:, 1]
    S = blocks(P)[a, a] + blocks(R)[b, b] + config.floor_sigma_m**2 * np.eye(3)
    return np.flatnonzero(mahalanobis2(peer[b] - own[a], S) <= chdtri(POINT_DOF, 1.0 - config.gate_probability))


def descriptor_matches(
    descriptors: NDArray[np.uint8], packet: PeerLandmarks, ratio: float, *, mutual: bool = True
) -> Pairs:
    """Match own descriptors (N, D), as extracted, with a packet's; none if their kinds differ."""
    if len(packet) == 0 or not comparable(descriptors, packet):
        return np.zeros((0, 2), np.intp)
    basis = packet.descriptor_basis
    return match_descriptors(
        in_basis(descriptors, basis),
        packet.descriptors,
        ratio,
        mutual=mutual,
        single_distance=single_distance(basis),
    )


def comparable(descriptors: NDArray[np.uint8], packet: PeerLandmarks) -> bool:
    """Return whether own descriptors (N, D), as extracted, and a packet's are of the same kind."""
    own = descriptors.shape[1]
    if packet.descriptor_basis != RAW:
        return own == len(load_basis(packet.descriptor_basis).mean)
    return len(packet) == 0 or own == packet.descriptors.shape[1]


def blocks(covariance: Array) -> Array:
    """View a (3N, 3N) covariance as (N, N, 3, 3) blocks."""
    n = len(covariance) // 3
    return covariance.reshape(n, 3, n, 3).transpose(0, 2, 1, 3)


def consistent(pairs: Pairs, own: Array, P: Array, peer: Array, R: Array, config: FusionConfig) -> Pairs:
    """Return the rows of the largest set of pairwise consistent matches: equal offsets in both maps.

    Arguments as for `gated`.
    """
    i, j = np.triu_indices(len(pairs), 1)
    a, b = pairs[:, 0], pairs[:, 1]
    offset = (peer[b[j]] - peer[b[i]]) - (own[a[j]] - own[a[i]])
    S = offset_covariances(P, a[i], a[j]) + offset_covariances(R, b[i], b[j]) + 2 * config.floor_sigma_m**2 * np.eye(3)
    agree = mahalanobis2(offset, S) <= chdtri(POINT_DOF, 1.0 - config.gate_probability)
    graph = np.zeros((len(pairs), len(pairs)), dtype=bool)
    graph[i, j] = graph[j, i] = agree
    return largest_clique(graph)


def jointly_consistent(pairs: Pairs, own: Array, P: Array, peer: Array, R: Array, config: FusionConfig) -> Pairs:
    """Return the rows of the matches whose landmarks coincide as all others predict; a single one is gated already.

    Arguments as for `gated`.
    """
    a, b = pairs[:, 0], pairs[:, 1]
    S = submatrix(P, landmark_rows(0, a)) + submatrix(R, landmark_rows(0, b))
    B = inverse_spd(S + config.floor_sigma_m**2 * np.eye(len(S)), "differences of two maps")
    return predicted_by_others(B, peer[b] - own[a], chdtri(POINT_DOF, 1.0 - config.gate_probability), least=1)


def offset_covariances(covariance: Array, i: Pairs, j: Pairs) -> Array:
    """Return the (M, 3, 3) covariances of x_j - x_i, for points x with joint covariance (3N, 3N)."""
    B = blocks(covariance)
    return np.asarray(B[i, i] + B[j, j] - B[i, j] - B[j, i])


def map_area(points: Array) -> float:
    """Return the ground area that (N, 3) points cover [m^2]: that of a rectangle with the same second moments."""
    if len(points) <= GROUND_DOF:
        return 0.0
    return 12.0 * float(np.sqrt(np.linalg.det(np.cov(points[:, :GROUND_DOF], rowvar=False))))


def ground_covariance(pairs: Pairs, P: Array, R: Array, config: FusionConfig) -> Array:
    """Return the (2K, 2K) joint covariance of the horizontal differences of K pairs."""
    own, peer = (landmark_rows(0, rows).reshape(-1, POINT_DOF)[:, :GROUND_DOF].ravel() for rows in pairs.T)
    return submatrix(P, own) + submatrix(R, peer) + config.floor_sigma_m**2 * np.eye(GROUND_DOF * len(pairs))


def beyond_chance(S: Array, proposed: int, area: float, config: FusionConfig) -> Pairs:
    """Return the rows of those matches whose agreement wrong ones would not reach by chance, cf. [moisan04].

    A wrong match is uniform over the map, so it falls into a gate with p = area of the gate / area of the map; on flat
    ground height does not discriminate. Each match is judged given the others, then all together.

    Args:
        S: (2K, 2K) joint covariance of the matches' horizontal differences.
        proposed: number of matches by descriptor alone.
        area: of the map [m^2].
        config: gate.
    """
    rows, gate = np.arange(len(S) // GROUND_DOF), chdtri(GROUND_DOF, 1.0 - config.gate_probability)
    while len(rows):
        k = np.arange(len(rows))
        information = inverse_spd(_of_rows(S, rows), "differences of two maps").reshape(len(k), GROUND_DOF, len(k), -1)
        gates = np.pi * gate / np.sqrt(np.linalg.det(information[k, :, k]))
        widest = int(np.argmax(gates))
        if gates[widest] <= MAX_GATE_SHARE * area:
            break
        rows = np.delete(rows, widest)
    return rows if _log_chance(_of_rows(S, rows), proposed, area, config) <= LOG_CHANCE else rows[:0]


def _log_chance(S: Array, proposed: int, area: float, config: FusionConfig) -> float:
    """Return the log of the expected number of sets of wrong matches inside the joint gate; see `beyond_chance`."""
    k = len(S) // GROUND_DOF
    if k == 0:
        return 0.0
    gate = chdtri(GROUND_DOF * k, 1.0 - config.gate_probability)
    log_volume = k * float(np.log(np.pi * gate)) - float(gammaln(k + 1)) + 0.5 * float(np.linalg.slogdet(S)[1])
    return log_sets(proposed, k) + log_volume - k * float(np.log(area))


def log_sets(n: int, k: int) -> float:
    """Return the log of the number of sets of k out of n."""
    return float(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))


def _of_rows(S: Array, rows: Pairs) -> Array:
    return submatrix(S, (GROUND_DOF * rows[:, None] + np.arange(GROUND_DOF)).ravel())
