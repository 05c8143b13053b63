# SPDX-License-Identifier: Apache-2.0
"""True matches are found, wrong ones are rejected, and too few are not accepted."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.common_landmarks import (
    beyond_chance,
    blocks,
    comparable,
    consistent,
    gated,
    ground_covariance,
    jointly_consistent,
)
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.peer_associators import associate
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
        pairs = associate(OwnLandmarks(own.positions, P[6:, 6:], own.descriptors), packet, config=config)
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
        assert len(associate(OwnLandmarks(own.positions, np.eye(15), short), packet, config=CONFIG)) == 0


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


def test_a_wrong_match_that_each_right_one_allows_is_rejected_by_all_of_them(make_joint) -> None:
    """An offset to one other landmark is known to 0.7 m per axis, the place among twelve others to 0.5 m."""
    count = 13
    at = np.column_stack([np.random.default_rng(2).uniform(-30, 30, (count, 2)), np.zeros(count)])
    P = block_covariance(count, 30.0)
    peer = at + np.eye(count)[-1][:, None] * np.array([2.3, 0.0, 0.0])
    packet = make_packet(make_joint(peer, P, vehicle="uav2"), sequence=1, policy=WHOLE)
    pairs = np.column_stack([np.arange(count)] * 2)
    own = OwnLandmarks(at, P[6:, 6:], make_joint(at, P).descriptors)
    assert len(consistent(pairs, at, P[6:, 6:], packet.positions, packet.covariance, CONFIG)) == count
    assert associate(own, packet, config=CONFIG).tolist() == pairs[:-1].tolist()


def test_maps_farther_apart_than_their_uncertainty_have_no_matches(scene) -> None:
    assert scene(shift_m=15.0) == []


@pytest.mark.parametrize(("shared", "min_common", "count"), [(2, 3, 0), (3, 3, 3), (2, 2, 2), (0, 1, 0)])
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
    landmarks = OwnLandmarks(own.positions, np.eye(3 * own_count), own.descriptors)
    pairs = associate(landmarks, packet, config=CONFIG)
    assert pairs.shape == (0, 2)


def test_no_landmark_is_paired_twice(scene) -> None:
    found = scene(wrong=6)
    assert len({a for a, _ in found}) == len({b for _, b in found}) == len(found)


def test_blocks_are_a_view_by_landmark() -> None:
    P = np.arange(81.0).reshape(9, 9)
    np.testing.assert_array_equal(blocks(P)[1, 2], P[3:6, 6:9])
    assert blocks(np.zeros((0, 0))).shape == (0, 0, 3, 3)


# Gates against dense references, just inside and just outside: own and peer covariance and floor are of one size.

FLOOR_M = 0.8
WIDE_FLOOR = FusionConfig(floor_sigma_m=FLOOR_M)
PAIRS = np.array([[0, 0], [1, 1]])
BESIDE_THE_GATE = pytest.mark.parametrize(("share", "inside"), [(0.99, True), (1.01, False)])


def random_covariance(seed: int, count: int, drift_m: float) -> np.ndarray:
    """Return (6+3N, 6+3N), correlated at random, with a drift that all landmarks share."""
    A = np.random.default_rng(seed).normal(0, 0.3, (6 + 3 * count, 6 + 3 * count))
    return block_covariance(count, drift_m) + A @ A.T


def two_maps(make_joint, offsets_m: np.ndarray, *, drift_m: float) -> tuple[np.ndarray, ...]:
    """Return own positions and covariance of N landmarks, and those of a peer that has them `offsets_m` off."""
    count = len(offsets_m)
    at = 40.0 * np.arange(count)[:, None] * np.array([1.0, 0.5, 0.0])
    P, R = (random_covariance(seed, count, drift_m) for seed in (1, 2))
    packet = make_packet(make_joint(at + offsets_m, R, vehicle="uav2"), sequence=1, policy=WHOLE)
    return at, P[6:, 6:], packet.positions, packet.covariance


def on_the_gate(direction: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Return the vector along a direction whose squared Mahalanobis distance is the gate's."""
    distance2 = direction @ np.linalg.solve(S, direction)
    return direction * np.sqrt(chi2.ppf(CONFIG.gate_probability, 3) / distance2)


@BESIDE_THE_GATE
@pytest.mark.parametrize("direction", np.eye(3))
def test_a_pair_is_gated_by_both_covariances_and_the_floor(make_joint, direction, share: float, inside: bool) -> None:
    _, P, _, R = two_maps(make_joint, np.zeros((1, 3)), drift_m=0.3)
    offset = on_the_gate(direction, P + R + FLOOR_M**2 * np.eye(3))
    maps = two_maps(make_joint, share * offset[None], drift_m=0.3)
    assert len(gated(PAIRS[:1], *maps, WIDE_FLOOR)) == inside


@BESIDE_THE_GATE
@pytest.mark.parametrize("direction", np.eye(3))
def test_two_pairs_agree_by_the_covariance_of_their_offset(make_joint, direction, share: float, inside: bool) -> None:
    """What both landmarks share, as a large drift, is no part of the offset's error; the floor counts twice."""
    _, P, _, R = two_maps(make_joint, np.zeros((2, 3)), drift_m=30.0)
    D = np.hstack([-np.eye(3), np.eye(3)])
    offset = on_the_gate(direction, D @ (P + R) @ D.T + 2 * FLOOR_M**2 * np.eye(3))
    maps = two_maps(make_joint, share * np.outer([-0.5, 0.5], offset), drift_m=30.0)
    assert len(consistent(PAIRS, *maps, WIDE_FLOOR)) == 1 + inside


@BESIDE_THE_GATE
@pytest.mark.parametrize("direction", np.eye(3))
def test_a_pair_is_judged_by_what_the_others_predict(make_joint, direction, share: float, inside: bool) -> None:
    """The others know the maps' drift as well as all of them together, not as well as one."""
    count = 6
    pairs, others = np.column_stack([np.arange(count)] * 2), slice(3, None)
    _, P, _, R = two_maps(make_joint, np.zeros((count, 3)), drift_m=30.0)
    S = P + R + FLOOR_M**2 * np.eye(3 * count)
    given_others = S[:3, :3] - S[:3, others] @ np.linalg.solve(S[others, others], S[others, :3])
    offsets = np.zeros((count, 3))
    offsets[0] = share * on_the_gate(direction, given_others)
    maps = two_maps(make_joint, offsets, drift_m=30.0)
    kept = np.arange(count) if inside else np.arange(1, count)
    assert jointly_consistent(pairs, *maps, WIDE_FLOOR).tolist() == kept.tolist()


AREA_M2 = 100.0 * 100.0


def horizontal(sigmas_m: list[float], drift_m: float = 0.0) -> np.ndarray:
    """Return (2K, 2K): errors independent for each pair, and one that all share."""
    shared = np.tile(np.eye(2), (len(sigmas_m), 1))
    return np.diag(np.repeat(np.square(sigmas_m), 2)) + drift_m**2 * shared @ shared.T


@pytest.mark.parametrize(
    ("S", "kept"),
    [
        (horizontal([0.5] * 2, 1.0), [0, 1]),
        (horizontal([0.5] * 2, 30.0), []),
        (horizontal([0.5] * 6, 30.0), [0, 1, 2, 3, 4, 5]),
        (horizontal([30.0] * 9), []),
        (horizontal([0.5, 30.0, 0.5], 1.0), [0, 2]),
        (np.zeros((0, 0)), []),
    ],
    ids=["two", "two in wide gates", "six in gates with a common error", "wide gates", "one wide gate", "none"],
)
def test_matches_count_if_wrong_ones_would_not_agree_as_well(S: np.ndarray, kept: list[int]) -> None:
    assert beyond_chance(S, 10, AREA_M2, CONFIG).tolist() == kept


def test_a_map_without_extent_proves_nothing() -> None:
    assert len(beyond_chance(horizontal([0.1] * 5), 5, 0.0, CONFIG)) == 0


def test_wrong_matches_that_agree_by_chance_are_not_taken() -> None:
    """A hundred pairs of maps whose descriptors are all wrong, in gates as wide as the maps: some agree."""
    pairs, P = np.column_stack([np.arange(COUNT)] * 2), block_covariance(COUNT, 40.0)[6:, 6:] + np.eye(3 * COUNT)
    rng, agreeing, taken = np.random.default_rng(8), 0, 0
    for _ in range(100):
        own, peer = np.zeros((2, COUNT, 3))
        own[:, :2], peer[:, :2] = rng.uniform(-50, 50, (2, COUNT, 2))
        found = pairs[consistent(pairs, own, P, peer, P, CONFIG)]
        S = ground_covariance(found, P, P, CONFIG)
        agreeing += len(found) > 1
        taken += len(beyond_chance(S, COUNT, AREA_M2, CONFIG)) > 0
    assert agreeing > 50
    assert taken == 0
