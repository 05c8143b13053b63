# SPDX-License-Identifier: Apache-2.0
"""Increments against GTSAM and the true motion; their derivatives and covariance against perturbed readings."""

import dataclasses
import functools
import itertools
from functools import partial

import gtsam
import numpy as np
import pytest
from increment_error import difference
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_left_jacobian, so3_log
from uav_vslam.ins.increments import compose
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.ins.propagation import corrected, propagate
from uav_vslam.types import NS_PER_S, ImuIncrement, ImuSample, NavState

Array = NDArray[np.float64]

IMU = ImuConfig()
GYRO_BIAS, ACCEL_BIAS = np.array([0.01, -0.02, 0.015]), np.array([0.1, 0.2, -0.1])
START_S, FRAME_S = 3.0, 0.14  # one image interval in the middle of a turn

# GTSAM uses the attitude at the start of each step, we use the midpoint. At 10 kHz the difference is half a step's
# rotation (5e-5 s * 0.5 rad/s) of 10 m/s^2 over 0.14 s.
GTSAM_STEPS = 1400
GTSAM_ROTATION = 1e-9  # [rad]
GTSAM_VELOCITY = 2e-5  # [m/s]
GTSAM_POSITION = 2e-6  # [m]
GTSAM_RELATIVE = 2e-3  # of Jacobian and covariance: one step in 1400 has full weight there and half here

STEP = 1e-5  # of a bias, for central differences
DIFFERENCE = 1e-7  # of such a derivative, relative


def integrate(samples: list[ImuSample], gyro_bias: Array = GYRO_BIAS, accel_bias: Array = ACCEL_BIAS) -> ImuIncrement:
    return preintegrate(
        samples, samples[0].stamp_ns, samples[-1].stamp_ns, gyro_bias=gyro_bias, accel_bias=accel_bias, imu=IMU
    )


def gtsam_measurements(kind: str, samples: list[ImuSample], gyro_bias: Array, accel_bias: Array):
    if kind == "combined":
        params = gtsam.PreintegrationCombinedParams.MakeSharedU(IMU.gravity)
        params.setBiasAccCovariance(1e-20 * np.eye(3))  # ours assumes a constant bias
        params.setBiasOmegaCovariance(1e-20 * np.eye(3))
        cls = gtsam.PreintegratedCombinedMeasurements
    else:
        params = gtsam.PreintegrationParams.MakeSharedU(IMU.gravity)
        cls = gtsam.PreintegratedImuMeasurements
    params.setGyroscopeCovariance(IMU.gyro_noise**2 * np.eye(3))
    params.setAccelerometerCovariance(IMU.accel_noise**2 * np.eye(3))
    params.setIntegrationCovariance(np.zeros((3, 3)))
    measurements = cls(params, gtsam.imuBias.ConstantBias(accel_bias, gyro_bias))
    for a, b in itertools.pairwise(samples):
        dt_s = (b.stamp_ns - a.stamp_ns) / NS_PER_S
        measurements.integrateMeasurement(0.5 * (a.accel + b.accel), 0.5 * (a.gyro + b.gyro), dt_s)
    return measurements


def gtsam_difference(a, reference) -> Array:
    turn = so3_log(reference.deltaRij().matrix().T @ a.deltaRij().matrix())
    return np.concatenate([turn, a.deltaVij() - reference.deltaVij(), a.deltaPij() - reference.deltaPij()])


def relative(a: Array, b: Array) -> float:
    """Return the largest difference of 3x3 blocks, relative to the block of b."""
    worst = 0.0
    for i in range(0, len(b), 3):
        for j in range(0, b.shape[1], 3):
            block = b[i : i + 3, j : j + 3]
            if np.any(block):
                worst = max(worst, np.abs(a[i : i + 3, j : j + 3] - block).max() / np.abs(block).max())
    return worst


@pytest.mark.parametrize("kind", ["combined", "plain"])
def test_mean_and_covariance_equal_gtsam(readings, kind: str) -> None:
    samples = readings(START_S, FRAME_S, GTSAM_STEPS)
    ours, theirs = integrate(samples), gtsam_measurements(kind, samples, GYRO_BIAS, ACCEL_BIAS)
    np.testing.assert_allclose(so3_log(theirs.deltaRij().matrix().T @ ours.delta_R), 0.0, rtol=0, atol=GTSAM_ROTATION)
    np.testing.assert_allclose(ours.delta_v, theirs.deltaVij(), rtol=0, atol=GTSAM_VELOCITY)
    np.testing.assert_allclose(ours.delta_p, theirs.deltaPij(), rtol=0, atol=GTSAM_POSITION)
    # GTSAM's order is rotation, position, velocity, and its rotation error is the vector's: J_r^-1 of ours.
    order = [0, 1, 2, 6, 7, 8, 3, 4, 5]
    to_tangent = np.eye(9)
    to_tangent[:3, :3] = np.linalg.inv(so3_left_jacobian(-so3_log(ours.delta_R)))
    mine = to_tangent @ ours.covariance[np.ix_(order, order)] @ to_tangent.T
    whiten = np.linalg.inv(np.linalg.cholesky(theirs.preintMeasCov()[:9, :9]))
    np.testing.assert_allclose(whiten @ mine @ whiten.T, np.eye(9), rtol=0, atol=GTSAM_RELATIVE)


def test_bias_jacobian_equals_gtsam(readings) -> None:
    samples = readings(START_S, FRAME_S, GTSAM_STEPS // 4)
    reference = gtsam_measurements("plain", samples, GYRO_BIAS, ACCEL_BIAS)
    columns = []
    for step in 1e-4 * np.eye(6):
        there = gtsam_measurements("plain", samples, GYRO_BIAS + step[:3], ACCEL_BIAS + step[3:])
        columns.append(gtsam_difference(there, reference) / 1e-4)
    assert relative(integrate(samples).bias_jacobian, np.column_stack(columns)) < 4 * GTSAM_RELATIVE


@pytest.mark.parametrize("count", [1, 3, 28])
def test_bias_jacobian_is_the_numerical_one_for_any_number_of_readings(readings, count: int) -> None:
    samples = readings(START_S, FRAME_S, count)
    reference = integrate(samples)
    columns = []
    for step in STEP * np.eye(6):
        plus = integrate(samples, GYRO_BIAS + step[:3], ACCEL_BIAS + step[3:])
        minus = integrate(samples, GYRO_BIAS - step[:3], ACCEL_BIAS - step[3:])
        columns.append((difference(plus, reference) - difference(minus, reference)) / (2 * STEP))
    assert relative(reference.bias_jacobian, np.column_stack(columns)) < DIFFERENCE


@pytest.mark.parametrize(("count", "tolerance"), [(28, 0.1), (100, 0.03)])
def test_covariance_is_the_sum_over_the_readings_errors(readings, count: int, tolerance: float) -> None:
    """Perturb each reading: sum G sigma^2/dt G^T. The end readings have half weight, hence a tolerance of 3 / count."""
    samples = readings(START_S, FRAME_S, count)
    reference = integrate(samples)
    variance = np.repeat([IMU.gyro_noise**2, IMU.accel_noise**2], 3) * count / FRAME_S
    expected = np.zeros((9, 9))
    for k, sample in enumerate(samples):
        for axis, step in enumerate(1e-4 * np.eye(6)):
            moved = dataclasses.replace(sample, gyro=sample.gyro + step[:3], accel=sample.accel + step[3:])
            g = difference(integrate([*samples[:k], moved, *samples[k + 1 :]]), reference) / 1e-4
            expected += variance[axis] * np.outer(g, g)
    whiten = np.linalg.inv(np.linalg.cholesky(expected))
    eigenvalues = np.linalg.eigvalsh(whiten @ reference.covariance @ whiten.T)
    np.testing.assert_allclose(eigenvalues, 1.0, rtol=0, atol=tolerance)


def test_bias_correction_approximates_integration_at_the_other_bias(readings) -> None:
    samples = readings(START_S, FRAME_S, 28)
    at_zero = integrate(samples, np.zeros(3), np.zeros(3))
    delta_R, delta_v, delta_p = corrected(at_zero, GYRO_BIAS, ACCEL_BIAS)
    there = integrate(samples)
    # First order in a gyro bias of 0.03 rad/s and an accelerometer bias of 0.24 m/s^2 over 0.14 s: their product,
    # 0.03 * 0.24 * 0.14^2 / 2, remains, and the square of the former.
    np.testing.assert_allclose(so3_log(there.delta_R.T @ delta_R), 0.0, rtol=0, atol=1e-5)
    np.testing.assert_allclose(delta_v, there.delta_v, rtol=0, atol=1e-4)
    np.testing.assert_allclose(delta_p, there.delta_p, rtol=0, atol=1e-5)


def test_errorless_readings_at_200_hz_reproduce_the_true_flight(readings, flight) -> None:
    """The midpoint rule over 5 s of a flight that vibrates at 4 Hz: a millimetre a second."""
    truth, start_s, duration_s = flight.truth, 1.0, 5.0
    samples = readings(start_s, duration_s, 1000)
    increment = integrate(samples, np.zeros(3), np.zeros(3))
    start = NavState(samples[0].stamp_ns, truth.pose(start_s), truth.velocity(start_s), np.zeros(3), np.zeros(3))
    end = propagate(start, increment, gravity=IMU.gravity)
    true_pose = truth.pose(start_s + duration_s)
    np.testing.assert_allclose(end.T_map_body.t, true_pose.t, rtol=0, atol=1e-3 * duration_s)
    np.testing.assert_allclose(end.v_map, truth.velocity(start_s + duration_s), rtol=0, atol=1e-3)
    np.testing.assert_allclose(so3_log(end.T_map_body.R.T @ true_pose.R), 0.0, rtol=0, atol=2e-5)


def test_two_consecutive_increments_equal_the_long_one(readings) -> None:
    samples = readings(START_S, FRAME_S, 28)
    middle = samples[14].stamp_ns
    kwargs = {"gyro_bias": GYRO_BIAS, "accel_bias": ACCEL_BIAS, "imu": IMU}
    first = preintegrate(samples, samples[0].stamp_ns, middle, **kwargs)
    second = preintegrate(samples, middle, samples[-1].stamp_ns, **kwargs)
    both = integrate(samples)
    np.testing.assert_allclose(first.delta_R @ second.delta_R, both.delta_R, rtol=0, atol=1e-13)
    np.testing.assert_allclose(first.delta_v + first.delta_R @ second.delta_v, both.delta_v, rtol=0, atol=1e-13)
    joined = first.delta_p + first.delta_v * second.dt_s + first.delta_R @ second.delta_p
    np.testing.assert_allclose(joined, both.delta_p, rtol=0, atol=1e-13)


def test_readings_are_interpolated_at_both_ends() -> None:
    samples = [
        ImuSample(t, np.array([0.0, 0.0, rate]), np.array([accel, 0.0, 0.0]))
        for t, rate, accel in [(0, 0.1, 0.0), (10_000_000, 0.2, 1.0), (20_000_000, 0.4, 3.0)]
    ]
    zero = np.zeros(3)
    half = preintegrate(samples, 5_000_000, 15_000_000, gyro_bias=zero, accel_bias=zero, imu=IMU)
    # trapezoids of (0.15, 0.2) and (0.2, 0.3) rad/s, of (0.5, 1) and (1, 2) m/s^2, 5 ms each
    assert so3_log(half.delta_R)[2] == pytest.approx(5e-3 * (0.175 + 0.25), rel=1e-12)
    # a rotation of 1 mrad within the interval shortens x by its square
    assert half.delta_v[0] == pytest.approx(5e-3 * (0.75 + 1.5), rel=1e-5)


def test_the_nearest_reading_is_held_at_the_ends_of_a_recording() -> None:
    one = [ImuSample(50_000_000, np.array([0.0, 0.0, 0.3]), np.array([0.0, 0.0, 9.8]))]
    increment = preintegrate(one, 0, 100_000_000, gyro_bias=np.zeros(3), accel_bias=np.zeros(3), imu=IMU)
    assert increment.samples == 1
    np.testing.assert_allclose(so3_log(increment.delta_R), [0.0, 0.0, 0.03], rtol=0, atol=1e-15)
    np.testing.assert_allclose(increment.delta_v, [0.0, 0.0, 0.98], rtol=0, atol=1e-13)


def test_static_imu_keeps_its_pose() -> None:
    R = so3_exp([0.2, -0.1, 2.0])
    force = R.T @ np.array([0.0, 0.0, IMU.gravity])
    samples = [ImuSample(t, GYRO_BIAS, force + ACCEL_BIAS) for t in range(0, 1_000_000_001, 5_000_000)]
    start = NavState(0, Pose(R, np.array([1.0, 2.0, 3.0])), np.zeros(3), GYRO_BIAS, ACCEL_BIAS)
    end = propagate(start, integrate(samples), gravity=IMU.gravity)
    np.testing.assert_allclose(end.T_map_body.matrix, start.T_map_body.matrix, rtol=0, atol=1e-12)
    np.testing.assert_allclose(end.v_map, 0.0, rtol=0, atol=1e-12)


def test_a_gap_gives_a_hover_with_a_large_covariance() -> None:
    increment = preintegrate([], 0, 200_000_000, gyro_bias=GYRO_BIAS, accel_bias=ACCEL_BIAS, imu=IMU)
    assert increment.samples == 0
    level = NavState(0, Pose.identity(), np.array([20.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    end = propagate(level, increment, gravity=IMU.gravity)
    np.testing.assert_allclose(end.T_map_body.t, [4.0, 0.0, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(end.v_map, level.v_map, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(end.T_map_body.R, np.eye(3))
    sigma = np.sqrt(np.diag(increment.covariance))
    assert (sigma[3:6] >= 0.5).all()  # half a metre a second after 0.2 s: the vehicle may have started a turn
    assert (sigma[:3] >= 0.05).all()
    np.testing.assert_array_equal(increment.bias_jacobian, 0.0)
    for rate in (increment.rate_start, increment.rate_end):
        np.testing.assert_array_equal(rate, GYRO_BIAS)  # its reading without rotation
    for slope in (increment.rate_slope_start, increment.rate_slope_end):
        np.testing.assert_array_equal(slope, 0.0)


@pytest.mark.parametrize("end_ns", [140_000_000, 137_000_000])
@pytest.mark.parametrize("step_ns", [5_000_000, 40_000_000])
def test_rates_that_change_steadily_are_found_at_the_ends(step_ns: int, end_ns: int) -> None:
    """Also between two readings, and with few of them; the bias is included, for any linearisation point."""
    rate, slope = np.array([0.1, -0.3, 0.2]), np.array([1.0, 3.0, -2.0])
    samples = [ImuSample(t_ns, rate + slope * 1e-9 * t_ns, np.zeros(3)) for t_ns in range(0, 200_000_000, step_ns)]
    found = preintegrate(samples, 0, end_ns, gyro_bias=GYRO_BIAS, accel_bias=ACCEL_BIAS, imu=IMU)
    np.testing.assert_allclose(found.rate_start, rate, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.rate_end, rate + slope * 1e-9 * end_ns, rtol=0, atol=1e-12)
    for found_slope in (found.rate_slope_start, found.rate_slope_end):
        np.testing.assert_allclose(found_slope, slope, rtol=0, atol=1e-10)


def test_the_rates_at_the_ends_are_those_of_the_nearest_readings_together() -> None:
    """A vibration of 10 rad/s^2 and more, as a single reading or two would show, is none of the vehicle's rotation."""
    samples = [ImuSample(k * 5_000_000, np.full(3, 0.1 * (-1) ** k), np.zeros(3)) for k in range(29)]
    found = preintegrate(samples, 0, samples[-1].stamp_ns, gyro_bias=GYRO_BIAS, accel_bias=ACCEL_BIAS, imu=IMU)
    for rate, slope in ((found.rate_start, found.rate_slope_start), (found.rate_end, found.rate_slope_end)):
        assert np.abs(rate).max() < 0.03
        assert np.abs(slope).max() < 1e-6


@pytest.mark.parametrize("stamp_ns", [0, 1_000])
def test_an_empty_interval_is_rejected(stamp_ns: int) -> None:
    with pytest.raises(ValueError, match="stamps must increase"):
        preintegrate([], 1_000, stamp_ns, gyro_bias=np.zeros(3), accel_bias=np.zeros(3), imu=IMU)


def test_readings_and_biases_are_not_modified(readings) -> None:
    samples = readings(START_S, FRAME_S, 28)
    copies = [(s.gyro.copy(), s.accel.copy()) for s in samples]
    bias = GYRO_BIAS.copy()
    increment = integrate(samples, bias)
    increment.gyro_bias[:] = 99.0
    np.testing.assert_array_equal(bias, GYRO_BIAS)
    for sample, (gyro, accel) in zip(samples, copies, strict=True):
        np.testing.assert_array_equal(sample.gyro, gyro)
        np.testing.assert_array_equal(sample.accel, accel)


def test_the_parts_of_a_gap_are_as_uncertain_together_as_the_whole() -> None:
    """An unknown rate or acceleration lasts for the whole gap; as independent parts it would be averaged away."""
    stamps_ns = [*range(0, NS_PER_S, 5_000_000), *range(int(1.9e9), int(3e9), 5_000_000)]
    samples = [ImuSample(stamp_ns, np.zeros(3), np.array([0.0, 0.0, IMU.gravity])) for stamp_ns in stamps_ns]
    integrate = partial(preintegrate, samples, gyro_bias=np.zeros(3), accel_bias=np.zeros(3), imu=IMU)
    whole = integrate(int(0.995e9), int(1.9e9))
    ends_ns = np.linspace(0.995e9, 1.9e9, 8).astype(int).tolist()
    parts = functools.reduce(compose, (integrate(a, b) for a, b in itertools.pairwise(ends_ns)))
    assert np.sqrt(whole.covariance[2, 2]) == pytest.approx(0.5 * 0.905, rel=0.01)
    rows = [0, 1, 2, 5]  # rotation and vertical velocity; tilt adds gravity to the others
    np.testing.assert_allclose(parts.covariance.diagonal()[rows], whole.covariance.diagonal()[rows], rtol=0.02)
