# SPDX-License-Identifier: Apache-2.0
"""Readings lost at random: the increments claim no more than they know, and complete data is left alone."""

import dataclasses
import functools
import itertools

import numpy as np
import pytest

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.ins import preintegration
from uav_vslam.ins.gaps import ENOUGH, UsualSpacing
from uav_vslam.ins.imu_buffer import ImuBuffer
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_fleet
from uav_vslam.types import NS_PER_S, ImuIncrement, ImuSample

MS = 1_000_000
KNOWN_RAD = 0.1  # 1 sigma of a rotation in a gap of BLIND_S, of which nothing is known
LOSSES = (0.5, 0.8, 0.95)


@functools.cache
def flown() -> SimulatedVehicle:
    (vehicle,) = simulate_fleet(dataclasses.replace(SCENARIOS["kagaru"], frames=140, vehicles=1, seed=1))
    return vehicle


def increments(loss: float) -> list[ImuIncrement]:
    """Return the motion between frames, linearised at the true bias, from what a random loss leaves of the readings."""
    vehicle, buffer, found = flown(), ImuBuffer(ImuConfig()), []
    kept = np.random.default_rng(5).random(len(vehicle.imu.stamps_ns)) >= loss
    readings = iter([sample for sample, keep in zip(vehicle.imu.samples(), kept, strict=True) if keep])
    stamps_ns = vehicle.frame_stamps_ns.tolist()
    for start_ns, stamp_ns in itertools.pairwise(stamps_ns):
        while not buffer.covers(stamp_ns) and (sample := next(readings, None)) is not None:
            buffer.append(sample)
        at = int(np.searchsorted(vehicle.imu.stamps_ns, start_ns))
        bias = {"gyro_bias": vehicle.imu.gyro_bias[at], "accel_bias": vehicle.imu.accel_bias[at]}
        samples = buffer.cut(start_ns, stamp_ns)
        imu = vehicle.scenario.imu_config
        found.append(preintegrate(samples, start_ns, stamp_ns, **bias, imu=imu, period_s=buffer.period_s))
    return found


def nees(increment: ImuIncrement) -> float:
    """Return the normalised squared error per axis of rotation, velocity and position together."""
    vehicle = flown()
    before, after = (vehicle.true_state(stamp_ns) for stamp_ns in (increment.start_ns, increment.stamp_ns))
    g, dt, R = np.array([0.0, 0.0, -vehicle.scenario.imu_config.gravity]), increment.dt_s, before.T_map_body.R.T
    error = np.concatenate([
        so3_log(increment.delta_R.T @ R @ after.T_map_body.R),
        R @ (after.v_map - before.v_map - g * dt) - increment.delta_v,
        R @ (after.T_map_body.t - before.T_map_body.t - before.v_map * dt - 0.5 * g * dt**2) - increment.delta_p,
    ])  # fmt: skip
    return float(error @ np.linalg.solve(increment.covariance, error) / 9.0)


@pytest.mark.parametrize("loss", LOSSES)
def test_increments_claim_no_more_than_the_readings_left_tell(loss: float) -> None:
    """In rotation, velocity and position jointly: a claim that ties them to each other is a false one too."""
    found = [nees(one) for one in increments(loss) if one.covariance[0, 0] < KNOWN_RAD**2]
    assert len(found) > 50
    assert np.mean(found) <= 1.1
    assert np.percentile(found, 99) <= 5.0


def test_the_claim_is_not_needlessly_large() -> None:
    rotation_deg = [np.degrees(np.sqrt(increment.covariance[0, 0])) for increment in increments(0.5)]
    assert np.median(rotation_deg) <= 0.1  # over 0.14 s; the whole rate is unknown by 0.5 rad/s, 4 degrees


def test_complete_readings_give_the_same_bits_whatever_the_usual_spacing(monkeypatch: pytest.MonkeyPatch) -> None:
    found = increments(0.0)
    monkeypatch.setattr(preintegration, "hidden_variance", lambda *_, **__: None)
    for one, other in zip(found, increments(0.0), strict=True):
        np.testing.assert_array_equal(one.covariance, other.covariance)
        np.testing.assert_array_equal(one.delta_p, other.delta_p)


def test_readings_that_come_twice_or_in_bursts_do_not_make_the_usual_spacing_tiny() -> None:
    regular = 5 * MS * np.arange(2000)
    twice = np.sort(np.concatenate([regular, regular[:: 2000 // 60] + 1000]))
    bursts = (20 * MS * np.arange(500)[:, None] + 60_000 * np.arange(4)).ravel()
    for stamps_ns, period_s in ((twice, 0.005), (bursts, 0.02), (twice[:40], 0.005), (bursts[:40], 0.02)):
        spacing = UsualSpacing()
        for stamp_ns in stamps_ns.tolist():
            spacing.add(stamp_ns)
        assert spacing.period_s == pytest.approx(period_s, rel=0.05)


@pytest.mark.parametrize("jitter_ms", [0.0, 0.5])
@pytest.mark.parametrize("loss", [0.0, *LOSSES])
def test_the_usual_spacing_is_found_whatever_is_lost(loss: float, jitter_ms: float) -> None:
    rng = np.random.default_rng(1)
    stamps_ns = (5 * MS * np.arange(6000) + rng.normal(0.0, jitter_ms * MS, 6000)).astype(np.int64)
    spacing = UsualSpacing()
    for stamp_ns in stamps_ns[rng.random(6000) >= loss].tolist():
        spacing.add(stamp_ns)
    assert spacing.period_s == pytest.approx(0.005, rel=0.05 if jitter_ms == 0.0 else 0.35)


def test_until_enough_is_seen_irregular_readings_are_taken_as_incomplete_and_regular_ones_never() -> None:
    regular, irregular = UsualSpacing(), UsualSpacing()
    for k in range(ENOUGH // 2):
        regular.add(40 * MS * k)
        irregular.add(40 * MS * k + 15 * MS * (k % 3 == 0))
    assert regular.period_s == 0.04
    assert irregular.period_s == 0.01


def test_a_gap_is_as_uncertain_whenever_its_increment_is_made() -> None:
    """Later readings, which may have arrived already, change nothing."""
    vehicle = flown()
    kept = np.random.default_rng(1).random(len(vehicle.imu.stamps_ns)) < 0.3
    samples: list[ImuSample] = [sample for sample, keep in zip(vehicle.imu.samples(), kept, strict=True) if keep]
    early, late = ImuBuffer(ImuConfig()), ImuBuffer(ImuConfig())
    for sample in samples:
        late.append(sample)
    arriving = iter(samples)
    start_ns = int(vehicle.frame_stamps_ns[0])
    for stamp_ns in range(start_ns + NS_PER_S, start_ns + 5 * NS_PER_S, NS_PER_S):
        while not early.covers(stamp_ns):
            early.append(next(arriving))
        assert early.cut(start_ns, stamp_ns) == late.cut(start_ns, stamp_ns)
        assert early.period_s == late.period_s


@pytest.mark.parametrize("loss", LOSSES)
def test_readings_lost_at_random_are_no_bursts(loss: float) -> None:
    spacing, stamps_ns = UsualSpacing(), flown().imu.stamps_ns
    for stamp_ns in stamps_ns[np.random.default_rng(7).random(len(stamps_ns)) >= loss].tolist():
        spacing.add(stamp_ns)
        assert spacing.bursts_hz is None
        assert spacing.slow_hz is None


@pytest.mark.parametrize(("rate_hz", "slow_hz"), [(10.0, pytest.approx(10.0)), (50.0, None), (200.0, None)])
def test_readings_that_come_too_seldom_are_told_by_their_rate(rate_hz: float, slow_hz: float | None) -> None:
    spacing = UsualSpacing()
    for k in range(150):
        spacing.add(round(k * NS_PER_S / rate_hz))
    assert spacing.slow_hz == slow_hz


@pytest.mark.parametrize("within_ns", [0, 50_000, 500_000])
def test_bursts_are_told_by_their_rates(within_ns: int) -> None:
    """Of 20 readings; where they have one stamp, only the first is used, and the rest is even."""
    spacing = UsualSpacing()
    for k in range(4000):
        stamp_ns = k // 20 * 100 * MS + k % 20 * within_ns
        if within_ns or k % 20 == 0:
            spacing.add(stamp_ns)
    expected = None if within_ns == 0 else pytest.approx((NS_PER_S / within_ns, 200.0), rel=0.05)
    assert spacing.bursts_hz == expected
