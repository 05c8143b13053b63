# SPDX-License-Identifier: Apache-2.0
"""Precision and recall of landmark association between vehicles: of each stage of the default, and of each method."""

import dataclasses
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.config import FUSION_ASSOCIATIONS, FusionConfig
from uav_vslam.cooperation.common_landmarks import POINT_DOF, descriptor_matches, find_common
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.peer_associators import associate
from uav_vslam.cooperation.point_pairs import PointPairs
from uav_vslam.evaluation.study import Row
from uav_vslam.numerics import mahalanobis2
from uav_vslam.studies.engine.pool import ratio
from uav_vslam.types import JointInformation, LandmarkPacket

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]
Names = Mapping[int, int]  # true identity of each of a vehicle's landmarks, by its identifier

STAGES = ("ratio", "+ mutual", "+ gate", "+ consistency")
UNKNOWN_FRAME = "ratio, mutual, alignment (frame unknown)"


@dataclass(frozen=True, slots=True)
class Identities:
    """True identities of two vehicles' landmarks.

    Attributes:
        own, peer: true identity of each vehicle's landmarks.
        mistaken: identifiers of the peer's landmarks that look like others: no method could match those.
    """

    own: Names
    peer: Names
    mistaken: Collection[int] = ()


@dataclass(frozen=True, slots=True)
class Score:
    """Counts: pairs that a stage keeps, right ones among them, landmarks that these match, landmarks that could be.

    A vehicle may have one landmark twice, so that several right pairs match it.
    """

    left: int = 0
    right: int = 0
    found: int = 0
    findable: int = 0

    def __add__(self, other: "Score") -> "Score":
        return Score(
            self.left + other.left,
            self.right + other.right,
            self.found + other.found,
            self.findable + other.findable,
        )

    @property
    def wrong(self) -> int:
        """Pairs that are not right."""
        return self.left - self.right

    def row(self) -> Row:
        """Return precision and recall."""
        return {"precision": ratio(self.right, self.left), "recall": ratio(self.found, self.findable)}


def pairs_by_stage(joint: JointInformation, packet: LandmarkPacket, config: FusionConfig) -> dict[str, Pairs]:
    """Return the pairs that each stage of the default keeps, in a common frame.

    Args:
        joint: the own belief.
        packet: a peer's.
        config: ratio, gate and floor; any number of pairs is accepted.
    """
    own = OwnLandmarks.of(joint)
    one_way = descriptor_matches(joint.descriptors, packet, config.ratio, mutual=False)
    mutual = descriptor_matches(joint.descriptors, packet, config.ratio)
    points = PointPairs.of(own, packet, mutual, config.floor_sigma_m)
    offset, S = points.own - points.peer, points.pair_covariances(np.eye(3))
    distance2 = mahalanobis2(offset, S)
    left = (
        one_way,
        mutual,
        mutual[distance2 <= chdtri(POINT_DOF, 1.0 - config.gate_probability)],
        find_common(own, packet, config=config),
    )
    return dict(zip(STAGES, left, strict=True))


def pairs_by_method(joint: JointInformation, packet: LandmarkPacket, config: FusionConfig) -> dict[str, Pairs]:
    """Return the pairs that each method finds; arguments as of `pairs_by_stage`."""
    own = OwnLandmarks.of(joint)
    configs = {name: dataclasses.replace(config, association=name) for name in FUSION_ASSOCIATIONS}
    return {name: associate(own, packet, config=one) for name, one in configs.items()}


def score(pairs: Pairs, joint: JointInformation, packet: LandmarkPacket, truth: Identities) -> Score:
    """Count (K, 2) pairs of rows of a belief and of a packet."""
    own = [truth.own[k] for k in joint.ids.tolist()]
    peer = [truth.peer[k] for k in packet.ids.tolist()]
    right = [own[a] for a, b in pairs.tolist() if own[a] == peer[b]]
    honest = {name for name, k in zip(peer, packet.ids.tolist(), strict=True) if k not in truth.mistaken}
    return Score(len(pairs), len(right), len(honest.intersection(right)), len(honest.intersection(own)))


def mistaken_condition(share: float) -> str:
    """Return the label of a share of mistaken landmarks."""
    return f"{share:.0%} mistaken"


def stage_rows(
    scores: Iterable[tuple[float, Mapping[str, Score]]], order: Sequence[str] = (*STAGES, UNKNOWN_FRAME)
) -> list[Row]:
    """Return a row for each share of mistaken landmarks and each stage or method, from scores by these, in order."""
    totals: dict[tuple[float, str], Score] = {}
    for share, by_stage in scores:
        for stage, found in by_stage.items():
            totals[share, stage] = totals.get((share, stage), Score()) + found
    ordered = sorted(totals.items(), key=lambda item: (item[0][0], order.index(item[0][1])))
    return [
        {"method": stage, "condition": mistaken_condition(share), "pairs": total.left, **total.row()}
        for (share, stage), total in ordered
    ]
