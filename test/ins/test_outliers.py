# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.ins.outliers import OutlierFilter
from uav_vslam.types import ImuSample

PERIOD_NS = 5_000_000


def stream(count: int = 200, gyro_sigma: float = 0.005, accel_sigma: float = 0.05) -> list[ImuSample]:
    rng = np.random.default_rng(0)
    gravity = np.array([0.0, 0.0, 9.81])
    return [
        ImuSample(k * PERIOD_NS, rng.normal(0, gyro_sigma, 3), gravity + rng.normal(0, accel_sigma, 3))
        for k in range(count)
    ]


def disturbed(samples: list[ImuSample], rows: list[int], gyro: float = 0.0, accel: float = 0.0) -> list[ImuSample]:
    return [
        ImuSample(one.stamp_ns, one.gyro + gyro, one.accel + accel) if k in rows else one
        for k, one in enumerate(samples)
    ]


def judged(samples: list[ImuSample]) -> tuple[list[ImuSample], list[ImuSample]]:
    """Return the readings used and those left out."""
    outliers, used, left_out = OutlierFilter(), [], []
    for one in samples:
        found = outliers.add(one)
        used += found.readings
        left_out += [found.outlier] if found.outlier is not None else []
    return [*used, *outliers.rest()], left_out


@pytest.mark.parametrize(("gyro", "accel"), [(1.0, 0.0), (0.0, 20.0), (-30.0, 4.0)])
def test_single_readings_far_from_both_neighbours_are_left_out(gyro: float, accel: float) -> None:
    samples = stream()
    used, left_out = judged(disturbed(samples, [50, 120, 150], gyro, accel))
    assert [one.stamp_ns // PERIOD_NS for one in left_out] == [50, 120, 150]
    assert used == [one for k, one in enumerate(samples) if k not in (50, 120, 150)]


@pytest.mark.parametrize(("gyro_sigma", "accel_sigma"), [(0.0, 0.0), (0.005, 0.05), (0.3, 10.0)])
def test_noise_and_vibration_of_any_size_are_used_unchanged(gyro_sigma: float, accel_sigma: float) -> None:
    samples = stream(20_000, gyro_sigma, accel_sigma)
    used, left_out = judged(samples)
    assert used == samples
    assert not left_out


@pytest.mark.parametrize("per_reading", [0.5, 0.49, 0.4, 0.335, 0.3])
def test_vibration_that_begins_at_once_is_used(per_reading: float) -> None:
    """A motor is switched on; per_reading is the frequency as a multiple of the rate of the readings."""
    samples = stream(1000)
    for phase in np.linspace(0.1, 6.1, 7):
        waves = 6.0 * np.sin(2 * np.pi * per_reading * np.arange(800) + phase)
        shaken = [
            ImuSample(one.stamp_ns, one.gyro + wave / 6.0, one.accel + wave)
            for one, wave in zip(samples[200:], waves, strict=True)
        ]
        _, left_out = judged(samples[:200] + shaken)
        assert len(left_out) <= 1


def test_frequent_outliers_are_left_out_unless_they_are_close_together() -> None:
    rows = [*range(50, 500, 10), 600, 602]
    _, left_out = judged(disturbed(stream(1000), rows, gyro=5.0))
    assert [one.stamp_ns // PERIOD_NS for one in left_out] == rows[:-1]


def test_a_shock_of_two_readings_and_a_step_are_motion() -> None:
    shock = disturbed(stream(), [80, 81], gyro=2.0, accel=30.0)
    step = disturbed(stream(), list(range(80, 200)), gyro=2.0, accel=30.0)
    for samples in (shock, step):
        used, left_out = judged(samples)
        assert used == samples
        assert not left_out


def test_readings_across_a_gap_and_the_last_one_are_not_judged() -> None:
    before_gap = disturbed(stream(), [80], gyro=2.0)
    del before_gap[81:100]
    after_gap = disturbed(stream(), [100], gyro=2.0)
    del after_gap[81:100]
    at_the_end = disturbed(stream(), [199], gyro=2.0)
    for samples in (before_gap, after_gap, at_the_end):
        used, left_out = judged(samples)
        assert used == samples
        assert not left_out


def test_what_the_buffer_refuses_is_passed_on_and_changes_nothing() -> None:
    samples = stream()
    late = ImuSample(samples[90].stamp_ns, np.full(3, 9.0), np.zeros(3))
    broken = ImuSample(samples[95].stamp_ns, np.full(3, np.nan), np.zeros(3))
    used, left_out = judged([*samples[:94], late, *samples[94:96], broken, *samples[96:]])
    assert len(used) == len(samples) + 2
    assert not left_out
