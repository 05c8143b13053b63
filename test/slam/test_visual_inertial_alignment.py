# SPDX-License-Identifier: Apache-2.0
"""Velocity and gravity from a second of flight: exact without noise, consistent with it, robust to wrong matches."""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from uav_vslam.config import IMU_GRADES, ImuConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.simulation.imu import ideal_imu, simulate_imu
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.simulation.trajectory import Trajectory
from uav_vslam.slam.map_points import MapPoints
from uav_vslam.slam.visual_inertial_alignment import (
    BIASES,
    GRAVITY,
    GYRO_BIAS,
    VELOCITY,
    Alignment,
    MapAlignment,
    View,
    align,
    align_in_map,
)
from uav_vslam.types import NS_PER_S, ImuIncrement, ImuSample

Array = NDArray[np.float64]

RIG = kagaru_rig()
IMU = IMU_GRADES["adis16480"]
DOWN = np.array([0.0, 0.0, -IMU.gravity])
FRAME_S = 0.14
DELAY_SIGMA_S = 0.003
POINTS = 60
RUNS = 15

# A consistent estimate's mean NEES over 15 runs of 3 degrees of freedom is within this with 99.8 %.
BAND = tuple(chi2.ppf([0.001, 0.999], 3 * RUNS) / (3 * RUNS))


@dataclass(frozen=True)
class Case:
    """A window of frames and the true motion at the first of them."""

    pixels: Array
    views: list[View]
    velocity_body: Array
    gravity_body: Array
    gyro_bias: Array
    ground: Array
    T_map_body: Pose

    def solve(self, *, imu: ImuConfig = IMU, sigma_px: float = 1.0, delay_sigma_s: float = DELAY_SIGMA_S) -> Alignment:
        return align(RIG, self.pixels, self.views, imu=imu, sigma_px=sigma_px, delay_sigma_s=delay_sigma_s)

    def solve_in_map(self, *, sigma_m: float, rng: np.random.Generator, wrong: int = 0) -> MapAlignment:
        """Solve with every third point in a map, from a pose that is 5 m and some degrees off."""
        rows = np.arange(0, POINTS, 3)
        positions = self.ground[rows] + rng.normal(0.0, sigma_m, (len(rows), 3))
        positions[:wrong] += 20.0
        turn = so3_exp(np.array([0.05, -0.05, 0.05]))
        off = Pose(turn @ self.T_map_body.R, self.T_map_body.t + np.array([5.0, -4.0, 3.0]))
        covariances = np.broadcast_to((sigma_m**2 + 1e-6) * np.eye(3), (len(rows), 3, 3))
        known = MapPoints(rows, positions, covariances, off)
        return align_in_map(RIG, self.pixels, self.views, known, imu=IMU, sigma_px=1.0, delay_sigma_s=DELAY_SIGMA_S)

    def pose_error(self, found: MapAlignment) -> Array:
        """Return the true position less the estimate, and the rotation vector between them, in map axes."""
        T = found.T_map_body
        return np.concatenate([self.T_map_body.t - T.t, so3_log(self.T_map_body.R @ T.R.T)])

    def nees(self, found: Alignment) -> tuple[float, float]:
        """NEES of velocity and gravity, per degree of freedom."""
        v, g = self.velocity_body - found.velocity, self.gravity_body - found.gravity
        P_v, P_g = (found.covariance[part, part] for part in (VELOCITY, GRAVITY))
        return float(v @ np.linalg.solve(P_v, v) / 3), float(g @ np.linalg.solve(P_g, g) / 3)


def motion(speed: float, *, hover: bool = False, gust_rate: float = 0.0) -> Trajectory:
    """70 m up, climbing and rolling gently, or almost still; gusts turn it at up to a rate [rad/s]."""
    t = np.arange(-0.5, 3.0, 0.02)
    shake = 0.1 if hover else 1.0
    xyz = np.stack([speed * t, shake * np.sin(t), 70.0 + 0.5 * shake * t**2], axis=1)
    rpy = np.stack([0.05 + 0.1 * shake * np.sin(2 * t), -0.1 + 0.05 * shake * t, 0.3 + 0.1 * shake * t], axis=1)
    rpy[:, :2] += gust_rate / 9.0 * np.stack([np.sin(9 * t), np.sin(8 * t + 1.0)], axis=1)
    return Trajectory(0, t, xyz, rpy)


def window(
    flown: Trajectory,
    *,
    frames: int = 8,
    sigma_px: float = 0.0,
    wrong: float = 0.0,
    imu: ImuConfig | None = None,
    delay_s: float = 0.0,
    seed: int = 0,
) -> Case:
    """Frames over ground with relief, exposed a delay after their stamps; without `imu` the readings are errorless."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(-100_000_000, 2_500_000_000, 2_000_000)
    if imu is None:
        readings = ideal_imu(flown, stamps, gravity=IMU.gravity)
    else:
        readings = simulate_imu(flown, stamps, imu, rng=rng)
    times = FRAME_S * np.arange(frames)
    ground = np.column_stack([rng.uniform(-25, 30, POINTS), rng.uniform(-25, 25, POINTS), rng.normal(0, 2.0, POINTS)])
    pixels = [observe(flown, float(t) + delay_s, ground, sigma_px, rng) for t in times]
    steps = list(itertools.pairwise(np.round(times * NS_PER_S).astype(int)))
    views = []
    for (start_ns, stamp_ns), z in zip(steps, pixels[1:], strict=True):
        swapped = rng.choice(POINTS, round(wrong * POINTS), replace=False)
        z[swapped] = z[np.roll(swapped, 1)]
        views.append(View(step(readings.samples(), start_ns, stamp_ns, imu or IMU), np.arange(POINTS), z))
    R = flown.pose(0.0).R
    return Case(
        pixels[0], views, R.T @ flown.velocity(0.0), R.T @ DOWN, readings.gyro_bias[50], ground, flown.pose(0.0)
    )


def observe(flown: Trajectory, t: float, ground: Array, sigma_px: float, rng: np.random.Generator) -> Array:
    points_left = (flown.pose(t) @ RIG.T_body_left).inverse().apply(ground)
    return RIG.project(points_left) + rng.normal(0.0, sigma_px, (len(ground), 4))


def step(samples: list[ImuSample], start_ns: int, stamp_ns: int, imu: ImuConfig) -> ImuIncrement:
    zero = np.zeros(3)
    return preintegrate(samples, int(start_ns), int(stamp_ns), gyro_bias=zero, accel_bias=zero, imu=imu)


@pytest.mark.parametrize(("speed", "hover"), [(20.0, False), (0.0, True), (-3.0, False)])
def test_without_noise_the_motion_is_found_exactly(speed: float, hover: bool) -> None:
    case = window(motion(speed, hover=hover))
    found = case.solve(sigma_px=0.01)
    # error of the midpoint rule at 500 Hz, 1e-5 m over a second
    np.testing.assert_allclose(found.velocity, case.velocity_body, atol=1e-3)
    np.testing.assert_allclose(found.gravity, case.gravity_body, atol=1e-3)
    assert found.inliers.tolist() == [POINTS] * 7


@pytest.mark.slow
@pytest.mark.parametrize("grade", ["adis16480", "consumer"])
@pytest.mark.parametrize("hover", [False, True])
def test_the_covariance_is_as_large_as_the_errors(grade: str, hover: bool) -> None:
    imu, found = IMU_GRADES[grade], []
    for seed in range(RUNS):
        case = window(motion(0.0 if hover else 20.0, hover=hover), sigma_px=1.0, imu=imu, seed=seed)
        found.append(case.nees(case.solve(imu=imu)))
    velocity, gravity = np.mean(found, axis=0)
    assert BAND[0] < velocity < BAND[1]
    assert gravity < BAND[1]  # its norm is more certain than the modelled 0.03 m/s^2


@pytest.mark.slow
def test_a_noisy_inertial_unit_is_not_trusted_over_a_long_window() -> None:
    """Its noise moves the last frame by decimetres, a hundred times the pixels' accuracy in a hover at 70 m."""
    noisy = ImuConfig(gyro_noise=2e-3, accel_noise=0.1)
    nees = []
    for seed in range(RUNS):
        case = window(motion(0.0, hover=True), frames=16, sigma_px=0.2, imu=noisy, seed=seed)
        nees.append(case.nees(case.solve(imu=noisy, sigma_px=0.2)))
    velocity, gravity = np.mean(nees, axis=0)
    assert velocity < BAND[1]
    assert gravity < BAND[1]


@pytest.mark.parametrize("wrong", [0.1, 0.3])
def test_wrong_matches_are_rejected(wrong: float) -> None:
    case = window(motion(20.0), sigma_px=1.0, wrong=wrong, imu=IMU)
    found = case.solve()
    assert np.linalg.norm(found.velocity - case.velocity_body) < 0.5
    right = round((1 - wrong) * POINTS)
    assert np.all(np.abs(found.inliers - right) <= 5)


def test_a_large_gyro_bias_is_estimated() -> None:
    imu = ImuConfig(gyro_bias_sigma=0.03)
    case = window(motion(20.0), sigma_px=0.3, imu=imu, seed=4)
    found = case.solve(imu=imu, sigma_px=0.3)
    assert np.linalg.norm(case.gyro_bias) > 0.02
    error = found.gyro_bias - case.gyro_bias
    assert error @ np.linalg.solve(found.covariance[GYRO_BIAS, GYRO_BIAS], error) < chi2.ppf(0.999, 3)
    assert np.linalg.norm(error) < 0.1 * np.linalg.norm(case.gyro_bias)


def test_a_delay_of_the_exposures_is_allowed_for() -> None:
    """Taken for exact, in gusts, most matches of some frames contradict the others, and the rest fit a wrong motion."""
    flown, nees, errors = motion(5.0, gust_rate=0.6), [], []
    for seed in range(RUNS):
        delay_s = np.random.default_rng(seed).normal(0.0, DELAY_SIGMA_S)
        case = window(flown, sigma_px=0.3, imu=IMU, delay_s=delay_s, seed=seed)
        found = case.solve(sigma_px=0.3)
        assert found.inliers.min() > 0.9 * POINTS
        nees.append(case.nees(found))
        errors.append(case.nees(case.solve(sigma_px=0.3, delay_sigma_s=0.0)))
    assert np.all(np.mean(nees, axis=0) < BAND[1])
    assert np.all(np.mean(errors, axis=0) > 10.0)


def test_inputs_are_not_modified() -> None:
    case = window(motion(20.0), sigma_px=1.0, imu=IMU)
    before = [case.pixels.copy(), *(view.pixels.copy() for view in case.views)]
    case.solve()
    for a, b in zip(before, [case.pixels, *(view.pixels for view in case.views)], strict=True):
        np.testing.assert_array_equal(a, b)


def test_without_matches_the_motion_is_undetermined() -> None:
    """The biases keep their prior, and the velocity is unknown."""
    case = window(motion(20.0))
    blind = [View(view.motion, view.rows[:1], view.pixels[:1] + 400.0) for view in case.views]
    found = align(RIG, case.pixels, blind, imu=IMU, sigma_px=1.0, delay_sigma_s=DELAY_SIGMA_S)
    assert np.isfinite(found.velocity).all()
    assert np.sqrt(found.covariance[0, 0]) > 5.0
    prior = np.repeat([IMU.gyro_bias_sigma, IMU.accel_bias_sigma], 3)
    assert np.all(np.sqrt(np.diag(found.covariance)[BIASES]) <= prior * (1 + 1e-6))


def test_without_noise_the_pose_in_the_map_is_found_exactly() -> None:
    case = window(motion(20.0))
    found = case.solve_in_map(sigma_m=0.0, rng=np.random.default_rng(1))
    np.testing.assert_allclose(case.pose_error(found), 0.0, atol=1e-3)
    np.testing.assert_allclose(found.velocity, case.velocity_body, atol=1e-3)
    assert found.landmarks == POINTS / 3


def test_the_pose_in_the_map_and_the_motion_err_together_as_their_covariance_says() -> None:
    values = []
    for seed in range(RUNS):
        case = window(motion(20.0), sigma_px=1.0, imu=IMU, seed=seed)
        found = case.solve_in_map(sigma_m=0.5, rng=np.random.default_rng(100 + seed))
        error = np.r_[case.velocity_body - found.velocity, case.pose_error(found)]
        P = found.covariance[np.ix_(kept := np.r_[0:3, 12:18], kept)]
        values.append(error @ np.linalg.solve(P, error) / len(error))
    low, high = chi2.ppf([0.001, 0.999], 9 * RUNS) / (9 * RUNS)
    assert low < np.mean(values) < high


def test_a_window_tells_tilt_better_than_its_first_frame() -> None:
    case = window(motion(20.0), sigma_px=1.0, imu=IMU)
    short = window(motion(20.0), sigma_px=1.0, imu=IMU, frames=2)
    both = (one.solve_in_map(sigma_m=0.5, rng=np.random.default_rng(1)) for one in (case, short))
    whole, first = (np.trace(found.covariance[15:17, 15:17]) for found in both)
    assert whole < 0.5 * first


def test_landmarks_at_the_wrong_place_in_the_map_are_rejected() -> None:
    case = window(motion(20.0), sigma_px=1.0, imu=IMU)
    found = case.solve_in_map(sigma_m=0.3, rng=np.random.default_rng(1), wrong=4)
    error = case.pose_error(found)
    assert found.landmarks <= POINTS / 3 - 4
    assert error @ np.linalg.solve(found.covariance[12:, 12:], error) < chi2.ppf(0.999, 6)
