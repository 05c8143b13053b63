# SPDX-License-Identifier: Apache-2.0
"""Fusion adds what is independent, intersects what is not, counts nothing twice, and writes nothing back."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.fused_pose import FusedEpoch, move, propagated
from uav_vslam.cooperation.fusion import MIN_DELAY_S, Fusion
from uav_vslam.cooperation.peer_faults import contradictions
from uav_vslam.geometry.coded_points import DensePoints, pack_lower
from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.numerics import symmetrise
from uav_vslam.slam.packet import PacketPolicy, checksum, make_packet
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket, PoseEstimate

Array = NDArray[np.float64]

COUNT = 6
NOW_NS = 10_000_000_000
EXACT = FusionConfig(floor_sigma_m=0.0)
STEP = 1e-5  # of a correction, for central differences [m], [rad]
DIFFERENCE = 1e-7  # relative, of what follows from such differences
RELATIVE = 1e-5  # packets carry float32 covariances and offsets
TRUTH = np.column_stack([np.random.default_rng(1).uniform(-30, 30, (COUNT, 2)), np.zeros(COUNT)])


def belief_covariance(drift_m: float, *, yaw_rad: float = 0.01, own_m: float = 0.1) -> Array:
    """Return (6+3N, 6+3N): position drift and yaw that pose and landmarks share, and each one's own error."""
    shared = np.zeros((POSE_DIM + 3 * COUNT, 4))
    shared[:3, :3] = np.eye(3)
    shared[6:, :3] = np.tile(np.eye(3), (COUNT, 1))
    shared[5, 3] = 1.0
    shared[6:, 3] = np.cross([0.0, 0.0, 1.0], TRUTH).ravel()
    scale = np.array([drift_m, drift_m, drift_m, yaw_rad])
    return (shared * scale) @ (shared * scale).T + np.diag([1e-3] * 6 + [own_m**2] * (3 * COUNT))


@pytest.fixture
def own(make_joint) -> JointInformation:
    return make_joint(TRUTH + np.array([0.6, -0.4, 0.3]), belief_covariance(1.0), stamp_ns=NOW_NS)


@pytest.fixture
def peer_packet(make_joint):
    """Return a maker of packets over the same landmarks, a second old by default."""

    def make(
        vehicle: str = "uav2", *, shift=(-0.5, 0.2, 0.1), drift_m: float = 0.8, age_ns: int = NS_PER_S, **options
    ) -> LandmarkPacket:
        joint = make_joint(
            TRUTH + np.asarray(shift), belief_covariance(drift_m), vehicle=vehicle, stamp_ns=NOW_NS - age_ns
        )
        return make_packet(
            joint, sequence=options.pop("sequence", 1), policy=PacketPolicy(max_landmarks=COUNT), **options
        )

    return make


def from_sources(packet: LandmarkPacket, *sources: str) -> LandmarkPacket:
    changed = dataclasses.replace(packet, sources=sources)
    return dataclasses.replace(changed, checksum=checksum(changed))


def fuse(
    own: JointInformation, *packets: LandmarkPacket, config: FusionConfig = EXACT, prior_id: str = ""
) -> FusedEpoch:
    fusion = Fusion("uav1", dataclasses.replace(config, prior_id=prior_id))
    for packet in packets:
        fusion.inbox.add(packet)
    return fusion.fuse(own)


def assert_belief(epoch: FusedEpoch, own: JointInformation, Y: Array, gradient: Array) -> None:
    """Check a result against information Y (over pose and landmarks) and delta = Y^-1 gradient."""
    pose, positions = move(own.T_map_body, own.positions, np.linalg.solve(Y, gradient))
    np.testing.assert_allclose(epoch.pose.T_map_body.matrix, pose.matrix, rtol=0, atol=1e-4)
    np.testing.assert_allclose(epoch.positions, positions, rtol=0, atol=1e-4)
    expected = np.linalg.inv(Y)[:POSE_DIM, :POSE_DIM]
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        epoch.pose.covariance / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), rtol=0, atol=1e-3
    )


def landmark_information(packet: LandmarkPacket) -> Array:
    """Return the packet's information at the place of its landmarks in the joint state."""
    Y = np.zeros((POSE_DIM + 3 * COUNT,) * 2)
    Y[POSE_DIM:, POSE_DIM:] = np.linalg.inv(packet.covariance)
    return Y


def gradient_of(own: JointInformation, packet: LandmarkPacket) -> Array:
    innovation = np.concatenate([np.zeros(POSE_DIM), (packet.positions - own.positions).ravel()])
    return landmark_information(packet) @ innovation


def test_two_independent_vehicles_give_the_centralised_estimate(own, peer_packet) -> None:
    """One filter over both vehicles' poses and the landmarks they share, the peer's pose marginalised out."""
    packet = peer_packet()
    epoch = fuse(own, packet)
    assert epoch.common == {"uav2": COUNT}
    assert epoch.weight == 1.0
    n = 3 * COUNT
    central = np.zeros((2 * POSE_DIM + n,) * 2)  # own pose, landmarks, peer's pose
    central[: POSE_DIM + n, : POSE_DIM + n] += own.information
    peer_rows = np.r_[POSE_DIM + n : 2 * POSE_DIM + n, POSE_DIM : POSE_DIM + n]
    central[np.ix_(peer_rows, peer_rows)] += np.linalg.inv(belief_covariance(0.8))
    P = np.linalg.inv(central)[: POSE_DIM + n, : POSE_DIM + n]
    assert_belief(epoch, own, np.linalg.inv(P), gradient_of(own, packet))


def test_three_independent_vehicles_add(own, peer_packet) -> None:
    """The second addition is linearised where the first one led, so the agreement is to a turn of 1e-4 rad."""
    packets = peer_packet("uav2"), peer_packet("uav3", shift=(0.1, 0.3, -0.2), drift_m=1.2)
    epoch = fuse(own, *packets)
    Y = own.information + sum(landmark_information(p) for p in packets)
    gradient = sum(gradient_of(own, p) for p in packets)
    pose, _ = move(own.T_map_body, own.positions, np.linalg.solve(Y, gradient))
    np.testing.assert_allclose(epoch.pose.T_map_body.t, pose.t, rtol=0, atol=5e-3)
    np.testing.assert_allclose(epoch.pose.covariance, np.linalg.inv(Y)[:6, :6], rtol=0, atol=2e-3)
    assert epoch.weight == 1.0


def test_the_floor_is_added_to_each_landmark(own, peer_packet) -> None:
    packet = peer_packet()
    epoch = fuse(own, packet, config=FusionConfig(floor_sigma_m=0.3))
    widened = np.zeros_like(own.information)
    widened[POSE_DIM:, POSE_DIM:] = np.linalg.inv(packet.covariance + 0.09 * np.eye(3 * COUNT))
    innovation = np.concatenate([np.zeros(POSE_DIM), (packet.positions - own.positions).ravel()])
    assert_belief(epoch, own, own.information + widened, widened @ innovation)


def test_a_peers_packet_reduces_the_uncertainty_of_the_pose(own, peer_packet) -> None:
    epoch = fuse(own, peer_packet())
    assert np.trace(epoch.pose.covariance[:3, :3]) < 0.7 * np.trace(epoch.own.covariance[:3, :3])
    assert np.linalg.norm(epoch.pose.T_map_body.t - own.T_map_body.t) > 0.1
    assert epoch.common == {"uav2": COUNT}


@pytest.mark.parametrize(("association", "contradicting"), [("consistent", []), ("nn", ["uav2"])])
def test_wrong_pairs_that_a_method_leaves_contradict_the_own_estimate(
    own, peer_packet, association: str, contradicting: list[str]
) -> None:
    """Two of the peer's landmarks, metres apart, look like each other: nearest neighbours pair them wrongly."""
    right, descriptors = peer_packet("uav3"), peer_packet().descriptors
    confused = dataclasses.replace(peer_packet(), descriptors=descriptors[[1, 0, *range(2, COUNT)]])
    confused = dataclasses.replace(confused, checksum=checksum(confused))
    epoch = fuse(own, confused, right, config=dataclasses.replace(EXACT, association=association))
    assert "uav2" in epoch.common
    assert [*contradictions(epoch)] == [f"landmarks/{peer}" for peer in contradicting]
    assert all("uav2" in text for text in contradictions(epoch).values())


def test_the_same_source_in_two_packets_is_not_counted_twice(own, peer_packet) -> None:
    """What uav3 sends on holds nothing but uav2's measurements: fusing both must not beat uav2 alone."""
    direct = peer_packet("uav2")
    echo = from_sources(peer_packet("uav3"), "uav3/1", "uav2/1")
    once, both = fuse(own, direct), fuse(own, direct, echo)
    assert np.trace(both.pose.covariance[:3, :3]) >= np.trace(once.pose.covariance[:3, :3]) * (1 - RELATIVE)
    unmarked = fuse(own, direct, peer_packet("uav3"))
    assert np.trace(unmarked.pose.covariance[:3, :3]) < 0.9 * np.trace(once.pose.covariance[:3, :3])


def test_own_measurements_that_come_back_do_not_shrink_the_own_covariance(own) -> None:
    joint = dataclasses.replace(own, vehicle="uav2", stamp_ns=NOW_NS - 1_000_000_000)
    echo = from_sources(make_packet(joint, sequence=1, policy=PacketPolicy(max_landmarks=COUNT)), "uav2/1", "uav1/1")
    epoch = fuse(own, echo)
    assert np.trace(epoch.pose.covariance[:3, :3]) >= np.trace(epoch.own.covariance[:3, :3]) * (1 - RELATIVE)


@pytest.mark.parametrize(
    ("own_prior", "peer_prior", "dependent"),
    [("", "", False), ("map", "", False), ("", "map", False), ("map", "survey", False), ("map", "map", True)],
)
def test_only_a_common_prior_makes_a_packet_dependent(own, peer_packet, own_prior, peer_prior, dependent) -> None:
    packet = peer_packet(prior_id=peer_prior, drift_m=0.5)
    epoch = fuse(own, packet, prior_id=own_prior)
    assert (epoch.weight < 1.0) is dependent
    if dependent:  # all of it: covariance intersection, Eq. (7.1) of [thesis]
        w = epoch.weight
        Y = w * own.information + (1 - w) * landmark_information(packet)
        assert_belief(epoch, own, Y, (1 - w) * gradient_of(own, packet))


def test_two_peers_with_one_prior_depend_on_each_other(own, peer_packet) -> None:
    packets = [peer_packet(v, prior_id="map", drift_m=0.5) for v in ("uav2", "uav3")]
    once, both = fuse(own, packets[0]), fuse(own, *packets)
    summed = own.information + sum(landmark_information(p) for p in packets)
    assert np.trace(both.pose.covariance[:3, :3]) > np.trace(np.linalg.inv(summed)[:3, :3]) * 1.05
    assert np.trace(both.pose.covariance[:3, :3]) <= np.trace(once.pose.covariance[:3, :3]) * (1 + RELATIVE)


def test_ten_packets_of_one_vehicle_count_as_its_newest_alone(own, peer_packet) -> None:
    packets = [peer_packet(sequence=k) for k in range(1, 11)]
    repeated, single = fuse(own, *packets), fuse(own, packets[-1])
    np.testing.assert_array_equal(repeated.pose.covariance, single.pose.covariance)
    np.testing.assert_array_equal(repeated.pose.T_map_body.matrix, single.pose.T_map_body.matrix)
    # The naive sum of the ten claims this much; as the ten share one error, the truth is that much.
    Y_peer = landmark_information(packets[-1])
    claimed = np.linalg.inv(own.information + 10 * Y_peer)
    true = claimed @ (own.information + 100 * Y_peer) @ claimed
    assert true[0, 0] > 3 * claimed[0, 0]
    ours_claimed = np.linalg.inv(own.information + Y_peer)
    assert repeated.pose.covariance[0, 0] == pytest.approx(ours_claimed[0, 0], rel=1e-3)


def test_a_landmark_whose_distance_is_hardly_known_is_neither_fused_nor_sent(make_joint, peer_packet) -> None:
    P = belief_covariance(1.0)
    P[-1, -1] += 20.0**2  # the last one's height, seen from 70 m
    joint = make_joint(TRUTH, P, stamp_ns=NOW_NS)
    fusion = Fusion("uav1", EXACT)
    fusion.inbox.add(peer_packet())
    epoch = fusion.fuse(joint)
    assert epoch.common == {"uav2": COUNT - 1}
    assert fusion.packet().ids.tolist() == joint.ids[:-1].tolist()
    assert fusion.loose == 1


def test_without_cooperation_the_fused_track_is_the_own_one(own, peer_packet) -> None:
    epoch = fuse(own, peer_packet(), config=FusionConfig(mode="none"))
    np.testing.assert_array_equal(epoch.pose.T_map_body.matrix, own.T_map_body.matrix)
    np.testing.assert_array_equal(epoch.pose.covariance, epoch.own.covariance)
    np.testing.assert_array_equal(epoch.positions, own.positions)
    assert epoch.common == {}


def test_a_packet_too_young_for_the_epoch_waits(own, peer_packet) -> None:
    age_ns = round(MIN_DELAY_S * NS_PER_S)
    assert fuse(own, peer_packet(age_ns=age_ns - 1)).common == {}
    assert fuse(own, peer_packet(age_ns=age_ns)).common == {"uav2": COUNT}


def test_fusion_writes_nothing_back(own, peer_packet) -> None:
    fusion = Fusion("uav1", EXACT)
    fusion.inbox.add(peer_packet())
    before = own.information.copy(), own.positions.copy()
    first = fusion.fuse(own)
    np.testing.assert_array_equal(own.information, before[0])
    np.testing.assert_array_equal(own.positions, before[1])
    second = fusion.fuse(own)  # the same packet again, on the same own belief: the epoch is fused afresh
    np.testing.assert_array_equal(first.pose.covariance, second.pose.covariance)
    np.testing.assert_array_equal(first.positions, second.positions)


def test_what_is_sent_is_own_only_and_offers_shared_landmarks_first(own, peer_packet) -> None:
    config = dataclasses.replace(EXACT, max_packet_landmarks=3, min_common=1)
    fusion, alone = Fusion("uav1", config), Fusion("uav1", config)
    lonely = peer_packet()
    keep = make_packet_of_rows(lonely, [4])
    fusion.inbox.add(keep)
    fusion.fuse(own)
    packet = fusion.packet()
    assert packet.sources == ("uav1/1",)
    assert 5 in packet.ids
    row = packet.ids.tolist().index(5)
    np.testing.assert_allclose(packet.positions[row], own.positions[4], rtol=0, atol=1e-5)
    assert (packet.sequence, fusion.packet().sequence) == (1, 2)
    alone.fuse(own)
    assert alone.packet().sequence == 1


def make_packet_of_rows(packet: LandmarkPacket, rows: list[int]) -> LandmarkPacket:
    """Return a packet over some of another's landmarks."""
    columns = (3 * np.array(rows)[:, None] + np.arange(3)).ravel()
    L = np.linalg.cholesky(packet.covariance[np.ix_(columns, columns)])
    changed = dataclasses.replace(
        packet,
        ids=packet.ids[rows],
        points=DensePoints(packet.points.offsets[rows], pack_lower(L).astype(np.float32)),
        covariance_scale=1.0,
        descriptors=packet.descriptors[rows],
    )
    return dataclasses.replace(changed, checksum=checksum(changed))


def test_descriptors_of_another_size_are_counted_and_change_nothing(own, peer_packet) -> None:
    fusion = Fusion("uav1", EXACT)
    packet = peer_packet()
    short = dataclasses.replace(packet, descriptors=packet.descriptors[:, :32])
    fusion.inbox.add(dataclasses.replace(short, checksum=checksum(short)))
    epoch = fusion.fuse(own)
    np.testing.assert_array_equal(epoch.pose.covariance, epoch.own.covariance)
    assert list(fusion.inbox.peers["uav2"].unused.values()) == ["descriptor_size"]


@pytest.mark.parametrize("sigma_m", [1e-20, 1e5])
def test_a_valid_packet_of_extreme_certainty_breaks_nothing(own, peer_packet, sigma_m: float) -> None:
    packet = peer_packet()
    L = np.full((3 * COUNT, 3 * COUNT), sigma_m) if sigma_m > 1 else sigma_m * np.eye(3 * COUNT)
    points = DensePoints(packet.points.offsets, pack_lower(L).astype(np.float32))
    extreme = dataclasses.replace(packet, points=points)
    epoch = fuse(own, dataclasses.replace(extreme, checksum=checksum(extreme)), config=FusionConfig())
    assert np.isfinite(epoch.pose.T_map_body.matrix).all()
    assert np.linalg.eigvalsh(epoch.pose.covariance)[0] > 0


def test_a_peer_that_sees_other_landmarks_changes_nothing(make_joint, own) -> None:
    other = make_joint(TRUTH, belief_covariance(1.0), vehicle="uav2", stamp_ns=0, identities=np.arange(COUNT) + 500)
    epoch = fuse(own, make_packet(other, sequence=1, policy=PacketPolicy(max_landmarks=COUNT)))
    assert epoch.common == {"uav2": 0}
    np.testing.assert_array_equal(epoch.pose.covariance, epoch.own.covariance)


def test_a_belief_without_landmarks_stays_its_own(make_joint, peer_packet) -> None:
    blind = make_joint(np.zeros((0, 3)), 0.1 * np.eye(6), stamp_ns=NOW_NS)
    epoch = fuse(blind, peer_packet())
    np.testing.assert_allclose(epoch.pose.covariance, 0.1 * np.eye(6))
    assert epoch.positions.shape == (0, 3)


# Between epochs the fused pose is propagated by the own-only motion.


def pose_estimate(xi, t, covariance: Array, stamp_ns: int = NOW_NS) -> PoseEstimate:
    return PoseEstimate(stamp_ns, Pose(so3_exp(xi), np.asarray(t, float)), covariance)


def spd_covariance(seed: int) -> Array:
    A = np.random.default_rng(seed).normal(size=(6, 6))
    return A @ A.T + 1e-3 * np.eye(6)


COVARIANCES = st.builds(lambda seed, log: 10.0**log * spd_covariance(seed), st.integers(0, 2**32 - 1), st.floats(-4, 1))


@given(COVARIANCES, COVARIANCES)
def test_propagation_without_motion_changes_nothing(own_P: Array, fused_P: Array) -> None:
    own = pose_estimate([0.1, 0.2, 0.3], [1, 2, 70], own_P)
    fused = pose_estimate([0.1, 0.2, 0.35], [1.5, 2, 70], fused_P)
    there = propagated(own, fused, own)
    np.testing.assert_allclose(there.T_map_body.matrix, fused.T_map_body.matrix, rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        there.covariance, fused_P, rtol=0, atol=1e-12 * np.abs(own_P).max() + 1e-12 * np.abs(fused_P).max()
    )


@settings(max_examples=50)
@given(COVARIANCES, COVARIANCES, COVARIANCES, st.lists(st.floats(-50, 50), min_size=3, max_size=3))
def test_a_propagated_covariance_stays_positive(own_P, fused_P, later_P, moved) -> None:
    own = pose_estimate([0.1, 0.2, 0.3], [1, 2, 70], own_P)
    fused = pose_estimate([0.1, 0.2, 0.35], [1.5, 2, 70], fused_P)
    later = pose_estimate([0.15, 0.2, 0.5], np.array([1, 2, 70]) + moved, later_P, NOW_NS + 1)
    there = propagated(own, fused, later)
    assert there.stamp_ns == NOW_NS + 1
    np.testing.assert_array_equal(there.covariance, there.covariance.T)
    assert np.linalg.eigvalsh(there.covariance)[0] > -1e-12 * np.abs(there.covariance).max()


@settings(max_examples=30)
@given(COVARIANCES, st.integers(0, 2**32 - 1), st.lists(st.booleans(), min_size=1, max_size=5))
def test_own_corrections_keep_the_fused_pose_consistent(own_P: Array, seed: int, corrected: list[bool]) -> None:
    """A linear filter of known errors: x = own error, fused error, in steps of process noise or of a measurement.

    The claim equals the variance that the published mean really has, for any correlation of both errors.
    """
    rng = np.random.default_rng(seed)
    joint = spd_covariance_of(rng, 12)
    scale = np.linalg.cholesky(own_P) @ np.linalg.inv(np.linalg.cholesky(joint[:6, :6]))
    joint = np.kron(np.eye(2), scale) @ joint @ np.kron(np.eye(2), scale).T  # of the errors of both poses
    offset = 1e-4 * rng.normal(size=6)
    own = pose_estimate(np.zeros(3), np.zeros(3), joint[:6, :6])
    fused = PoseEstimate(NOW_NS, move(own.T_map_body, np.zeros((0, 3)), offset)[0], joint[6:, 6:])
    for correct in corrected:
        P = own.covariance
        if correct:
            R = spd_covariance_of(rng, 6) * np.trace(P)
            A = np.eye(6) - P @ np.linalg.inv(P + R)
            noise = (np.eye(6) - A) @ R @ (np.eye(6) - A).T
        else:
            A, noise = np.eye(6), spd_covariance_of(rng, 6) * np.trace(P)
        later = pose_estimate(np.zeros(3), np.zeros(3), symmetrise(A @ P @ A.T + noise))
        there = propagated(own, fused, later)
        offset = A @ offset  # of the fused from the own pose
        joint = np.kron(np.eye(2), A) @ joint @ np.kron(np.eye(2), A).T + np.kron(np.ones((2, 2)), noise)
        found = np.concatenate([there.T_map_body.t, so3_log(there.T_map_body.R)])
        np.testing.assert_allclose(found, offset, rtol=0, atol=1e-7)
        np.testing.assert_allclose(there.covariance, joint[6:, 6:], rtol=0, atol=1e-6 * np.abs(joint).max())
        own, fused = later, there


def spd_covariance_of(rng: np.random.Generator, size: int) -> Array:
    A = rng.normal(size=(size, size))
    return np.asarray(A @ A.T / size + 1e-2 * np.eye(size))


def test_a_start_known_without_error_is_propagated() -> None:
    own = pose_estimate([0, 0, 0.3], [1, 2, 70], np.zeros((6, 6)))
    later = pose_estimate([0, 0, 0.3], [2, 2, 70], np.diag([0.1, 0.1, 0, 0, 0, 1e-4]), NOW_NS + 1)
    np.testing.assert_allclose(propagated(own, own, later).covariance, later.covariance, rtol=0, atol=1e-12)


def test_a_propagated_pose_keeps_the_own_motion_between_stamps() -> None:
    own = pose_estimate([0, 0, 0.3], [1, 2, 70], 0.1 * np.eye(6))
    fused = pose_estimate([0, 0, 0.4], [4, 2, 69], 0.05 * np.eye(6))
    later = pose_estimate([0.05, 0.1, 0.8], [11, 5, 71], 100 * np.eye(6), NOW_NS + 1)  # without a correction
    there = propagated(own, fused, later)
    seen = fused.T_map_body.inverse() @ there.T_map_body
    expected = own.T_map_body.inverse() @ later.T_map_body
    np.testing.assert_allclose(seen.matrix, expected.matrix, rtol=0, atol=1e-12)


def test_a_propagated_covariance_follows_the_numerical_derivative_of_the_motion() -> None:
    """The correction's error moves with the rigid motion; further growth of the own covariance is added."""
    own = pose_estimate([0.3, -0.2, 0.9], [1, 2, 70], spd_covariance(1))
    fused = pose_estimate([0.25, -0.1, 1.4], [4, 2, 69], 0.3 * spd_covariance(2))
    there = pose_estimate([0.5, 0.1, 2.0], [31, -15, 82], np.zeros((6, 6)), NOW_NS + 1)
    motion = own.T_map_body.inverse() @ there.T_map_body
    growth = np.diag([0.3, 0.2, 0.1, 1e-3, 2e-3, 3e-3])
    J_own, J_fused = (derivative_of_motion(pose.T_map_body, motion) for pose in (own, fused))
    later = dataclasses.replace(there, covariance=J_own @ own.covariance @ J_own.T + growth)
    expected = J_fused @ fused.covariance @ J_fused.T + growth
    found = propagated(own, fused, later).covariance
    np.testing.assert_allclose(found, expected, rtol=0, atol=DIFFERENCE * np.abs(expected).max())


def derivative_of_motion(T_map_body: Pose, motion: Pose) -> Array:
    """Return the (6, 6) central difference of T_map_body @ motion by a correction of T_map_body."""
    before = T_map_body @ motion

    def moved_by(delta: Array) -> Array:
        after = move(T_map_body, np.zeros((0, 3)), delta)[0] @ motion
        return np.concatenate([after.t - before.t, so3_log(after.R @ before.R.T)])

    return np.column_stack([(moved_by(step) - moved_by(-step)) / (2 * STEP) for step in STEP * np.eye(6)])


def test_a_vehicle_that_never_fused_keeps_its_own_pose() -> None:
    own = pose_estimate([0, 0, 0.3], [1, 2, 70], 0.1 * np.eye(6))
    assert Fusion("uav1", EXACT).propagate(own) is own


def test_moving_is_the_exponential_without_velocity() -> None:
    """A turn about the map's origin moves pose and landmarks alike, as one rigid body."""
    pose, landmarks = Pose(so3_exp([0.1, 0.0, 0.2]), np.array([5.0, -3.0, 70.0])), TRUTH
    xi = np.array([0.02, -0.01, 0.3])
    delta = np.concatenate([np.cross(xi, pose.t), xi, np.cross(xi, landmarks).ravel()])
    moved_pose, moved_landmarks = move(pose, landmarks, delta)
    np.testing.assert_allclose(moved_landmarks, landmarks @ so3_exp(xi).T, rtol=0, atol=1e-12)
    np.testing.assert_allclose(moved_pose.t, so3_exp(xi) @ pose.t, rtol=0, atol=1e-12)
    np.testing.assert_allclose(so3_log(moved_pose.R @ pose.R.T), xi, rtol=0, atol=1e-12)


def test_feedback_has_the_peers_identifiers_and_lists_all_sources(own, peer_packet) -> None:
    fusion = Fusion("uav1", EXACT)
    assert fusion.feedback("uav2") is None
    fusion.inbox.add(packet := peer_packet())
    epoch = fusion.fuse(own)
    feedback = fusion.feedback("uav2")
    assert feedback is not None
    assert feedback.vehicle == "uav1"
    assert feedback.sources == ("uav1/1", "uav2/1")
    assert feedback.ids.tolist() == packet.ids.tolist()
    np.testing.assert_allclose(feedback.positions, epoch.positions, rtol=0, atol=0.02)
    bound = feedback.covariance - epoch.covariance[POSE_DIM:, POSE_DIM:]
    assert np.linalg.eigvalsh(bound)[0] > -1e-9
    assert fusion.feedback("uav3") is None


def test_feedback_is_intersected_with_and_never_counts_the_own_measurements_twice(own, peer_packet, make_joint) -> None:
    """Feedback depends on the own packet: at best it has the information of the peer's packet."""
    there = Fusion("uav2", EXACT)
    peer = make_joint(TRUTH + 0.1, belief_covariance(0.8), vehicle="uav2", stamp_ns=NOW_NS - 10**9)
    there.inbox.add(make_packet_for(own, stamp_ns=NOW_NS - 2 * 10**9))
    there.fuse(peer)
    here = Fusion("uav1", EXACT)
    here.returned.add(there.feedback("uav1"))
    helped, direct = here.fuse(own), fuse(own, make_packet_for(peer))
    alone, returned, sent = (
        np.trace(P[:3, :3]) for P in (helped.own.covariance, helped.pose.covariance, direct.pose.covariance)
    )
    assert sent < returned < alone
    assert helped.weight < 1.0


def test_feedback_does_not_average_away_that_two_vehicles_see_different_points(own, make_joint) -> None:
    """From a peer that knows its points exactly, packet and feedback differ from the own points by the same floor."""
    config = FusionConfig(floor_sigma_m=1.0)
    exact = belief_covariance(0.01, yaw_rad=1e-4, own_m=0.01)
    peer = make_joint(TRUTH, exact, vehicle="uav2", stamp_ns=NOW_NS - 10**9)
    there, here = Fusion("uav2", config), Fusion("uav1", config)
    there.inbox.add(make_packet_for(own, stamp_ns=NOW_NS - 2 * 10**9))
    there.fuse(peer)
    here.inbox.add(make_packet_for(peer))
    direct = np.trace(here.fuse(own).pose.covariance[:3, :3])
    here.returned.add(there.feedback("uav1"))
    returned = here.fuse(own)
    assert returned.weight == 1.0
    assert np.trace(returned.pose.covariance[:3, :3]) == pytest.approx(direct, rel=1e-6)


def make_packet_for(joint: JointInformation, stamp_ns: int | None = None) -> LandmarkPacket:
    joint = dataclasses.replace(joint, stamp_ns=joint.stamp_ns if stamp_ns is None else stamp_ns)
    return make_packet(joint, sequence=1, policy=PacketPolicy())


def test_feedback_to_an_earlier_session_is_not_used(own, peer_packet) -> None:
    fusion = Fusion("uav2", EXACT)
    fusion.inbox.add(peer_packet("uav1"))
    fusion.fuse(dataclasses.replace(own, vehicle="uav2"))
    feedback = fusion.feedback("uav1")
    restarted = Fusion("uav1", EXACT)
    restarted.returned.add(feedback)
    epoch = restarted.fuse(dataclasses.replace(own, session=2, stamp_ns=NOW_NS + 10**9))
    np.testing.assert_array_equal(epoch.pose.covariance, epoch.own.covariance)


@pytest.mark.parametrize("wrong", ["displaced", "for another", "of an ended session"])
def test_invalid_feedback_changes_nothing(own, peer_packet, wrong: str) -> None:
    there, here = Fusion("uav2", EXACT), Fusion("uav1", EXACT)
    there.inbox.add(make_packet_for(own, stamp_ns=NOW_NS - 2 * 10**9))
    there.fuse(dataclasses.replace(own, vehicle="uav2", stamp_ns=NOW_NS - 10**9))
    feedback = there.feedback("uav1")
    if wrong == "displaced":
        feedback = dataclasses.replace(feedback, origin=feedback.origin + np.int32(50))
    elif wrong == "for another":
        feedback = dataclasses.replace(feedback, sources=("uav2/1", "uav3/1", "uav1/1"))
    else:
        restarted = dataclasses.replace(peer_packet(), ids=np.arange(1000, 1000 + COUNT, dtype=np.uint32), session=2)
        restarted = dataclasses.replace(restarted, sources=("uav2/2",), descriptors=255 - restarted.descriptors)
        here.inbox.add(dataclasses.replace(restarted, checksum=checksum(restarted)))
    here.returned.add(dataclasses.replace(feedback, checksum=checksum(feedback)))
    epoch = here.fuse(own)
    np.testing.assert_array_equal(epoch.pose.covariance, epoch.own.covariance)


def test_what_was_shared_is_forgotten_with_the_session_that_numbered_it(own, peer_packet) -> None:
    fusion = Fusion("uav1", EXACT)
    fusion.inbox.add(peer_packet())
    fusion.fuse(own)
    assert fusion._shared == set(own.ids.tolist())
    again = dataclasses.replace(own, session=2, stamp_ns=NOW_NS + 10**9, descriptors=255 - own.descriptors)
    fusion.fuse(again)
    assert not fusion._shared


def test_the_packet_of_last_time_is_used_while_it_shares_more_than_the_newest(own, peer_packet) -> None:
    fusion, shared, strange = Fusion("uav1", EXACT), peer_packet(sequence=1), peer_packet(sequence=2)
    fusion.inbox.add(shared)
    first = fusion.fuse(own)
    strange = dataclasses.replace(strange, descriptors=255 - strange.descriptors)
    fusion.inbox.add(dataclasses.replace(strange, checksum=checksum(strange)))
    second = fusion.fuse(own)
    np.testing.assert_array_equal(second.pose.covariance, first.pose.covariance)
    assert second.common == {"uav2": COUNT}


def test_the_packet_of_last_time_is_not_used_where_it_shares_less_than_the_newest(own, peer_packet) -> None:
    fusion, few = Fusion("uav1", EXACT), peer_packet(sequence=2)
    strange = peer_packet(sequence=1)
    strange = dataclasses.replace(strange, descriptors=255 - strange.descriptors)
    few = dataclasses.replace(few, descriptors=np.vstack([few.descriptors[:3], 255 - few.descriptors[3:]]))
    for packet, shared in ((strange, 0), (few, 3)):
        fusion.inbox.add(dataclasses.replace(packet, checksum=checksum(packet)))
        assert fusion.fuse(own).common == {"uav2": shared}


def test_only_landmarks_of_the_estimate_are_counted_as_sent(own) -> None:
    """A flight leaves ever more landmarks behind; their counts must not grow with it."""
    fusion = Fusion("uav1", EXACT)
    for first in (0, 100, 200):
        joint = dataclasses.replace(own, ids=np.arange(first, first + COUNT, dtype=np.uint32))
        fusion.fuse(joint)
        fusion.packet()
        assert set(fusion._times_sent) <= set(joint.ids.tolist())


def test_a_restart_withdraws_the_packet_of_last_time_too(own, peer_packet, make_joint) -> None:
    fusion = Fusion("uav1", EXACT)
    fusion.inbox.add(peer_packet())
    fusion.fuse(own)
    blind = make_joint(TRUTH + 500.0, belief_covariance(1.0), vehicle="uav2", session=2, stamp_ns=NOW_NS - 10**9)
    fusion.inbox.add(make_packet_for(blind))
    epoch = fusion.fuse(own)
    np.testing.assert_array_equal(epoch.pose.covariance, epoch.own.covariance)
