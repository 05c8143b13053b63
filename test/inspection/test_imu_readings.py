# SPDX-License-Identifier: Apache-2.0
"""Units, gravity's direction and saturation, from arrays alone."""

import numpy as np
import pytest

from uav_vslam.inspection.finding import Severity
from uav_vslam.inspection.imu_readings import check_gravity_direction, check_stuck, check_units, clipped_count

UP = np.array([0.0, 0.0, 1.0])


def forces(count: int = 2000, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal([0.0, 0.0, 9.81], 0.3, (count, 3))


@pytest.mark.parametrize(
    ("factor", "said"),
    [(1 / 9.80665, "in g,"), (1000 / 9.80665, "in mg,"), (1 / 0.3048, "in ft/s^2"), (0.5, "a factor of 2")],
)
def test_a_wrong_unit_is_named(factor: float, said: str) -> None:
    (finding,) = check_units(factor * forces(), gravity=9.80665, rate_hz=200.0)
    assert finding.severity is Severity.ERROR
    assert said in finding.seen + finding.remedy


def test_removed_gravity_is_named_and_vibration_is_not_mistaken_for_size() -> None:
    (removed,) = check_units(forces() - [0.0, 0.0, 9.81], gravity=9.80665, rate_hz=200.0)
    assert "gravity was removed" in removed.seen
    flown = forces() - [0.0, 0.0, 9.81] + np.sin(np.arange(2000) / 100.0)[:, None] * [1.0, 0.5, 0.3]  # 0.1 of gravity
    (removed,) = check_units(flown, gravity=9.80665, rate_hz=200.0)
    assert "gravity was removed" in removed.seen
    shaken = forces() + 30.0 * np.sin(np.arange(2000) * 1.1)[:, None] * UP
    (finding,) = check_units(shaken, gravity=9.80665, rate_hz=200.0)
    assert finding.severity is Severity.OK


@pytest.mark.parametrize("direction", [[0, 0, -9.8], [9.8, 0, 0], [0, -9.8, 0]])
def test_a_wrong_axis_is_an_error_against_a_reference_and_a_warning_without(direction: list[float]) -> None:
    force = np.array(direction, float)
    (known,) = check_gravity_direction(force, UP, known_from="the start state", tilt_deg=30.0)
    (unknown,) = check_gravity_direction(force, None, known_from="the z axis", tilt_deg=30.0)
    assert known.severity is Severity.ERROR
    assert unknown.severity is Severity.WARNING
    (fits,) = check_gravity_direction(force, force / 9.8, known_from="the start state", tilt_deg=30.0)
    assert fits.severity is Severity.OK


def test_readings_at_the_end_of_a_range_are_counted() -> None:
    values = np.random.default_rng(1).normal(0.0, 1.0, 5000)
    assert clipped_count(values) == 0
    assert clipped_count(np.minimum(values, 2.0)) == (values >= 2.0).sum()


def test_a_coarse_resolution_is_no_saturation() -> None:
    for step in (0.5, 0.1, 0.01):  # in standard deviations: 12 to 700 levels
        values = np.round(np.random.default_rng(2).normal(0.0, 1.0, 5000) / step) * step
        assert clipped_count(values) == 0


def test_a_vibration_that_lingers_at_its_extremes_is_no_saturation() -> None:
    phase = np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, 20000)
    values = np.round(100.0 * np.sin(phase))
    assert (values == values.max()).sum() > 100
    assert clipped_count(values) == 0
    assert clipped_count(np.minimum(values, 90.0)) == (values >= 90.0).sum()


def test_stuck_axes_and_missing_sensors_are_named() -> None:
    readings = forces()
    assert check_stuck(readings, "accelerometer") == []
    readings[:, 1] = 0.25
    (finding,) = check_stuck(readings, "accelerometer")
    assert "constant on y" in finding.seen
    (finding,) = check_stuck(np.zeros((100, 3)), "gyroscope")
    assert "all readings are zero" in finding.seen
