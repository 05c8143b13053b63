# SPDX-License-Identifier: Apache-2.0
"""Jacobians of the observations against differences, and elimination against the dense normal equations."""

import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.propagation import NAV_DIM
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.smoothing.arrowhead import Arrowhead
from uav_vslam.smoothing.cameras import Cameras, PixelNoise
from uav_vslam.smoothing.chain import moved
from uav_vslam.smoothing.points import ties, triangulated
from uav_vslam.smoothing.sightings import Sightings
from uav_vslam.smoothing.views import POINT_DIM, add_views, eliminate, linearise
from uav_vslam.types import NavState

STATES = 5
NOISE = PixelNoise(0.5, 0.2, 1e-3)
STEP = 1e-5
POSE = [0, 1, 2, 6, 7, 8]


@pytest.fixture
def flight() -> tuple[list[NavState], Sightings, np.ndarray]:
    """Five states over four points, the last two of which show the same landmark."""
    rng, rig = np.random.default_rng(5), kagaru_rig()
    zero = np.zeros(3)
    states = [
        NavState(k, Pose(so3_exp(0.05 * rng.normal(size=3)), np.array([4.0 * k, 0, 70])), zero, zero, zero)
        for k in range(STATES)
    ]
    ground = np.column_stack([rng.uniform(0, 20, 4), rng.uniform(-10, 10, 4), rng.uniform(-2, 2, 4)])
    rows = np.array([0, 1, 2, 0, 1, 3, 1, 2, 3, 4, 2, 4])
    own = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2, 2, 3, 3])
    pixels = rig.project(Cameras.of(rig, states).points_left(rows, ground[own])) + rng.normal(0, 0.5, (len(rows), 4))
    sightings = Sightings(rows, own, pixels, np.array([-1, -1, 0, 0]), True)
    points = triangulated(sightings, Cameras.of(rig, states))
    points[:, 3:] = rng.normal(size=(4, 4)) * [0.2, 0.2, 1e-3, 1e-3]
    return states, sightings, points


def residuals(states: list[NavState], sightings: Sightings, points: np.ndarray) -> np.ndarray:
    """Return normalised residuals, without the robust weights that do not count as a function of the unknowns."""
    view = linearise(sightings, Cameras.of(kagaru_rig(), states), points, NOISE)
    return view.residual * np.sqrt(view.misfit / np.sum(view.residual**2, axis=1))[:, None]


def test_jacobians_equal_differences(flight) -> None:
    states, sightings, points = flight
    view = linearise(sightings, Cameras.of(kagaru_rig(), states), points, NOISE)
    weight = np.sqrt(np.sum(view.residual**2, axis=1) / view.misfit)[:, None]
    for column in range(6):
        delta = np.zeros((STATES, NAV_DIM))
        delta[:, POSE[column]] = STEP
        ahead, back = (residuals(moved(states, sign * delta), sightings, points) for sign in (1, -1))
        assert np.allclose(-weight * (ahead - back) / (2 * STEP), view.by_pose[:, :, column], rtol=1e-5, atol=1e-4)
    for column in range(POINT_DIM):
        delta = STEP * np.eye(POINT_DIM)[column]
        ahead, back = (residuals(states, sightings, points + sign * delta) for sign in (1, -1))
        assert np.allclose(-weight * (ahead - back) / (2 * STEP), view.by_point[:, :, column], rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("size", [5, 8])
def test_eliminated_points_leave_the_schur_complement_and_the_same_solution(flight, size: int) -> None:
    states, sightings, points = flight
    landmarks, sigma_m = points[2:3, :3] + 0.1, np.full(4, 0.5)
    tied = ties(sightings.landmarks, points, landmarks, sigma_m)
    view = linearise(sightings, Cameras.of(kagaru_rig(), states), points, NOISE)
    eliminated = eliminate(sightings, view, points, NOISE, tied)
    system = Arrowhead.zeros(1, size * NAV_DIM, 3)
    add_views(system, 0, view, eliminated, tied)

    H, g = dense(view, sightings, points, landmarks, sigma_m)
    kept = 6 * STATES + 3
    complement = H[:kept, :kept] - H[:kept, kept:] @ np.linalg.solve(H[kept:, kept:], H[kept:, :kept])
    reduced = g[:kept] - H[:kept, kept:] @ np.linalg.solve(H[kept:, kept:], g[kept:])
    rows = (NAV_DIM * np.arange(STATES)[:, None] + POSE).ravel()
    found = np.block(
        [
            [system.diagonal[0][np.ix_(rows, rows)], system.coupling[0, rows]],
            [system.coupling[0, rows].T, system.border],
        ]
    )
    scale = np.sqrt(np.outer(np.diagonal(complement), np.diagonal(complement)))
    assert np.abs((found - complement) / scale).max() < 1e-9
    assert np.allclose(np.concatenate([system.rhs[0, rows], system.border_rhs]), reduced, rtol=1e-8, atol=1e-6)

    step = np.random.default_rng(6).normal(size=kept) * 0.01
    expected = np.linalg.solve(H[kept:, kept:], g[kept:] - H[kept:, :kept] @ step).reshape(-1, POINT_DIM)
    own_landmark = np.where(sightings.landmarks[:, None] >= 0, step[-3:], 0.0)
    corrections = eliminated.corrections(step[:-3].reshape(-1, 6), own_landmark)
    assert np.allclose(corrections, expected, rtol=1e-7, atol=1e-9)


def dense(view, sightings: Sightings, points: np.ndarray, landmarks: np.ndarray, sigma_m: np.ndarray):
    """Return H and g over the poses, the landmark and the points, from a Jacobian written out in full."""
    first_point = 6 * STATES + 3
    total = first_point + points.size
    rows, values = [], []
    for k, (state, point) in enumerate(zip(sightings.states, sightings.points, strict=True)):
        J = np.zeros((4, total))
        J[:, 6 * state : 6 * state + 6] = view.by_pose[k]
        J[:, first_point + POINT_DIM * point :][:, :POINT_DIM] = view.by_point[k]
        rows.append(J)
        values.append(view.residual[k])
    for point in range(len(points)):
        start = first_point + POINT_DIM * point
        prior = np.zeros((4, total))
        prior[:, start + 3 : start + POINT_DIM] = np.diag(np.sqrt(NOISE.prior_information))
        rows.append(prior)
        values.append(-np.sqrt(NOISE.prior_information) * points[point, 3:])
        if sightings.landmarks[point] >= 0:
            tie = np.zeros((3, total))
            tie[:, start : start + 3], tie[:, first_point - 3 : first_point] = np.eye(3), -np.eye(3)
            rows.append(tie / sigma_m[point])
            values.append((landmarks[0] - points[point, :3]) / sigma_m[point])
    J, r = np.vstack(rows), np.concatenate(values)
    return J.T @ J, J.T @ r
