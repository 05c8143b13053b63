# SPDX-License-Identifier: Apache-2.0
"""The thesis's map sharing schemes follow its equations, and so double-count until the filter is over-confident.

That a baseline fails proves nothing about its code: each is held against dense algebra on a small problem.
"""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from uav_vslam.config import RigConfig, VehicleConfig
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.evaluation.consistency import nees
from uav_vslam.simulation.landmarks import LandmarkNoise
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.slam.packet import PacketPolicy, make_packet
from uav_vslam.studies.engine.own_only import Flight, prepare, run_backend
from uav_vslam.studies.engine.write_back import (
    WRITE_BACK,
    Shared,
    Write,
    WriteBack,
    add_deltas,
    fly_with_write_back,
    intersect_each,
    overwrite,
)

Array = NDArray[np.float64]

pytestmark = pytest.mark.slow

FRAMES = 90
NAV, LANDMARKS = 15, 5
ROWS = np.array([3, 0, 4])  # of the own landmarks that are shared, in the order in which the peer names them
IDS = np.array([30, 10, 40], np.uint32)
WEIGHT_ACCURACY = 2e-3  # of a minimum that is searched, relative to what depends on it


def spd(rng: np.random.Generator, size: int) -> Array:
    """Return a well-conditioned covariance with correlations [m^2]."""
    A = rng.normal(size=(size, size))
    return np.asarray(0.02 * A @ A.T + np.diag(rng.uniform(0.5, 1.5, size)))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture
def own(rng: np.random.Generator) -> Filter:
    """A filter with plain additive errors (`so15`), five landmarks, and a belief that correlates all."""
    vehicle = simulate_vehicle(Scenario(frames=2, vehicles=1), 0)
    found = Filter(vehicle.initial, rig=vehicle.rig, imu=vehicle.scenario.imu_config, model="so15")
    found.mean = dataclasses.replace(found.mean, landmarks=rng.uniform(-20.0, 20.0, (LANDMARKS, 3)))
    found.belief = InformationBelief(np.linalg.inv(spd(rng, NAV + 3 * LANDMARKS)), NAV)
    return found


@pytest.fixture
def received(own: Filter, rng: np.random.Generator) -> Shared:
    """What a peer sent: metres off, and better than the own map along x, but worse along y and z."""
    scale = np.diag(np.tile([0.6, 2.0, 2.0], 3))
    P = scale @ spd(rng, 9) @ scale
    return Shared(IDS, own.landmarks[ROWS] + rng.normal(0.0, 2.0, (3, 3)), np.linalg.inv(P))


def state(f: Filter) -> Array:
    """Return (12 + 3N,) what corrections add to: position, velocity, biases, landmarks."""
    nav = f.nav
    return np.concatenate([nav.T_map_body.t, nav.v_map, nav.gyro_bias, nav.accel_bias, f.landmarks.ravel()])


def additive(delta: Array) -> Array:
    return np.delete(delta, [6, 7, 8])  # the rotation's turn the attitude, see `state`


def columns(row: int) -> slice:
    return slice(NAV + 3 * row, NAV + 3 * row + 3)


def intersection(a: Array, P_a: Array, b: Array, P_b: Array) -> tuple[Array, Array]:
    """Return mean and covariance of Eq. (7.1), with the weight of Eq. (7.2), by dense algebra."""

    def fused(w: float) -> Array:
        return np.asarray(np.linalg.inv(w * np.linalg.inv(P_a) + (1.0 - w) * np.linalg.inv(P_b)))

    w = minimize_scalar(lambda w: np.linalg.det(fused(w)), bounds=(0.0, 1.0), method="bounded").x
    assert 0.1 < w < 0.9
    P = fused(w)
    return P @ (w * np.linalg.solve(P_a, a) + (1.0 - w) * np.linalg.solve(P_b, b)), P


def test_intersecting_each_landmark_leaves_it_as_the_intersection_and_the_rest_follows(
    own: Filter, received: Shared
) -> None:
    P, x = own.covariance(), np.zeros(NAV + 3 * LANDMARKS)
    P_received, before = np.linalg.inv(received.information), state(own)
    for k, row in enumerate(ROWS):
        at, block = columns(row), slice(3 * k, 3 * k + 3)
        a = own.landmarks[row] + x[at]
        c, P_c = intersection(a, P[at, at], received.positions[k], P_received[block, block])
        G = P[:, at] @ np.linalg.inv(P[at, at])
        x, P = x + G @ (c - a), P - G @ (P[at, at] - P_c) @ G.T
    intersect_each(own, ROWS, received, None)
    np.testing.assert_allclose(own.covariance(), P, atol=WEIGHT_ACCURACY)
    np.testing.assert_allclose(state(own) - before, additive(x), atol=WEIGHT_ACCURACY)


def test_overwriting_puts_the_intersection_in_its_place_and_leaves_all_else(own: Filter, received: Shared) -> None:
    P, x = own.covariance(), np.zeros(NAV + 3 * LANDMARKS)
    P_received, before = np.linalg.inv(received.information), state(own)
    for k, row in enumerate(ROWS):
        at, block = columns(row), slice(3 * k, 3 * k + 3)
        c, P[at, at] = intersection(own.landmarks[row], P[at, at], received.positions[k], P_received[block, block])
        x[at] = c - own.landmarks[row]
    overwrite(own, ROWS, received, None)
    np.testing.assert_allclose(own.covariance(), P, atol=WEIGHT_ACCURACY)
    np.testing.assert_allclose(state(own) - before, additive(x), atol=WEIGHT_ACCURACY)


def test_adding_deltas_is_the_kalman_update_by_what_the_peer_has_measured_since(
    own: Filter, received: Shared, rng: np.random.Generator
) -> None:
    """Then it knew two of the landmarks; since it measured both as z with covariance R, and found a third one."""
    known, z, R = np.array([2, 0]), rng.normal(0.0, 20.0, 6), spd(rng, 6)
    then = Shared(IDS[known], received.positions[known], np.linalg.inv(spd(rng, 6)))
    Y = then.information + np.linalg.inv(R)
    x_now = np.linalg.solve(Y, then.information @ then.positions.ravel() + np.linalg.solve(R, z))
    at = np.r_[6:9, 0:3]  # of the two in the order of the newer packet
    positions, information = received.positions.copy(), np.eye(9)
    positions[known] = x_now.reshape(2, 3)
    information[np.ix_(at, at)] = Y
    P, before = own.covariance(), state(own)
    H = np.zeros((6, len(P)))
    for k, row in enumerate(ROWS[known]):
        H[3 * k : 3 * k + 3, columns(row)] = np.eye(3)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    x = K @ (z - own.landmarks[ROWS[known]].ravel())
    add_deltas(own, ROWS, Shared(IDS, positions, information), then)
    np.testing.assert_allclose(own.covariance(), P - K @ H @ P, atol=1e-9)
    np.testing.assert_allclose(state(own) - before, additive(x), atol=1e-9)


def test_a_first_packet_has_no_delta(own: Filter, received: Shared) -> None:
    before = state(own)
    add_deltas(own, ROWS, received, None)
    np.testing.assert_array_equal(state(own), before)


def test_what_is_shared_is_the_packets_marginal_over_those_landmarks(make_joint, rng: np.random.Generator) -> None:
    P = spd(rng, 6 + 12)
    packet = make_packet(make_joint(rng.uniform(-9, 9, (4, 3)), P), sequence=1, policy=PacketPolicy(max_landmarks=4))
    rows = np.array([2, 0])
    shared, at = Shared.of(packet, rows), np.r_[6:9, 0:3]
    assert shared.ids.tolist() == packet.ids[rows].tolist()
    np.testing.assert_array_equal(shared.positions, packet.positions[rows])
    np.testing.assert_allclose(np.linalg.inv(shared.information), packet.covariance[np.ix_(at, at)], rtol=1e-9)


@pytest.fixture(scope="module")
def flights() -> list[Flight]:
    return prepare(Scenario(frames=FRAMES), LandmarkNoise())


def test_without_a_word_between_them_each_flies_as_if_alone() -> None:
    flights = prepare(Scenario(frames=30), LandmarkNoise())
    tracks = fly_with_write_back(flights, VehicleConfig(), WriteBack(lambda *_: None, "nothing"))
    for flight in flights:
        alone = run_backend(flight, config=VehicleConfig()).estimate
        np.testing.assert_array_equal(tracks[flight.vehicle.name].estimate.positions, alone.positions)


@pytest.mark.parametrize("sends_own", [False, True])
def test_own_maps_hold_nothing_that_peers_wrote_and_fused_ones_do(sends_own: bool) -> None:
    flights = prepare(Scenario(frames=30), LandmarkNoise())

    def sent(write: Write) -> list[Shared]:
        packets: list[Shared] = []

        def noted(own: Filter, rows: NDArray[np.int64], received: Shared, before: Shared | None) -> None:
            assert not np.allclose(received.positions, own.landmarks[rows], atol=0.01)  # it is the peer's map
            packets.append(received)
            write(own, rows, received, before)

        fly_with_write_back(flights, VehicleConfig(), WriteBack(noted, "", sends_own=sends_own))
        return packets

    untouched, written = sent(lambda *_: None), sent(intersect_each)
    same = []
    for a, b in zip(untouched, written, strict=True):
        ids, of_a, of_b = np.intersect1d(a.ids, b.ids, return_indices=True)
        assert len(ids) > 5
        same.append(np.array_equal(a.positions[of_a], b.positions[of_b]))
    assert len(same) >= 6
    assert all(same[:2])  # nobody had written before the first exchange
    assert all(same) == sends_own


def test_intersecting_each_landmark_alone_grows_too_sure(flights: list[Flight]) -> None:
    trusted = VehicleConfig(rig=RigConfig(miscalibrated_probability=0.0))  # doubt about depths would be exchanged, too
    tracks = fly_with_write_back(flights, trusted, WRITE_BACK["landmark_ci"])
    for flight in flights:
        track, alone = tracks[flight.vehicle.name], run_backend(flight, config=trusted)
        assert not track.failure
        known, of_alone = (np.trace(t.estimate.covariance[-1][:3, :3]) for t in (track, alone))
        assert known < 0.5 * of_alone  # two equal vehicles can at best halve a variance
        found = nees(track.estimate, flight.truth)
        assert found is not None
        assert found.position[20:].mean() > 1.4


@pytest.mark.parametrize("name", ["overwrite", "deltas"])
def test_overwriting_and_deltas_break_the_filter_down(flights: list[Flight], name: str) -> None:
    tracks = fly_with_write_back(flights, VehicleConfig(), WRITE_BACK[name])
    for track in tracks.values():
        assert track.failure
        assert len(track.estimate) < FRAMES
