# SPDX-License-Identifier: Apache-2.0
"""GTSAM is given what our filter is given: motion, start and pixels weigh the same in both."""

import dataclasses

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.studies.engine.factors import (
    CameraPair,
    Motion,
    RectifiedPair,
    start_factor,
    state_values,
    to_bias,
    to_nav_state,
    to_pose3,
    to_pose_covariance,
)
from uav_vslam.types import NavEstimate, NavState

IMU = ImuConfig()
SECOND_ORDER = 1e-3  # relative: errors of 1e-3 leave terms of that size beside the first-order ones

# Both take the midpoint, ours of the turned acceleration, GTSAM's of its tangent: they part by terms of third order in
# a step of 5 ms at less than 1 rad/s.
TURN = 1e-8  # [rad]
VELOCITY = 1e-7  # [m/s]
POSITION = 1e-8  # [m]
WEIGHT = 0.02  # relative, of an increment's covariance: a step in 28 counts fully there and half here


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def some_state(rng: np.random.Generator) -> NavState:
    pose = Pose(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 50.0, 3))
    return NavState(0, pose, rng.normal(0.0, 20.0, 3), rng.normal(0.0, 0.01, 3), rng.normal(0.0, 0.1, 3))


def test_the_motion_between_two_frames_is_our_increment() -> None:
    vehicle = simulate_vehicle(Scenario(frames=3), 0)
    samples, (_, start_ns, stamp_ns) = vehicle.imu.samples(), vehicle.frame_stamps_ns.tolist()
    state = dataclasses.replace(vehicle.initial.state, gyro_bias=np.full(3, 1e-3), accel_bias=np.full(3, 0.05))
    theirs = Motion(samples, IMU, state).between(start_ns, stamp_ns)
    ours = preintegrate(samples, start_ns, stamp_ns, gyro_bias=state.gyro_bias, accel_bias=state.accel_bias, imu=IMU)
    np.testing.assert_allclose(so3_log(theirs.deltaRij().matrix().T @ ours.delta_R), 0.0, rtol=0, atol=TURN)
    np.testing.assert_allclose(theirs.deltaVij(), ours.delta_v, rtol=0, atol=VELOCITY)
    np.testing.assert_allclose(theirs.deltaPij(), ours.delta_p, rtol=0, atol=POSITION)
    order = [0, 1, 2, 6, 7, 8, 3, 4, 5]  # GTSAM's: rotation, position, velocity
    whiten = np.linalg.inv(np.linalg.cholesky(theirs.preintMeasCov()[:9, :9]))
    np.testing.assert_allclose(
        whiten @ ours.covariance[np.ix_(order, order)] @ whiten.T, np.eye(9), rtol=0, atol=WEIGHT
    )
    walk = np.repeat([IMU.accel_bias_walk, IMU.gyro_bias_walk], 3) ** 2 * ours.dt_s
    np.testing.assert_allclose(np.diag(theirs.preintMeasCov())[9:], walk, rtol=1e-9)


def test_an_error_of_the_start_weighs_what_our_covariance_says(rng: np.random.Generator) -> None:
    root = rng.normal(0.0, 1.0, (15, 15)) * np.repeat([0.05, 0.1, 3e-3, 5e-4, 5e-2], 3)[:, None]
    start = NavEstimate(some_state(rng), root @ root.T)
    error = 1e-2 * root @ rng.normal(0.0, 1.0, 15)
    state = start.state
    true = NavState(
        0,
        Pose(so3_exp(error[6:9]) @ state.T_map_body.R, state.T_map_body.t + error[:3]),
        state.v_map + error[3:6],
        state.gyro_bias + error[9:12],
        state.accel_bias + error[12:15],
    )
    cost = start_factor(start).error(state_values(0, to_nav_state(true), to_bias(true)))
    assert cost == pytest.approx(0.5 * error @ np.linalg.solve(start.covariance, error), rel=SECOND_ORDER)


def test_a_pose_covariance_comes_back_in_our_frame_and_order(rng: np.random.Generator) -> None:
    pose = to_pose3(some_state(rng).T_map_body)
    sigma = np.array([1.0, 2.0, 3.0, 10.0, 20.0, 30.0])  # of GTSAM's tangent
    tangent = 1e-4 * sigma * rng.normal(0.0, 1.0, (20_000, 6))
    moved = [pose.retract(step) for step in tangent]
    R = pose.rotation().matrix()
    turns = so3_log(np.array([there.rotation().matrix() for there in moved]) @ R.T)
    errors = np.column_stack([np.array([there.translation() for there in moved]) - pose.translation(), turns])
    predicted = 1e-8 * to_pose_covariance(pose, np.diag(sigma**2))
    whiten = np.linalg.inv(np.linalg.cholesky(predicted))
    np.testing.assert_allclose(whiten @ np.cov(errors.T) @ whiten.T, np.eye(6), rtol=0, atol=0.05)  # 5 / sqrt(20000)


@pytest.mark.parametrize("cameras", [CameraPair, RectifiedPair])
def test_pixels_fit_the_point_that_made_them_and_weigh_its_error(cameras, rng: np.random.Generator) -> None:
    rig, sigma_px = kagaru_rig(), 0.5
    pose = some_state(rng).T_map_body
    points_left = np.array([[5.0, 3.0, 70.0], [-12.0, 9.0, 65.0], [0.0, -14.0, 74.0]])
    points = (pose @ rig.T_body_left).apply(points_left)
    graph = gtsam.NonlinearFactorGraph()
    cameras(rig, sigma_px).add(graph, rig.project(points_left), X(4), [L(0), L(1), L(2)])
    assert cost(graph, pose, points) == pytest.approx(0.0, abs=1e-15)
    for shift in 1e-3 * np.eye(3):
        moved = points_left + shift
        pixels = rig.project(moved) - rig.project(points_left)
        expected = 0.5 * np.sum(pixels**2) / sigma_px**2
        # Rectifying stretches pixels: 2 % of each, 4 % of its square.
        assert cost(graph, pose, (pose @ rig.T_body_left).apply(moved)) == pytest.approx(expected, rel=0.04)


def cost(graph: gtsam.NonlinearFactorGraph, pose: Pose, points: np.ndarray) -> float:
    values = gtsam.Values()
    values.insert(X(4), to_pose3(pose))
    for k, point in enumerate(points):
        values.insert(L(k), point)
    return float(graph.error(values))
