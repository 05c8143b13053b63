# SPDX-License-Identifier: Apache-2.0
"""Stamps of the IMU: what is missing, and what is stamped in bursts."""

import numpy as np

from uav_vslam.inspection.timing import check_imu_rate

EVEN_NS = np.arange(2000, dtype=np.int64) * 5_000_000


def test_readings_that_are_stamped_in_bursts_are_not_called_missing() -> None:
    number = np.arange(2000, dtype=np.int64)
    (finding,) = check_imu_rate(number // 10 * 50_000_000 + number % 10 * 100_000)
    assert finding.subject == "IMU stamps"
    assert finding.seen == "10000 Hz within bursts, 200.9 Hz on average"


def test_readings_that_are_missing_are_counted() -> None:
    (finding,) = check_imu_rate(EVEN_NS[np.arange(2000) % 10 > 1])
    assert "398 of 1998 readings are missing" in finding.seen
