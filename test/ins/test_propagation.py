# SPDX-License-Identifier: Apache-2.0
"""The error transition is the derivative of the mean's propagation, for R_true = Exp(xi) R."""

import dataclasses
import itertools

import numpy as np
import pytest
from increment_error import shifted
from map_error import map_error
from numpy.typing import NDArray
from scipy.stats import chi2

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.ins.propagation import (
    ACCEL_BIAS,
    GYRO_BIAS,
    NAV_DIM,
    POSITION,
    ROTATION,
    VELOCITY,
    propagate,
    transition,
)
from uav_vslam.simulation.imu import simulate_imu
from uav_vslam.simulation.scenario import SimulatedVehicle
from uav_vslam.types import ImuIncrement, ImuSample, NavState

Array = NDArray[np.float64]

IMU = ImuConfig()
WALKING = ImuConfig(  # biases that walk fast, nearly without white noise
    gyro_noise=1e-9,
    accel_noise=1e-9,
    gyro_bias_walk=1e-3,
    accel_bias_walk=1e-1,
    gyro_bias_sigma=1e-9,
    accel_bias_sigma=1e-9,
)
FLIGHTS = 100
SPLIT = 0.03  # of a correlation; a second of turning at up to 0.3 rad/s is not quite the constant force assumed
STEP = 1e-5  # of each error coordinate, for central differences
DIFFERENCE = 2e-7  # absolute; the entries are of order one and below, the rounding 1e-16 * 100 m / step


def moved(state: NavState, error: Array) -> NavState:
    """Return the true state for this map-frame error."""
    return dataclasses.replace(
        state,
        T_map_body=Pose(so3_exp(error[ROTATION]) @ state.T_map_body.R, state.T_map_body.t + error[POSITION]),
        v_map=state.v_map + error[VELOCITY],
        gyro_bias=state.gyro_bias + error[GYRO_BIAS],
        accel_bias=state.accel_bias + error[ACCEL_BIAS],
    )


def increment_of(samples: list[ImuSample], imu: ImuConfig, at: NavState | None = None) -> ImuIncrement:
    """Return the motion from the first to the last reading, linearised at the biases of a state, or at zero."""
    biases = (np.zeros(3), np.zeros(3)) if at is None else (at.gyro_bias, at.accel_bias)
    ends = samples[0].stamp_ns, samples[-1].stamp_ns
    return preintegrate(samples, *ends, gyro_bias=biases[0], accel_bias=biases[1], imu=imu)


@pytest.fixture(scope="module")
def increment(readings) -> ImuIncrement:
    return increment_of(readings(3.0, 0.14, 28), IMU)


@pytest.fixture(params=["level", "banked", "nearly_upside_down"])
def start(request: pytest.FixtureRequest, increment: ImuIncrement) -> NavState:
    xi = {"level": [0.0, 0.0, 0.0], "banked": [0.7, -0.3, 2.0], "nearly_upside_down": [np.pi - 1e-4, 0.0, 0.0]}
    R = so3_exp(xi[request.param])
    return NavState(increment.start_ns, Pose(R, np.array([90.0, -20.0, 70.0])), R @ [20.0, 1.0, 0.5], *np.zeros((2, 3)))


def test_transition_is_the_derivative_of_the_mean(start: NavState, increment: ImuIncrement) -> None:
    F, _ = transition(start, increment, IMU)
    end = propagate(start, increment, gravity=IMU.gravity)
    numeric = np.zeros((NAV_DIM, NAV_DIM))
    for k, step in enumerate(STEP * np.eye(NAV_DIM)):
        plus = propagate(moved(start, step), increment, gravity=IMU.gravity)
        minus = propagate(moved(start, -step), increment, gravity=IMU.gravity)
        numeric[:, k] = (map_error(plus, end) - map_error(minus, end)) / (2 * STEP)
    np.testing.assert_allclose(F, numeric, rtol=0, atol=DIFFERENCE)


def test_process_noise_is_the_increments_error_propagated_to_the_end(start: NavState, increment: ImuIncrement) -> None:
    _, Q = transition(start, increment, dataclasses.replace(IMU, gyro_bias_walk=1e-10, accel_bias_walk=1e-8))
    end = propagate(start, increment, gravity=IMU.gravity)
    columns = []
    for step in STEP * np.eye(9):
        noisy = shifted(increment, step)
        columns.append(map_error(propagate(start, noisy, gravity=IMU.gravity), end) / STEP)
    G = np.column_stack(columns)
    expected = G @ increment.covariance @ G.T
    scale = np.where(np.arange(NAV_DIM) < 9, np.sqrt(np.diag(expected)), 1.0)
    # correlations, up to the step's relative rounding of 100 m
    np.testing.assert_allclose(Q / np.outer(scale, scale), expected / np.outer(scale, scale), rtol=0, atol=1e-5)


def test_covariance_of_walking_biases_does_not_depend_on_the_number_of_increments(readings) -> None:
    """One second of rough, turning flight, in one increment and in 200."""
    samples = readings(3.0, 1.0, 200)
    stamps = [sample.stamp_ns for sample in samples]
    start = NavState(
        stamps[0], Pose(so3_exp([0.7, -0.3, 2.0]), np.zeros(3)), np.array([20.0, 1.0, 0.5]), *np.zeros((2, 3))
    )
    _, once = transition(start, increment_of(samples, WALKING), WALKING)
    state, P = start, np.zeros((NAV_DIM, NAV_DIM))
    for pair in itertools.pairwise(samples):
        step = increment_of(list(pair), WALKING)
        F, Q = transition(state, step, WALKING)
        state, P = propagate(state, step, gravity=WALKING.gravity), F @ P @ F.T + Q
    scale = np.sqrt(np.diag(P))
    np.testing.assert_allclose(once / np.outer(scale, scale), P / np.outer(scale, scale), rtol=0, atol=SPLIT)


@pytest.mark.parametrize("increments", [1, 8])
def test_dead_reckoning_with_walking_biases_is_consistent(flight: SimulatedVehicle, increments: int) -> None:
    """NEES per axis of 100 flights of one second from a known state: almost all of the error is the walk's."""
    stamps = flight.truth.start_ns + np.arange(0, 10**9 + 1, 5 * 10**6)
    rng = np.random.default_rng(3)
    errors, P = [], np.zeros((0, 0))
    for _ in range(FLIGHTS):
        noisy = simulate_imu(flight.truth, stamps, WALKING, rng=rng)
        known = dataclasses.replace(
            flight.true_state(int(stamps[0])), gyro_bias=noisy.gyro_bias[0], accel_bias=noisy.accel_bias[0]
        )
        samples = noisy.samples()
        state, P = known, np.zeros((NAV_DIM, NAV_DIM))
        for part in np.array_split(np.arange(200), increments):
            step = increment_of(samples[part[0] : part[-1] + 2], WALKING, known)
            F, Q = transition(state, step, WALKING)
            state, P = propagate(state, step, gravity=WALKING.gravity), F @ P @ F.T + Q
        end = dataclasses.replace(
            flight.true_state(int(stamps[-1])), gyro_bias=noisy.gyro_bias[-1], accel_bias=noisy.accel_bias[-1]
        )
        errors.append(map_error(end, state))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 3 * FLIGHTS) / (3 * FLIGHTS)
    for rows in (POSITION, VELOCITY, ROTATION, GYRO_BIAS, ACCEL_BIAS):
        e = np.array(errors)[:, rows]
        nees = np.einsum("ni,ij,nj->n", e, np.linalg.inv(P[rows, rows]), e).mean() / 3
        assert low < nees < high, rows


def test_a_global_shift_or_yaw_commutes_with_the_propagation(start: NavState, increment: ImuIncrement) -> None:
    """Global position and yaw are unobservable: the mean moves along with them."""
    turn, shift = so3_exp([0.0, 0.0, 0.4]), np.array([3.0, -2.0, 1.0])
    world = Pose(turn, shift)
    other = dataclasses.replace(start, T_map_body=world @ start.T_map_body, v_map=turn @ start.v_map)
    a, b = (propagate(s, increment, gravity=IMU.gravity) for s in (start, other))
    np.testing.assert_allclose((world @ a.T_map_body).matrix, b.T_map_body.matrix, rtol=0, atol=1e-12)
    np.testing.assert_allclose(turn @ a.v_map, b.v_map, rtol=0, atol=1e-12)
