# SPDX-License-Identifier: Apache-2.0
"""Jacobians of the observations against differences, and elimination against the dense normal equations."""

from collections.abc import Callable

import numpy as np
import pytest

from uav_vslam.config import RigConfig
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.propagation import NAV_DIM
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.smoothing.arrowhead import Arrowhead
from uav_vslam.smoothing.cameras import Cameras, PixelNoise, RigEstimate
from uav_vslam.smoothing.chain import moved
from uav_vslam.smoothing.layout import Layout
from uav_vslam.smoothing.points import ties, triangulated
from uav_vslam.smoothing.sightings import Sightings
from uav_vslam.smoothing.views import POINT_DIM, add_views, eliminate, linearise
from uav_vslam.types import NavState

STATES = 5
NOISE = PixelNoise(0.5, 0.2, 1e-3)
STEP = 1e-5
SEEN = [0, 1, 2, 6, 7, 8, 15, 16, 17]  # position, attitude, vibration
STRIDE = NAV_DIM + 3
RIG = RigConfig(flexing=True, time_offset_sigma_s=0.01)
TURNING = Turning(np.array([0.3, -0.2, 0.1]), np.array([3.0, 1.0, -2.0]))


@pytest.fixture
def flight() -> tuple[list[NavState], RigEstimate, Sightings, np.ndarray]:
    """Five states over four points, the last two of which show the same landmark; a rig that is wrong and flexes."""
    rng, rig = np.random.default_rng(5), kagaru_rig()
    zero = np.zeros(3)
    states = [
        NavState(
            k, Pose(so3_exp(0.05 * rng.normal(size=3)), np.array([4.0 * k, 0, 70])), np.array([20.0, 1, 0]), zero, zero
        )
        for k in range(STATES)
    ]
    perfect = RigEstimate.of(rig, RIG, STATES)
    ground = np.column_stack([rng.uniform(0, 20, 4), rng.uniform(-10, 10, 4), rng.uniform(-2, 2, 4)])
    rows = np.array([0, 1, 2, 0, 1, 3, 1, 2, 3, 4, 2, 4])
    own = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2, 2, 3, 3])
    pixels = rig.project(cameras(states, perfect).points_left(rows, ground[own])) + rng.normal(0, 0.5, (len(rows), 4))
    sightings = Sightings(rows, own, pixels, np.array([-1, -1, 0, 0]), np.zeros(4, int), True)
    points = triangulated(sightings, cameras(states, perfect))
    points[:, 3:] = rng.normal(size=(4, 4)) * [0.2, 0.2, 1e-3, 1e-3]
    wrong = perfect.moved(1e-4 * rng.normal(size=perfect.errors.dim), 1e-4 * rng.normal(size=(STATES, 3)))
    return states, wrong, sightings, points


def cameras(states: list[NavState], rig: RigEstimate) -> Cameras:
    return Cameras(states, [TURNING] * STATES, rig)


def residuals(states: list[NavState], rig: RigEstimate, sightings: Sightings, points: np.ndarray) -> np.ndarray:
    """Return normalised residuals, without the robust weights that do not count as a function of the unknowns."""
    view = linearise(sightings, cameras(states, rig), points, NOISE)
    return view.residual * np.sqrt(view.misfit / np.sum(view.residual**2, axis=1))[:, None]


def test_jacobians_equal_differences(flight) -> None:
    states, rig, sightings, points = flight
    view = linearise(sightings, cameras(states, rig), points, NOISE)
    weight = np.sqrt(np.sum(view.residual**2, axis=1) / view.misfit)[:, None]

    def differences(change: Callable[[float], tuple[list[NavState], RigEstimate, np.ndarray]]) -> np.ndarray:
        ahead, back = (residuals(where, how, sightings, which) for where, how, which in (change(STEP), change(-STEP)))
        return -weight * (ahead - back) / (2 * STEP)

    nothing = np.zeros(rig.errors.dim), np.zeros((STATES, 3))
    for column, row in enumerate(SEEN):
        unit = np.tile(np.eye(STRIDE)[row], (STATES, 1))
        found = differences(
            lambda step, unit=unit: (
                moved(states, step * unit[:, :NAV_DIM]),
                rig.moved(nothing[0], step * unit[:, NAV_DIM:]),
                points,
            )
        )
        assert_near(found, view.by_pose[:, :, column])
    for column in range(POINT_DIM):
        unit = np.eye(POINT_DIM)[column]
        found = differences(lambda step, unit=unit: (states, rig, points + step * unit))
        assert_near(found, view.by_point[:, :, column])
    for column in range(rig.errors.dim):
        unit = np.eye(rig.errors.dim)[column]
        found = differences(lambda step, unit=unit: (states, rig.moved(step * unit, nothing[1]), points))
        assert_near(found, view.by_rig[:, :, column])


def assert_near(found: np.ndarray, J: np.ndarray) -> None:
    """Compare with the largest entry: Jacobians are of a rig that has moved by next to nothing, here 1e-4 rad."""
    assert np.abs(found - J).max() <= 1e-3 * np.abs(J).max()


@pytest.mark.parametrize("size", [5, 8])
def test_eliminated_points_leave_the_schur_complement_and_the_same_solution(flight, size: int) -> None:
    states, rig, sightings, points = flight
    landmarks, sigma_m = points[2:3, :3] + 0.1, np.full(4, 0.5)
    tied = ties(sightings.landmarks, points, landmarks, sigma_m)
    view = linearise(sightings, cameras(states, rig), points, NOISE)
    eliminated = eliminate(sightings, view, points, NOISE, tied)
    layout = Layout(STATES, size, vibration=3, rig=rig.errors.dim, landmarks=1)
    system = Arrowhead.zeros(1, size * layout.stride, layout.border)
    add_views(system, layout, 0, view, eliminated, tied)

    H, g = dense(view, sightings, points, landmarks, tied.information)
    kept = len(SEEN) * STATES + layout.border
    complement = H[:kept, :kept] - H[:kept, kept:] @ np.linalg.solve(H[kept:, kept:], H[kept:, :kept])
    reduced = g[:kept] - H[:kept, kept:] @ np.linalg.solve(H[kept:, kept:], g[kept:])
    rows = (STRIDE * np.arange(STATES)[:, None] + SEEN).ravel()
    found = np.block(
        [
            [system.diagonal[0][np.ix_(rows, rows)], system.coupling[0, rows]],
            [system.coupling[0, rows].T, system.border],
        ]
    )
    scale = np.sqrt(np.maximum(np.diagonal(complement), 1e-6))  # zero for the vibration's place in the border
    assert np.abs((found - complement) / np.outer(scale, scale)).max() < 1e-8
    assert np.abs((np.concatenate([system.rhs[0, rows], system.border_rhs]) - reduced) / scale).max() < 1e-8

    step = np.random.default_rng(6).normal(size=kept) * 1e-3
    poses, rig_step, landmark_step = np.split(step, [len(SEEN) * STATES, kept - 3])
    expected = np.linalg.solve(H[kept:, kept:], g[kept:] - H[kept:, :kept] @ step).reshape(-1, POINT_DIM)
    own_landmark = np.where(sightings.landmarks[:, None] >= 0, landmark_step, 0.0)
    corrections = eliminated.corrections(poses.reshape(STATES, -1), rig_step, own_landmark)
    assert np.allclose(corrections, expected, rtol=1e-6, atol=1e-8)


def dense(view, sightings: Sightings, points: np.ndarray, landmarks: np.ndarray, tied: np.ndarray):
    """Return H and g over poses, rig, landmark and points, from a Jacobian written out in full."""
    first_rig = len(SEEN) * STATES
    first_point = first_rig + view.by_rig.shape[2] + 3
    total = first_point + points.size
    rows, values = [], []
    for k, (state, point) in enumerate(zip(sightings.states, sightings.points, strict=True)):
        J = np.zeros((4, total))
        J[:, len(SEEN) * state : len(SEEN) * (state + 1)] = view.by_pose[k]
        J[:, first_rig : first_point - 3] = view.by_rig[k]
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
            rows.append(tie * np.sqrt(tied[point]))
            values.append((landmarks[0] - points[point, :3]) * np.sqrt(tied[point]))
    J, r = np.vstack(rows), np.concatenate(values)
    return J.T @ J, J.T @ r
