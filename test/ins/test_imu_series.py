# SPDX-License-Identifier: Apache-2.0
"""Readings in arrays are the readings that were added, and small."""

import tracemalloc

import numpy as np

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.imu_series import ImuSeries
from uav_vslam.ins.mounting import ImuMounting
from uav_vslam.types import ImuSample


def readings(count: int) -> list[ImuSample]:
    rng = np.random.default_rng(1)
    return [ImuSample(5_000_000 * k, rng.normal(size=3), rng.normal(size=3)) for k in range(count)]


def test_a_series_holds_what_was_added() -> None:
    mounting = ImuMounting(Pose(so3_exp([0.1, 0.2, 0.3]), np.array([1.0, 0.0, 0.5])))
    added = [*readings(3), *map(mounting.to_body, readings(3))]
    series = ImuSeries(added)
    assert len(series) == 6
    for name, given in (("stamps_ns", "stamp_ns"), *((one, one) for one in ("gyro", "accel", "accel_at_imu"))):
        np.testing.assert_array_equal(getattr(series, name), [getattr(one, given) for one in added])
        np.testing.assert_array_equal(getattr(series, name), [getattr(one, given) for one in series])


def test_an_empty_series_has_empty_arrays() -> None:
    series = ImuSeries()
    assert not series
    assert series.stamps_ns.shape == (0,)
    assert series.gyro.shape == series.accel.shape == series.accel_at_imu.shape == (0, 3)
    assert list(series) == []


def test_half_an_hour_at_200_hz_takes_less_than_40_mb() -> None:
    one = readings(1)[0]
    tracemalloc.start()
    try:
        series = ImuSeries(one for _ in range(360_000))
        assert len(series) == 360_000
        assert tracemalloc.get_traced_memory()[1] < 40e6  # records: 250 MB
    finally:
        tracemalloc.stop()
