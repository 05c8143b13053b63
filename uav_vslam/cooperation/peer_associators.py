# SPDX-License-Identifier: Apache-2.0
"""Data association between a peer's map and ours, in a common frame: methods by name, `fusion.association`.

consistent            the nearest descriptor, then a gate, then consistency of pairs and of all: see `common_landmarks`
gated                 geometry first: the nearest descriptor inside the gate of the two landmarks' positions
nn                    the nearest descriptor, without a gate: the conventional method of section 6.4 of [thesis]
ransac, gtm, hgtm     nn with outlier rejection by one transform, by neighbourhood graphs, by shapes of triangles
gated_ransac, ...     gated with the same outlier rejection
cds                   nn, for a few of the peer's landmarks spread over the ground
coarse_fine           the nearest descriptors, a fixed number of the best: section 7.4.2 of [thesis]

They are those of `uav_vslam.association` with points on the ground in place of pixels. Classification is missing: a
packet has one descriptor a landmark, and with classes of one view each it is `nn`.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.association.hgtm import same_shapes
from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.common_landmarks import (
    GROUND_DOF,
    POINT_DOF,
    blocks,
    comparable,
    descriptor_matches,
    find_common,
)
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.point_pairs import PointPairs
from uav_vslam.cooperation.two_point import gated as inliers
from uav_vslam.cooperation.two_point import hypotheses
from uav_vslam.numerics import mahalanobis2
from uav_vslam.types import LandmarkPacket
from uav_vslam.vision.compact_descriptors import in_basis, single_distance
from uav_vslam.vision.matching.cds import dominating_points
from uav_vslam.vision.matching.gtm import same_neighbours
from uav_vslam.vision.matching.nn_ratio import match_gated, squared_distances

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]
InlierSelection = Callable[[PointPairs, FusionConfig], NDArray[np.intp]]

FINE_PAIRS = 20  # "the first certain number of pairs": a third of a wideband packet


class PeerAssociator(Protocol):
    """Associates own landmarks with those of a packet in the same frame; deterministic."""

    def __call__(self, own: OwnLandmarks, packet: LandmarkPacket, *, config: FusionConfig) -> Pairs:
        """Return (K, 2) rows of own landmarks and of the packet, none used twice; see `find_common`."""
        ...


def associate(own: OwnLandmarks, packet: LandmarkPacket, *, config: FusionConfig) -> Pairs:
    """Return the common landmarks by the configured method; none if fewer than `min_common`.

    Args:
        own: in the common frame.
        packet: the peer's.
        config: method, ratio, gate and the smallest number of pairs that is accepted.

    Returns:
        (K, 2) rows of own landmarks and of the packet.
    """
    pairs = PEER_ASSOCIATORS[config.association](own, packet, config=config)
    return pairs if len(pairs) >= config.min_common else pairs[:0]


def nn(own: OwnLandmarks, packet: LandmarkPacket, *, config: FusionConfig) -> Pairs:
    """Match mutual nearest descriptors that pass the ratio test."""
    return descriptor_matches(own.descriptors, packet, config.ratio)


def gated(own: OwnLandmarks, packet: LandmarkPacket, *, config: FusionConfig) -> Pairs:
    """Match mutual nearest descriptors with ratio test among the pairs inside the gate."""
    if len(packet) == 0 or not comparable(own.descriptors, packet):
        return np.zeros((0, 2), np.intp)
    k, m = np.arange(len(own)), np.arange(len(packet))
    S = blocks(own.covariance)[k, k][:, None] + blocks(packet.covariance)[m, m] + config.floor_sigma_m**2 * np.eye(3)
    distance2 = mahalanobis2(packet.positions - own.positions[:, None], S)
    basis = packet.descriptor_basis
    return match_gated(
        in_basis(own.descriptors, basis),
        packet.descriptors,
        distance2 <= chdtri(POINT_DOF, 1.0 - config.gate_probability),
        config.ratio,
        single_distance=single_distance(basis),
    )


def cds(own: OwnLandmarks, packet: LandmarkPacket, *, config: FusionConfig) -> Pairs:
    """Match as `nn`, and keep only a connected dominating set of the packet's landmarks on the ground."""
    pairs = nn(own, packet, config=config)
    return pairs[np.isin(pairs[:, 1], dominating_points(packet.positions[:, :2]))]


def coarse_fine(own: OwnLandmarks, packet: LandmarkPacket, *, config: FusionConfig) -> Pairs:
    """Match mutual nearest descriptors without ratio test, and keep those with the smallest distances."""
    pairs = descriptor_matches(own.descriptors, packet, 1.0)
    if len(pairs) == 0:
        return pairs
    distance2 = squared_distances(in_basis(own.descriptors, packet.descriptor_basis), packet.descriptors)
    order = np.argsort(distance2[pairs[:, 0], pairs[:, 1]], kind="stable")
    return pairs[np.sort(order[:FINE_PAIRS])]


def with_outlier_rejection(method: PeerAssociator, select: InlierSelection) -> PeerAssociator:
    """Add outlier rejection to a method."""

    def associate_and_reject(own: OwnLandmarks, packet: LandmarkPacket, *, config: FusionConfig) -> Pairs:
        pairs = method(own, packet, config=config)
        return pairs[select(PointPairs.of(own, packet, pairs, config.floor_sigma_m), config)]

    return associate_and_reject


def _one_transform(points: PointPairs, config: FusionConfig) -> NDArray[np.intp]:
    """Return the inliers of the best yaw and translation by two-point RANSAC; none unless they exceed a sample."""
    relative = points.relative()
    tried = hypotheses(relative, rng=np.random.default_rng(0))
    rows = inliers(relative, tried.best()) if len(tried) else np.zeros(0, np.intp)
    return rows if len(rows) > 2 else rows[:0]


def _same_neighbours(points: PointPairs, config: FusionConfig) -> NDArray[np.intp]:
    """Return the pairs with the same neighbours on the ground in both maps."""
    return same_neighbours(points.own[:, :2], points.peer[:, :2])


def _same_shapes(points: PointPairs, config: FusionConfig) -> NDArray[np.intp]:
    """Return the pairs whose triangles on the ground have equal shapes within the maps' relative errors."""
    if len(points) == 0:
        return np.zeros(0, np.intp)
    variance = points.relative().pair_covariances(np.eye(3))[:, :GROUND_DOF, :GROUND_DOF]
    sigma_m = float(np.sqrt(np.median(np.trace(variance, axis1=1, axis2=2)) / GROUND_DOF))
    tolerance_m = sigma_m * float(np.sqrt(chdtri(GROUND_DOF, 1.0 - config.gate_probability)))
    return same_shapes(points.own[:, :2], points.peer[:, :2], tolerance=tolerance_m)


OUTLIER_REJECTION: dict[str, InlierSelection] = {
    "ransac": _one_transform,
    "gtm": _same_neighbours,
    "hgtm": _same_shapes,
}

PEER_ASSOCIATORS: dict[str, PeerAssociator] = {
    "consistent": find_common,
    "gated": gated,
    "nn": nn,
    **{name: with_outlier_rejection(nn, select) for name, select in OUTLIER_REJECTION.items()},
    **{f"gated_{name}": with_outlier_rejection(gated, select) for name, select in OUTLIER_REJECTION.items()},
    "cds": cds,
    "coarse_fine": coarse_fine,
}
