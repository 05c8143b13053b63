# SPDX-License-Identifier: Apache-2.0
"""Unit and axes of a gyroscope are recovered from a reference rotation, for every mounting by right angles."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.inspection.finding import Severity
from uav_vslam.inspection.rotation import CAMERAS, RatePairs, check_rotation, mean_rates, rates_of_rotations

TURNS = [
    R
    for order in itertools.permutations(range(3))
    for sign in itertools.product((1.0, -1.0), repeat=3)
    if np.linalg.det(R := np.diag(sign) @ np.eye(3)[list(order)]) > 0
]


def pairs(R_imu_body: np.ndarray, scale: float, seed: int = 1) -> RatePairs:
    rng = np.random.default_rng(seed)
    true = rng.normal(0.0, [0.3, 0.2, 0.4], (12, 3))
    gyro = scale * (true @ R_imu_body.T) + rng.normal(0.0, scale * 0.02, (12, 3)) + scale * 0.01
    return RatePairs(true, 0.01, "the truth", lambda _: gyro)


@pytest.mark.parametrize("scale", [1.0, 180.0 / math.pi])
@pytest.mark.parametrize("number", range(24))
def test_each_mounting_and_unit_is_named(number: int, scale: float) -> None:
    (finding,) = check_rotation(pairs(TURNS[number], scale))
    right = np.array_equal(TURNS[number], np.eye(3))
    assert (finding.severity is Severity.OK) == (right and scale == 1.0)
    assert ("in degrees" in finding.seen) == (scale != 1.0)
    shown = [f"{'+' if row.sum() > 0 else '-'}{'xyz'[int(np.argmax(abs(row)))]}" for row in TURNS[number]]
    assert (f"({', '.join(shown)})" in finding.seen) == (not right)


def test_a_rotation_that_nothing_explains_is_a_warning() -> None:
    right, rng = pairs(np.eye(3), 1.0), np.random.default_rng(4)
    other = rng.permutation(right.gyro_if_late(0))
    (finding,) = check_rotation(RatePairs(right.reference, 0.01, "the truth", lambda _: other))
    assert finding.severity is Severity.WARNING


@pytest.mark.parametrize(
    ("late_ms", "faster", "seen", "severity"),
    [
        (45, 1.0, "45 ms late", Severity.ERROR),
        (-120, 1.0, "120 ms early", Severity.ERROR),
        (-25, 2.0, "25 ms early", Severity.WARNING),  # which the filter estimates
    ],
)
def test_an_offset_of_the_clocks_is_found(late_ms: int, faster: float, seen: str, severity: Severity) -> None:
    stamps = np.arange(0, 10_000_000_000, 5_000_000)
    rate = 0.4 * np.sin(faster * stamps[:, None] / 1e9 * np.array([8.0, 9.0, 11.0]))
    starts = np.arange(500_000_000, 9_000_000_000, 200_000_000)

    def if_late(late_ns: int) -> np.ndarray:
        return mean_rates(stamps + late_ms * 1_000_000 - late_ns, rate, starts, starts + 200_000_000)

    true = mean_rates(stamps, rate, starts, starts + 200_000_000)
    (finding,) = check_rotation(RatePairs(true, 0.01, CAMERAS, if_late))
    assert (finding.severity, seen in finding.seen) == (severity, True)
    assert f"timeshift_cam_imu: {late_ms / 1000:g} " in finding.remedy


def slow(late_ms: int, *, from_s: float = 0.5, noise: float = 0.002) -> RatePairs:
    """Motion of 0.3 to 1.5 Hz, of which the IMU's stamps are late, and whose readings begin at 0 s."""
    stamps = np.arange(0, 20_000_000_000, 5_000_000)
    rate = 0.3 * np.sin(2.0 * np.pi * stamps[:, None] / 1e9 * np.array([0.3, 0.7, 1.5]))
    starts = np.arange(round(from_s * 1e9), 19_000_000_000, 200_000_000)

    def if_late(late_ns: int) -> np.ndarray:
        return mean_rates(stamps + late_ms * 1_000_000 - late_ns, rate, starts, starts + 200_000_000)

    true = mean_rates(stamps, rate, starts, starts + 200_000_000)
    true += np.random.default_rng(2).normal(0.0, noise, true.shape)
    return RatePairs(true, noise, CAMERAS, if_late)


@pytest.mark.parametrize("late_ms", [30, -30])
def test_an_offset_that_slow_motion_hides_is_warned_about(late_ms: int) -> None:
    (finding,) = check_rotation(slow(late_ms))
    assert finding.severity is Severity.WARNING
    assert f"30 ms {'late' if late_ms > 0 else 'early'}" in finding.seen
    assert finding.allowed == "less than 10 ms"


@pytest.mark.parametrize(("late_ms", "noise"), [(0, 0.002), (5, 0.002), (0, 0.05)])
def test_a_small_offset_and_noise_are_no_fault(late_ms: int, noise: float) -> None:
    (finding,) = check_rotation(slow(late_ms, noise=noise))
    assert finding.severity is Severity.OK


def test_the_offset_to_set_counts_the_one_that_is_set() -> None:
    (finding,) = check_rotation(dataclasses.replace(slow(30), offset_ns=-12_000_000))
    assert "timeshift_cam_imu: 0.018 (to about 5 ms)" in finding.remedy


def test_an_offset_that_leaves_few_intervals_is_no_match() -> None:
    """Of noise, some offset fits the four intervals that are left."""
    rng = np.random.default_rng(4)
    gyro, reference = rng.normal(0.0, 0.3, (2, 20, 3))

    def if_late(late_ns: int) -> np.ndarray:
        few = np.where(np.arange(20)[:, None] < 4, reference, np.nan)
        return few if late_ns == 200_000_000 else gyro

    (finding,) = check_rotation(RatePairs(reference, 0.01, CAMERAS, if_late))
    assert "no other unit or axes explain it" in finding.seen


def test_an_offset_for_which_the_reference_stands_still_is_no_match() -> None:
    right = pairs(np.eye(3), 1.0)
    gyro = right.gyro_if_late(0)
    reference = np.vstack([right.reference[:5], np.zeros((7, 3))])

    def if_late(late_ns: int) -> np.ndarray:
        return np.where(np.arange(12)[:, None] < 5, np.nan, gyro) if late_ns < 0 else gyro

    with np.errstate(all="raise"):
        (finding,) = check_rotation(RatePairs(reference, 0.01, CAMERAS, if_late))
    assert "no other unit or axes explain it" in finding.seen


def test_a_vehicle_that_hardly_turns_is_not_judged() -> None:
    still = np.random.default_rng(1).normal(0.0, 0.001, (10, 3))
    (finding,) = check_rotation(RatePairs(still, 0.01, "the truth", lambda _: np.full((10, 3), 0.5)))
    assert "not judged" in finding.seen


def test_mean_rates_are_those_of_the_rotation_between_and_unknown_across_a_gap() -> None:
    rate = np.array([0.4, -0.2, 0.3])
    stamps = np.arange(0, 2_000_000_000, 5_000_000)
    gyro = np.tile(rate, (len(stamps), 1))
    starts, ends = np.array([100_000_000, 900_000_000]), np.array([300_000_000, 1_100_000_000])
    np.testing.assert_allclose(mean_rates(stamps, gyro, starts, ends), [rate, rate])
    seconds = (ends - starts) / 1e9
    R = so3_exp(rate * seconds[:, None])
    np.testing.assert_allclose(rates_of_rotations(np.tile(np.eye(3), (2, 1, 1)), R, seconds), [rate, rate])
    kept = (stamps < 950_000_000) | (stamps > 1_050_000_000)
    holed = mean_rates(stamps[kept], gyro[kept], starts, ends)
    np.testing.assert_allclose(holed[0], rate)
    assert np.isnan(holed[1]).all()
    assert np.isnan(mean_rates(stamps, gyro, starts - 200_000_000, ends)[0]).all()
