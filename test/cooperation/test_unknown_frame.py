# SPDX-License-Identifier: Apache-2.0
"""Joint estimation of the frame: equals a state with a flat prior, and no landmark counts twice."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from uav_vslam.cooperation.point_pairs import FRAME_DIM, corrected, rotated
from uav_vslam.cooperation.schemes import SCHEMES
from uav_vslam.cooperation.unknown_frame import UnknownFramePacket, eliminate_frame
from uav_vslam.estimation.covariance_intersection import Fused, Split, split_covariance_intersection
from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.rotation import rotation_from_rpy, so3_log

COUNT = 9
FLOOR_M = 0.2
PAIRS = np.column_stack([np.arange(COUNT)] * 2)
T_TRUE = Pose(rotation_from_rpy(0.0, 0.0, 2.5), np.array([40.0, -30.0, 6.0]))
POINTS = np.column_stack([np.random.default_rng(0).uniform(-40, 40, (COUNT, 2)), np.linspace(-3, 3, COUNT)])
SECOND_ORDER = 0.06  # of a sigma: 0.02 rad of yaw at 60 m, second order 12 mm against 0.2 m
RELATIVE = 1e-6  # of a sigma


def covariance(*, shift_m: float = 1.0, yaw: float = 0.01, tilt: float = 0.003, own_m: float = 0.2) -> np.ndarray:
    """Return (6+3N, 6+3N): a shift, yaw and tilt that pose and landmarks share, and each one's own error."""
    shared = np.zeros((POSE_DIM + 3 * COUNT, 6))
    shared[:6] = np.eye(6)
    shared[6:, :3] = np.tile(np.eye(3), (COUNT, 1))
    shared[6:, 3:] = np.stack([np.cross(axis, POINTS) for axis in np.eye(3)], axis=2).reshape(-1, 3)
    shared *= [shift_m, shift_m, shift_m, tilt, tilt, yaw]
    return shared @ shared.T + np.diag([1e-4] * 6 + [own_m**2] * (3 * COUNT))


OWN = covariance()
PEER = covariance(shift_m=2.0, tilt=0.001)


@pytest.fixture
def packet_of(sent_map):
    """Return a factory of packets from positions in the own frame: expressed in the peer's."""

    def make(positions=POINTS, P=PEER, T: Pose = T_TRUE):
        appearance = np.zeros((len(positions), 128), np.uint8)
        return sent_map(T.inverse().apply(positions), rotated(P[6:, 6:], T.R.T), appearance)

    return make


def independent(P: np.ndarray) -> Split:
    return Split(P, np.zeros_like(P))


def fuse(
    packet, T=T_TRUE, positions=POINTS, *, P=OWN, scheme="split_ci", weighing="position_trace", dependent=False
) -> tuple[UnknownFramePacket, Fused]:
    in_own_frame = eliminate_frame(positions, packet, PAIRS, T, floor_sigma_m=FLOOR_M, dependent=dependent)
    return in_own_frame, SCHEMES[scheme](independent(P), in_own_frame.evidence, weighing)


def assert_close(actual: np.ndarray, expected: np.ndarray) -> None:
    """Check a covariance in units of its sigmas."""
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        actual / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), rtol=0, atol=RELATIVE
    )


def test_it_equals_a_state_with_a_flat_prior(packet_of) -> None:
    """In information form a flat prior is zeros, so that nothing is lost to large numbers."""
    seen = POINTS + np.random.default_rng(1).normal(0, 0.3, POINTS.shape)
    packet = packet_of(seen)
    in_own_frame, fused = fuse(packet)
    whole = in_own_frame.whole
    n = len(OWN)
    Y, E = np.zeros((n + FRAME_DIM,) * 2), np.hstack([whole.E, -in_own_frame.A])
    R_inv = np.linalg.inv(whole.R + whole.floor)
    Y[:n, :n] = np.linalg.inv(OWN)
    P = np.linalg.inv(Y + E.T @ R_inv @ E)
    delta = P @ E.T @ R_inv @ whole.innovation
    frame = in_own_frame.frame(fused)
    assert_close(fused.P.total, P[:n, :n])
    assert_close(frame.covariance, P[n:, n:])
    np.testing.assert_allclose(fused.delta, delta[:n], rtol=0, atol=1e-8)
    np.testing.assert_allclose(frame.T_own_peer.matrix, corrected(T_TRUE, delta[n:]).matrix, rtol=0, atol=1e-8)


def test_it_equals_a_state_with_a_flat_prior_if_all_is_dependent(packet_of) -> None:
    """The same weight is found, and the belief is the same; here the flat prior is a large number."""
    in_own_frame, fused = fuse(packet_of(), dependent=True)
    whole, n = in_own_frame.whole, len(OWN)
    flat = np.diag([1e3**2, 1e3**2, 1e3**2, np.pi**2])
    independent_part, dependent_part = np.zeros((n + FRAME_DIM,) * 2), np.zeros((n + FRAME_DIM,) * 2)
    independent_part[n:, n:], dependent_part[:n, :n] = flat, OWN
    with_state = split_covariance_intersection(
        Split(independent_part, dependent_part),
        np.hstack([whole.E, -in_own_frame.A]),
        whole.innovation,
        Split(whole.floor, whole.R),
    )
    assert fused.weight == pytest.approx(with_state.weight, abs=2e-3)
    sigma = np.sqrt(np.diag(OWN))
    difference = (fused.P.total - with_state.P.total[:n, :n]) / np.outer(sigma, sigma)
    np.testing.assert_allclose(difference, 0.0, rtol=0, atol=1e-3)


@pytest.mark.parametrize("scheme", sorted(SCHEMES))
def test_the_pose_of_the_peers_map_is_no_information(packet_of, scheme: str) -> None:
    """A shift by metres and a yaw of a degree leave the own state's update unchanged, in every scheme."""
    seen = POINTS + np.random.default_rng(2).normal(0, 0.3, POINTS.shape)
    uncertain, sharp = covariance(shift_m=0.05, own_m=1.0), covariance(own_m=0.05)
    _, here = fuse(packet_of(seen, sharp), P=uncertain, scheme=scheme, weighing="trace")
    drift = Pose(rotation_from_rpy(0.0, 0.0, 0.02), np.array([3.0, -2.0, 4.0]))
    _, there = fuse(packet_of(seen, sharp, T=drift @ T_TRUE), P=uncertain, scheme=scheme, weighing="trace")
    sigma = np.sqrt(np.diag(uncertain))
    assert np.abs(here.delta / sigma).max() > 0.1
    np.testing.assert_allclose(there.delta / sigma, here.delta / sigma, rtol=0, atol=SECOND_ORDER)
    assert there.weight == pytest.approx(here.weight, abs=0.02)


def test_a_frame_taken_as_known_would_count_the_landmarks_twice(packet_of) -> None:
    """Maps of perfect shape: with an unknown frame the own position gains no information."""
    rigid = covariance(tilt=1e-6, own_m=1e-3)
    in_own_frame, fused = fuse(packet_of(P=rigid), P=rigid)
    position = slice(0, 3)
    np.testing.assert_allclose(fused.P.total[position, position], rigid[position, position], rtol=1e-3, atol=1e-6)
    naive = split_covariance_intersection(
        independent(rigid),
        in_own_frame.whole.E,
        in_own_frame.whole.innovation,
        independent(in_own_frame.whole.R + in_own_frame.whole.floor),
    )
    assert np.trace(naive.P.total[position, position]) < 0.8 * np.trace(rigid[position, position])


def test_a_peers_better_tilt_and_shape_are_fused(packet_of) -> None:
    uncertain = covariance(tilt=0.01, own_m=0.5)
    _, fused = fuse(packet_of(P=covariance(tilt=1e-4, own_m=0.01)), P=uncertain)
    assert uncertain[3, 3] - fused.P.total[3, 3] > 0.5 * 0.01**2  # of the tilt that pose and landmarks share
    assert np.trace(fused.P.total[6:, 6:]) < 0.9 * np.trace(uncertain[6:, 6:])


@pytest.mark.parametrize("dependent", [False, True])
def test_belief_and_frame_are_consistent(packet_of, dependent: bool) -> None:
    """NEES over draws from the covariances; independent errors must fill their bounds, and never exceed them."""
    runs, scores = 150, np.zeros(2)
    rng = np.random.default_rng(3)
    L_own, L_peer = np.linalg.cholesky(OWN), np.linalg.cholesky(PEER)
    shape = packet_of()
    T_0 = corrected(T_TRUE, np.array([0.5, -0.3, 0.2, 0.005]))
    for _ in range(runs):
        own, peer = L_own @ rng.normal(size=len(OWN)), L_peer @ rng.normal(size=len(PEER))
        seen = T_TRUE.inverse().apply(POINTS + peer[6:].reshape(-1, 3) + FLOOR_M * rng.normal(size=POINTS.shape))
        packet = dataclasses.replace(shape, positions=seen)
        in_own_frame, fused = fuse(packet, T_0, POINTS + own[6:].reshape(-1, 3), dependent=dependent)
        frame = in_own_frame.frame(fused)
        pose = own[:6] + fused.delta[:6]
        error = np.append(T_TRUE.t - frame.T_own_peer.t, so3_log(T_TRUE.R @ frame.T_own_peer.R.T)[2])
        scores += (
            pose @ np.linalg.solve(fused.P.total[:6, :6], pose) / 6,
            error @ np.linalg.solve(frame.covariance, error) / FRAME_DIM,
        )
    for score, size in zip(scores / runs, (6, FRAME_DIM), strict=True):
        low, high = chi2.ppf([0.0005, 0.9995], size * runs) / size / runs
        assert score < high
        assert dependent or score > low


def test_correlated_maps_leave_an_uncertain_frame(packet_of) -> None:
    """The maps share a source with opposite errors, the peer's twice as large."""
    runs, score = 150, 0.0
    rng = np.random.default_rng(4)
    for _ in range(runs):
        shift = rng.normal(size=3)
        packet = packet_of(POINTS - 2.0 * shift)
        in_own_frame, fused = fuse(packet, T_TRUE, POINTS + shift, dependent=True)
        frame = in_own_frame.frame(fused)
        error = T_TRUE.t - frame.T_own_peer.t
        score += error @ np.linalg.solve(frame.covariance[:3, :3], error) / 3
    assert score / runs < 1.0


def test_the_packets_covariance_is_rotated_with_its_landmarks(packet_of) -> None:
    stretched = PEER + np.diag(np.tile([4.0, 0.0, 1.0], COUNT + 2))
    in_own_frame, _ = fuse(packet_of(P=stretched))
    np.testing.assert_allclose(in_own_frame.whole.R, stretched[6:, 6:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(in_own_frame.whole.innovation, 0.0, atol=1e-12)


def test_two_pairs_constrain_their_distance_and_slope(packet_of) -> None:
    in_own_frame = eliminate_frame(POINTS, packet_of(), PAIRS[:2], T_TRUE, floor_sigma_m=FLOOR_M, dependent=False)
    assert in_own_frame.evidence.E.shape == (2, len(OWN))
    np.testing.assert_allclose(in_own_frame.evidence.E[:, :POSE_DIM], 0.0)
    fused = SCHEMES["split_ci"](independent(OWN), in_own_frame.evidence, "position_trace")
    np.testing.assert_allclose(fused.delta, 0.0, atol=1e-9)
