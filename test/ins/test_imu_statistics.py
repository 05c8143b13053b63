# SPDX-License-Identifier: Apache-2.0
"""Readings that can't be those of an IMU are named."""

import numpy as np
import pytest

from uav_vslam.config import ImuConfig
from uav_vslam.ins.imu_statistics import MANY, ImuStatistics
from uav_vslam.types import ImuSample


def fault_of(gyro: float, accel_noise: float, *, turned_at: int = -1) -> str:
    rng, statistics = np.random.default_rng(0), ImuStatistics(ImuConfig())
    for k in range(2 * MANY):
        rate = np.full(3, 0.1 if k == turned_at else gyro)
        statistics.add(ImuSample(5_000_000 * k, rate, [0.0, 0.0, 9.81] + accel_noise * rng.standard_normal(3)))
    return statistics.fault


def test_a_gyroscope_that_reads_only_zero_is_named() -> None:
    assert "the gyroscope reads zero" in fault_of(0.0, 0.01)


@pytest.mark.parametrize(
    ("gyro", "accel_noise", "turned_at"), [(1e-6, 0.01, -1), (0.0, 0.0, -1), (0.0, 0.01, 0), (0.0, 0.01, MANY)]
)
def test_one_that_has_turned_or_rests_without_noise_is_not(gyro: float, accel_noise: float, turned_at: int) -> None:
    assert fault_of(gyro, accel_noise, turned_at=turned_at) == ""
