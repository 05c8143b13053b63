# SPDX-License-Identifier: Apache-2.0
"""The error transition is the derivative of the mean's propagation, for R_true = Exp(xi) R."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
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
from uav_vslam.types import ImuIncrement, NavState

Array = NDArray[np.float64]

IMU = ImuConfig()
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


def error_of(true: NavState, state: NavState) -> Array:
    return np.concatenate(
        [
            true.T_map_body.t - state.T_map_body.t,
            true.v_map - state.v_map,
            so3_log(true.T_map_body.R @ state.T_map_body.R.T),
            true.gyro_bias - state.gyro_bias,
            true.accel_bias - state.accel_bias,
        ]
    )


@pytest.fixture(scope="module")
def increment(readings) -> ImuIncrement:
    samples = readings(3.0, 0.14, 28)
    ends = samples[0].stamp_ns, samples[-1].stamp_ns
    return preintegrate(samples, *ends, gyro_bias=np.zeros(3), accel_bias=np.zeros(3), imu=IMU)


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
        numeric[:, k] = (error_of(plus, end) - error_of(minus, end)) / (2 * STEP)
    np.testing.assert_allclose(F, numeric, rtol=0, atol=DIFFERENCE)


def test_process_noise_is_the_increments_error_propagated_to_the_end(start: NavState, increment: ImuIncrement) -> None:
    _, Q = transition(start, increment, IMU)
    end = propagate(start, increment, gravity=IMU.gravity)
    columns = []
    for step in STEP * np.eye(9):
        noisy = dataclasses.replace(
            increment,
            delta_R=increment.delta_R @ so3_exp(step[:3]),
            delta_v=increment.delta_v + step[3:6],
            delta_p=increment.delta_p + step[6:9],
        )
        columns.append(error_of(propagate(start, noisy, gravity=IMU.gravity), end) / STEP)
    G = np.column_stack(columns)
    expected = G @ increment.covariance @ G.T
    walk = np.repeat([IMU.gyro_bias_walk**2, IMU.accel_bias_walk**2], 3) * increment.dt_s
    expected[9:, 9:] += np.diag(walk)
    scale = np.sqrt(np.diag(expected))
    # correlations, up to the step's relative rounding of 100 m
    np.testing.assert_allclose(Q / np.outer(scale, scale), expected / np.outer(scale, scale), rtol=0, atol=1e-5)


def test_a_global_shift_or_yaw_commutes_with_the_propagation(start: NavState, increment: ImuIncrement) -> None:
    """Global position and yaw are unobservable: the mean moves along with them."""
    turn, shift = so3_exp([0.0, 0.0, 0.4]), np.array([3.0, -2.0, 1.0])
    world = Pose(turn, shift)
    other = dataclasses.replace(start, T_map_body=world @ start.T_map_body, v_map=turn @ start.v_map)
    a, b = (propagate(s, increment, gravity=IMU.gravity) for s in (start, other))
    np.testing.assert_allclose((world @ a.T_map_body).matrix, b.T_map_body.matrix, rtol=0, atol=1e-12)
    np.testing.assert_allclose(turn @ a.v_map, b.v_map, rtol=0, atol=1e-12)
