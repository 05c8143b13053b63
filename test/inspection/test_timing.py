# SPDX-License-Identifier: Apache-2.0
"""Stamps of the IMU: what is missing, and what is stamped in bursts."""

import numpy as np
import pytest

from uav_vslam.inspection.timing import check_image_rate, check_imu_rate, check_order

EVEN_NS = np.arange(2000, dtype=np.int64) * 5_000_000


def test_readings_that_are_stamped_in_bursts_are_not_called_missing() -> None:
    number = np.arange(2000, dtype=np.int64)
    (finding,) = check_imu_rate(number // 10 * 50_000_000 + number % 10 * 100_000)
    assert finding.subject == "IMU stamps"
    assert finding.seen == "10000 Hz within bursts, 200.9 Hz on average outside gaps"


def test_bursts_that_are_far_apart_are_no_gaps_in_the_recording() -> None:
    """To record again would not help."""
    number = np.arange(2000, dtype=np.int64)
    (finding,) = check_imu_rate(number // 20 * 100_000_000 + number % 20 * 50_000)
    assert (finding.subject, finding.severity.value) == ("IMU stamps", "error")
    assert "let the driver stamp the time of each reading" in finding.remedy


def test_rates_that_no_sensor_has_are_stamps_in_another_unit() -> None:
    images_ns = np.arange(100, dtype=np.int64) * 100_000_000 // 1000
    (imu,) = check_imu_rate(EVEN_NS // 1000)
    (images,) = check_image_rate("left images", images_ns, tracked_gap_s=None)
    for finding, seen in ((imu, "200000 Hz"), (images, "10000 Hz")):
        assert (finding.severity.value, finding.seen) == ("error", f"{seen} on average")
        assert "microseconds" in finding.remedy


def test_a_pause_longer_than_the_flight_is_a_gap_and_no_bursts() -> None:
    minute = np.arange(12_000, dtype=np.int64) * 5_000_000
    (finding,) = check_imu_rate(np.concatenate([minute, minute + 500_000_000_000]))
    assert (finding.subject, finding.severity.value) == ("IMU gaps", "warning")
    assert finding.seen == "1 gap: 440 s at 59.99 s"


def test_bursts_are_no_error_because_of_one_long_pause() -> None:
    number = np.arange(2000, dtype=np.int64)
    bursts = number // 10 * 50_000_000 + number % 10 * 100_000
    (finding,) = check_imu_rate(np.concatenate([bursts, bursts + 500_000_000_000]))
    assert (finding.subject, finding.severity.value) == ("IMU stamps", "warning")
    assert finding.seen == "10000 Hz within bursts, 198.0 Hz on average outside gaps"


def test_readings_that_are_missing_are_counted() -> None:
    (finding,) = check_imu_rate(EVEN_NS[np.arange(2000) % 10 > 1])
    assert "398 of 1998 readings are missing" in finding.seen


@pytest.mark.parametrize(
    ("stamps_ns", "severity", "seen"),
    [
        (np.repeat(EVEN_NS, 2), "warning", "0 of 4000 stamps go backwards and 2000 repeat the one before"),
        (np.full(2000, 7), "error", "0 of 2000 stamps go backwards and 1999 repeat the one before"),
        (EVEN_NS[::-1], "error", "1999 of 2000 stamps go backwards and 0 repeat the one before"),
    ],
    ids=["recorded twice", "stand still", "backwards"],
)
def test_a_stream_is_useless_if_its_stamps_stand_still_or_go_back(
    stamps_ns: np.ndarray, severity: str, seen: str
) -> None:
    (finding,) = check_order("IMU", stamps_ns)
    assert (finding.severity.value, finding.seen.startswith(seen)) == (severity, True)


def test_a_stamp_that_goes_back_is_found_by_the_number_of_its_message_and_the_time_before_it() -> None:
    stamps_ns = EVEN_NS + 1_700_000_000_000_000_000
    stamps_ns[1000] = 0
    (finding,) = check_order("IMU", stamps_ns)
    assert finding.seen.endswith("first at message 1001 (after 5.00 s)")
