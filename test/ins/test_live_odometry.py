# SPDX-License-Identifier: Apache-2.0
"""Between corrections the newest one is propagated by the readings since; the odometry frame has no jumps."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import ImuConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp, so3_log
from uav_vslam.ins.imu_statistics import ImuStatistics
from uav_vslam.ins.live_odometry import MAX_AHEAD_S, LiveOdometry
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.ins.preintegrator import advance
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, NavState

IMU = ImuConfig()
MS = 1_000_000
START = NavEstimate(NavState(NS_PER_S, Pose.identity(), np.ones(3), np.zeros(3), np.zeros(3)), 1e-4 * np.eye(15))


class FedOdometry(LiveOdometry):
    """Adds its readings to their statistics, as a preintegrator does."""

    def __init__(self, initial: NavEstimate, *, period_s: float = 0.0) -> None:
        self._fed = ImuStatistics(IMU)
        super().__init__(initial, IMU, self._fed, period_s=period_s)

    def add_imu(self, sample: ImuSample) -> bool:
        self._fed.add(sample)
        return super().add_imu(sample)


def hovering(stamp_ns: int) -> ImuSample:
    return ImuSample(stamp_ns, np.zeros(3), np.array([0.0, 0.0, IMU.gravity]))


def estimate_at(flight, sample: ImuSample, variance: float = 1e-4) -> NavEstimate:
    state = flight.true_state(sample.stamp_ns)
    return NavEstimate(dataclasses.replace(state, gyro_bias=np.zeros(3), accel_bias=np.zeros(3)), variance * np.eye(15))


def assert_same(a: NavEstimate, b: NavEstimate) -> None:
    """Equal but for the integration over other parts of the same readings."""
    np.testing.assert_allclose(a.state.T_map_body.matrix, b.state.T_map_body.matrix, rtol=0, atol=1e-6)
    np.testing.assert_allclose(a.state.v_map, b.state.v_map, rtol=0, atol=1e-6)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=0, atol=1e-3 * a.covariance.max())


@pytest.mark.parametrize(("period_s", "outputs"), [(0.0, 800), (0.005, 800), (0.02, 200), (0.007, 800), (0.008, 400)])
def test_output_follows_the_true_flight_at_the_rate_asked_for(flight, readings, period_s: float, outputs: int) -> None:
    samples = readings(0.5, 4.0, 800)
    odometry = FedOdometry(estimate_at(flight, samples[0]), period_s=period_s)
    made = [sample.stamp_ns for sample in samples if odometry.add_imu(sample)]
    truth = flight.true_state(samples[-1].stamp_ns)
    for T_body in (odometry.estimate.state.T_map_body, odometry.T_odom_body):
        assert np.linalg.norm(T_body.t - truth.T_map_body.t) < 5e-3
        assert np.linalg.norm(so3_log(T_body.R.T @ truth.T_map_body.R)) < 1e-4
    assert len(made) == outputs
    assert odometry.estimate.state.stamp_ns == made[-1] == samples[-1].stamp_ns


@pytest.mark.parametrize("corrected", [120, 121, 123])
def test_a_correction_counts_as_if_it_had_been_the_start(flight, readings, corrected: int) -> None:
    """At an output, and between two outputs; the covariance is propagated to the newest output as well."""
    samples = readings(0.5, 1.0, 200)
    middle = estimate_at(flight, samples[corrected], 1e-2)
    late = FedOdometry(estimate_at(flight, samples[0]), period_s=0.02)
    for sample in samples:
        late.add_imu(sample)
    late.correct(middle)
    start_ns, end_ns = middle.state.stamp_ns, samples[-1].stamp_ns
    whole = preintegrate(samples, start_ns, end_ns, gyro_bias=np.zeros(3), accel_bias=np.zeros(3), imu=IMU)
    assert_same(late.estimate, advance(middle, whole, IMU))
    assert late.estimate.covariance[0, 0] > middle.covariance[0, 0]


def test_a_correction_moves_the_map_and_not_the_odometry(flight, readings) -> None:
    samples = readings(0.5, 1.0, 200)
    odometry = FedOdometry(estimate_at(flight, samples[0]), period_s=0.02)
    for sample in samples[:101]:
        odometry.add_imu(sample)
    before, jump = odometry.T_odom_body, Pose(so3_exp(np.array([0.0, 0.0, 0.1])), np.array([5.0, -2.0, 1.0]))
    true = estimate_at(flight, samples[100])
    T_map_body = jump @ true.state.T_map_body
    state = dataclasses.replace(true.state, T_map_body=T_map_body, v_map=jump.R @ true.state.v_map)
    odometry.correct(NavEstimate(state, true.covariance))
    np.testing.assert_array_equal(odometry.T_odom_body.matrix, before.matrix)
    np.testing.assert_allclose(odometry.T_map_odom.matrix, jump.matrix, rtol=0, atol=1e-3)
    for sample in samples[101:]:
        odometry.add_imu(sample)
    np.testing.assert_allclose(odometry.T_map_odom.matrix, jump.matrix, rtol=0, atol=1e-3)
    T_map_body = odometry.estimate.state.T_map_body
    np.testing.assert_allclose((odometry.T_map_odom @ odometry.T_odom_body).matrix, T_map_body.matrix, atol=1e-12)


def test_a_correction_slightly_ahead_of_the_readings_waits_for_them() -> None:
    odometry = FedOdometry(START, period_s=0.02)
    for k in range(3):
        odometry.add_imu(hovering(NS_PER_S + 5 * k * MS))
    moved = dataclasses.replace(START.state, stamp_ns=NS_PER_S + 15 * MS, T_map_body=Pose(np.eye(3), np.full(3, 9.0)))
    odometry.correct(NavEstimate(moved, START.covariance))
    assert odometry.estimate.state.T_map_body.t[0] < 1.0
    for k in range(3, 5):
        odometry.add_imu(hovering(NS_PER_S + 5 * k * MS))
    np.testing.assert_allclose(odometry.estimate.state.T_map_body.t, 9.005, atol=1e-9)


def test_a_correction_from_the_future_is_refused_and_changes_nothing() -> None:
    odometry = FedOdometry(START)
    odometry.add_imu(hovering(NS_PER_S + 5 * MS))
    before = odometry.estimate
    stamp_ns = before.state.stamp_ns + round(MAX_AHEAD_S * NS_PER_S) + 1
    with pytest.raises(InvalidMessage, match="clocks"):
        odometry.correct(NavEstimate(dataclasses.replace(START.state, stamp_ns=stamp_ns), START.covariance))
    assert odometry.estimate is before
    assert odometry.add_imu(hovering(NS_PER_S + 10 * MS))


def test_a_gap_in_the_readings_makes_the_position_uncertain() -> None:
    with_gap, without = FedOdometry(START), FedOdometry(START)
    for k in range(1, 400):
        without.add_imu(hovering(NS_PER_S + 5 * k * MS))
        if not 100 < k < 300:
            with_gap.add_imu(hovering(NS_PER_S + 5 * k * MS))
    sigma_m = np.sqrt(with_gap.estimate.covariance[0, 0])
    assert sigma_m > 2.0  # a second with 5 m/s^2 of unknown acceleration, and half a second after it
    assert sigma_m > 10 * np.sqrt(without.estimate.covariance[0, 0])


def test_readings_before_the_start_change_nothing() -> None:
    odometry = FedOdometry(START)
    assert not odometry.add_imu(hovering(NS_PER_S - 1))
    assert not odometry.add_imu(hovering(NS_PER_S))
    assert odometry.estimate is START
    np.testing.assert_array_equal(odometry.T_map_odom.matrix, np.eye(4))
