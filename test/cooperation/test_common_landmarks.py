# SPDX-License-Identifier: Apache-2.0
"""True matches are found, wrong ones are rejected, and too few are not accepted."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.common_landmarks import blocks, comparable, find_common
from uav_vslam.slam.packet import ANCHOR, DENSE, PacketPolicy, make_packet

CONFIG = FusionConfig()
SIGMA_M = 0.3
COUNT = 20
WHOLE = PacketPolicy(max_landmarks=COUNT)
COMPACT = PacketPolicy(form=ANCHOR, max_landmarks=COUNT, descriptor_basis=1)


def block_covariance(count: int, drift_m: float) -> np.ndarray:
    """Return (6+3N, 6+3N): a drift that all landmarks share, and 0.3 m of independent error."""
    shared = np.zeros((6 + 3 * count, 3))
    shared[:3] = np.eye(3)
    shared[6:] = np.tile(np.eye(3), (count, 1))
    return drift_m**2 * shared @ shared.T + np.diag([SIGMA_M**2] * 3 + [1e-4] * 3 + [SIGMA_M**2] * (3 * count))


@pytest.fixture
def scene(make_joint):
    """Return a matcher of two vehicles that share landmarks 0 to 11 of 20, the second one's map shifted as a whole."""
    rng = np.random.default_rng(6)
    truth = np.column_stack([rng.uniform(-30, 30, (COUNT, 2)), rng.normal(0, 1, COUNT)])

    def match(
        *,
        shift_m: float = 0.0,
        wrong: int = 0,
        shared: int = 12,
        drift_m: float = 1.0,
        config: FusionConfig = CONFIG,
        policy: PacketPolicy = WHOLE,
    ):
        P = block_covariance(COUNT, drift_m)
        own = make_joint(truth + rng.normal(0, 0.5 * SIGMA_M, truth.shape), P)
        identities = np.arange(COUNT)
        identities[shared:] += 1000  # the rest only the peer has
        appearance = identities.copy()
        appearance[:wrong] = np.roll(identities[:wrong], 1)  # the descriptors of other landmarks: certain wrong matches
        positions = truth + rng.normal(0, 0.5 * SIGMA_M, truth.shape) + shift_m * np.array([0.7, -0.7, 0.1])
        peer = make_joint(positions, P, vehicle="uav2", identities=appearance)
        packet = make_packet(peer, sequence=1, policy=policy)
        pairs = find_common(own.positions, P[6:, 6:], own.descriptors, packet, config=config)
        return [(int(a), int(packet.ids[b]) - 1) for a, b in pairs]

    return match


@pytest.mark.parametrize("shift_m", [0.0, 2.0])
def test_shared_landmarks_are_found_even_between_maps_that_drifted(scene, shift_m: float) -> None:
    found = scene(shift_m=shift_m)
    assert len(found) >= 11
    assert all(a == b < 12 for a, b in found)


@pytest.mark.parametrize("policy", [COMPACT, dataclasses.replace(COMPACT, form=DENSE)], ids=lambda p: p.form)
def test_compressed_descriptors_are_compared_with_own_ones_compressed_similar(scene, policy: PacketPolicy) -> None:
    assert scene(policy=policy) == scene()
    assert scene(policy=policy, wrong=5) == scene(wrong=5)


def test_descriptors_of_another_kind_match_nothing(make_joint) -> None:
    own, peer = (make_joint(np.zeros((5, 3)), np.eye(21), vehicle=v) for v in ("uav1", "uav2"))
    for policy in (WHOLE, COMPACT):
        packet = make_packet(peer, sequence=1, policy=policy)
        short = own.descriptors[:, :64]
        assert comparable(own.descriptors, packet)
        assert not comparable(short, packet)
        assert len(find_common(own.positions, np.eye(15), short, packet, config=CONFIG)) == 0


@pytest.mark.parametrize("wrong", [2, 5, 8])
def test_wrong_matches_are_rejected(scene, wrong: int) -> None:
    found = scene(wrong=wrong)
    assert all(a == b for a, b in found)
    assert len(found) >= 12 - wrong - 1


@pytest.mark.parametrize("wrong", [2, 4])
def test_wrong_matches_inside_a_wide_gate_are_inconsistent_with_the_others(scene, wrong: int) -> None:
    """After a drift of 30 m the gate accepts any pair; only relative offsets are known to half a metre."""
    found = scene(wrong=wrong, drift_m=30.0, shift_m=20.0)
    assert all(a == b for a, b in found)
    assert len(found) >= 12 - wrong - 1


def test_maps_farther_apart_than_their_uncertainty_have_no_matches(scene) -> None:
    assert scene(shift_m=15.0) == []


@pytest.mark.parametrize(("shared", "min_common", "count"), [(2, 3, 0), (3, 3, 3), (1, 1, 1), (0, 1, 0)])
def test_fewer_than_the_minimum_are_not_accepted(scene, shared: int, min_common: int, count: int) -> None:
    assert len(scene(shared=shared, config=FusionConfig(min_common=min_common))) == count


@pytest.mark.parametrize(("own_count", "peer_count"), [(0, 0), (0, 4), (4, 0)])
def test_an_empty_map_has_no_matches(make_joint, own_count: int, peer_count: int) -> None:
    rng = np.random.default_rng(0)
    own, peer = (
        make_joint(rng.normal(0, 9, (n, 3)), np.eye(6 + 3 * n), vehicle=v)
        for n, v in ((own_count, "uav1"), (peer_count, "uav2"))
    )
    packet = make_packet(peer, sequence=1, policy=PacketPolicy(max_landmarks=9))
    pairs = find_common(own.positions, np.eye(3 * own_count), own.descriptors, packet, config=CONFIG)
    assert pairs.shape == (0, 2)


def test_no_landmark_is_paired_twice(scene) -> None:
    found = scene(wrong=6)
    assert len({a for a, _ in found}) == len({b for _, b in found}) == len(found)


def test_blocks_are_a_view_by_landmark() -> None:
    P = np.arange(81.0).reshape(9, 9)
    np.testing.assert_array_equal(blocks(P)[1, 2], P[3:6, 6:9])
    assert blocks(np.zeros((0, 0))).shape == (0, 0, 3, 3)
