# SPDX-License-Identifier: Apache-2.0
"""The contract of every method of data association between vehicles, and what tells the methods apart."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from uav_vslam.config import FUSION_ASSOCIATIONS, FusionConfig
from uav_vslam.cooperation.common_landmarks import find_common
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.peer_associators import FINE_PAIRS, PEER_ASSOCIATORS, associate
from uav_vslam.cooperation.peer_frame import CommonFrame
from uav_vslam.errors import ConfigError
from uav_vslam.slam.packet import ANCHOR, PacketPolicy, make_packet
from uav_vslam.types import JointInformation, LandmarkPacket

SIGMA_M = 0.2
WHOLE = PacketPolicy(max_landmarks=64)
COMPACT = PacketPolicy(form=ANCHOR, max_landmarks=64, descriptor_basis=1)
UNGATED = ("nn", "cds", "coarse_fine")  # nothing but descriptors decides
Maps = Callable[..., tuple[JointInformation, LandmarkPacket]]


@pytest.fixture(params=sorted(PEER_ASSOCIATORS))
def name(request) -> str:
    return request.param


@pytest.fixture
def maps(make_joint) -> Maps:
    """Return a factory of a map and a packet of the same landmarks, those from `shared` on of others."""

    def make(
        count: int = 40,
        *,
        peer_count: int | None = None,
        shared: int | None = None,
        mistaken: int = 0,
        policy: PacketPolicy = WHOLE,
    ) -> tuple[JointInformation, LandmarkPacket]:
        rng = np.random.default_rng(3)
        size = max(count, peer_count or 0)
        points = np.column_stack([rng.uniform(-60, 60, (size, 2)), rng.normal(0, 1, size)])
        own, peer = (points + rng.normal(0, SIGMA_M, points.shape) for _ in range(2))
        looks = np.arange(size)
        looks[:mistaken] = np.roll(looks[:mistaken], 1)
        if shared is not None:
            looks[shared:] += 1000
        n = count if peer_count is None else peer_count
        packet = make_packet(
            make_joint(peer[:n], _covariance(n), vehicle="uav2", identities=looks[:n]), sequence=1, policy=policy
        )
        return make_joint(own[:count], _covariance(count)), packet

    return make


def _covariance(count: int) -> np.ndarray:
    """Return (6+3N, 6+3N): independent errors and a drift of a metre that all landmarks share."""
    shared = np.zeros((6 + 3 * count, 3))
    shared[:3], shared[6:] = np.eye(3), np.tile(np.eye(3), (count, 1))
    return shared @ shared.T + SIGMA_M**2 * np.eye(6 + 3 * count)


def found(joint: JointInformation, packet: LandmarkPacket, name: str, **config: float) -> list[tuple[int, int]]:
    """Return the pairs, each as the row of the own landmark and that of the peer's in its map."""
    settings = FusionConfig(association=name, **config)
    pairs = associate(OwnLandmarks.of(joint), packet, config=settings)
    assert pairs.shape[1] == 2
    assert np.issubdtype(pairs.dtype, np.integer)
    return [(int(a), int(packet.ids[b]) - 1) for a, b in pairs]


def test_the_configuration_has_all_names_and_the_default_is_the_first() -> None:
    assert set(FUSION_ASSOCIATIONS) == set(PEER_ASSOCIATORS)
    assert FusionConfig().association == FUSION_ASSOCIATIONS[0] == "consistent"
    assert PEER_ASSOCIATORS["consistent"] is find_common


@pytest.mark.parametrize("policy", [WHOLE, COMPACT], ids=["raw", "compressed"])
def test_common_landmarks_are_found(maps: Maps, name: str, policy: PacketPolicy) -> None:
    pairs = found(*maps(policy=policy), name)
    assert all(a == b for a, b in pairs)
    least = {"cds": 4, "coarse_fine": FINE_PAIRS, "gtm": 20, "gated_gtm": 20}.get(name, 38)
    assert len(pairs) >= least


@pytest.mark.parametrize(("own", "peer"), [(0, 0), (0, 9), (9, 0), (1, 1), (1, 9), (9, 1), (2, 2), (3, 3)])
def test_empty_and_small_maps_are_handled(maps: Maps, name: str, own: int, peer: int) -> None:
    pairs = found(*maps(own, peer_count=peer), name, min_common=1)
    assert len(pairs) <= min(own, peer)
    assert all(a == b for a, b in pairs)


def test_fewer_than_the_minimum_are_not_accepted(maps: Maps, name: str) -> None:
    joint, packet = maps(30)
    count = len(found(joint, packet, name))
    assert len(found(joint, packet, name, min_common=count)) == count
    assert found(joint, packet, name, min_common=count + 1) == []


def test_no_landmark_is_used_twice(maps: Maps, name: str) -> None:
    joint, packet = maps(60, shared=25, mistaken=10)
    pairs = found(joint, packet, name)
    assert len({a for a, _ in pairs}) == len({b for _, b in pairs}) == len(pairs)


def test_descriptors_of_another_kind_match_nothing(maps: Maps, name: str) -> None:
    joint, packet = maps(20)
    short = dataclasses.replace(OwnLandmarks.of(joint), descriptors=joint.descriptors[:, :64])
    pairs = associate(short, packet, config=FusionConfig(association=name))
    assert pairs.shape == (0, 2)


def test_association_is_deterministic_and_does_not_modify_its_input(maps: Maps, name: str) -> None:
    joint, packet = maps(50, mistaken=12)
    inputs = (joint.positions, joint.covariance, joint.descriptors, packet.positions, packet.covariance)
    copies = [array.copy() for array in inputs]
    assert found(joint, packet, name) == found(joint, packet, name)
    for array, copy in zip(inputs, copies, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_places_reject_mistaken_landmarks_and_descriptors_alone_do_not(maps: Maps, name: str) -> None:
    """Half of the landmarks look like others: most methods with geometry keep none, neighbourhoods a few."""
    pairs = found(*maps(40, mistaken=20), name)
    wrong = sum(a != b for a, b in pairs)
    if name in UNGATED:
        assert wrong >= 2
    elif name == "gtm":
        assert wrong < 0.2 * len(pairs)
    else:
        assert wrong == 0
        assert len(pairs) >= 8


def test_the_frame_of_a_peer_uses_the_configured_method(maps: Maps, name: str) -> None:
    joint, packet = maps(40, mistaken=20)
    frame = CommonFrame(FusionConfig(association=name))
    pairs = frame.find_common(OwnLandmarks.of(joint), packet)
    assert [(int(a), int(packet.ids[b]) - 1) for a, b in pairs] == found(joint, packet, name)


def test_without_a_common_origin_only_the_default_is_allowed() -> None:
    assert FusionConfig(common_origin=False).association == "consistent"
    with pytest.raises(ConfigError, match="association = 'hgtm' is not allowed; use consistent where common_origin"):
        FusionConfig(common_origin=False, association="hgtm")
