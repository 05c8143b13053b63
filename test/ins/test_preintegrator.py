# SPDX-License-Identifier: Apache-2.0
"""One increment per image, complete as soon as the readings have arrived."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.ins.preintegrator import DeadReckoning, ImuPreintegrator
from uav_vslam.types import ImuIncrement, ImuSample, NavEstimate, NavState

IMU = ImuConfig()
MS = 1_000_000
LEVEL = NavState(0, Pose.identity(), np.zeros(3), np.zeros(3), np.zeros(3))
START = NavEstimate(LEVEL, 1e-4 * np.eye(15))


def hovering(stamp_ns: int) -> ImuSample:
    return ImuSample(stamp_ns, np.zeros(3), np.array([0.0, 0.0, IMU.gravity]))


def test_an_increment_is_complete_when_a_reading_at_or_after_the_image_has_arrived() -> None:
    ins = ImuPreintegrator(IMU, LEVEL)
    ins.add_imu(hovering(0))
    ins.add_frame_stamp(10 * MS)
    assert ins.increments() == []
    ins.add_imu(hovering(9 * MS))
    assert ins.increments() == []
    ins.add_imu(hovering(11 * MS))
    (increment,) = ins.increments()
    assert (increment.start_ns, increment.stamp_ns) == (0, 10 * MS)
    assert ins.increments() == []


def test_increments_are_adjacent_and_do_not_depend_on_the_time_of_the_query() -> None:
    eager, lazy = ImuPreintegrator(IMU, LEVEL), ImuPreintegrator(IMU, LEVEL)
    rng = np.random.default_rng(5)
    events: list[ImuSample | int] = []
    for k in range(40):
        events.append(ImuSample(k * 5 * MS, rng.normal(0, 0.1, 3), rng.normal(0, 1.0, 3)))
        if k % 7 == 6:
            events.append((k * 5 - 2) * MS)
    got = []
    for event in events:
        for ins in (eager, lazy):
            ins.add_imu(event) if isinstance(event, ImuSample) else ins.add_frame_stamp(event)
        got += eager.increments()
    late = lazy.increments()
    assert len(got) == len(late) == 5
    assert [i.start_ns for i in got] == [0, *[i.stamp_ns for i in got[:-1]]]
    for a, b in zip(got, late, strict=True):
        np.testing.assert_array_equal(a.delta_p, b.delta_p)
        np.testing.assert_array_equal(a.covariance, b.covariance)


def test_a_flush_completes_the_rest_with_the_available_readings() -> None:
    ins = ImuPreintegrator(IMU, LEVEL)
    ins.add_imu(hovering(0))
    ins.add_imu(hovering(8 * MS))
    for stamp_ms in (10, 20):
        ins.add_frame_stamp(stamp_ms * MS)
    first, second = ins.increments(flush=True)
    assert first.samples > 0
    assert second.samples == 0  # no reading inside
    assert second.covariance[3, 3] > first.covariance[3, 3]


@pytest.mark.parametrize("stamp_ms", [0, 10, 9])
def test_an_image_stamp_that_is_not_later_is_rejected(stamp_ms: int) -> None:
    ins = ImuPreintegrator(IMU, LEVEL)
    ins.add_frame_stamp(10 * MS)
    with pytest.raises(ValueError, match="not after"):
        ins.add_frame_stamp(stamp_ms * MS)


def test_dead_reckoning_of_a_hover_stays_in_place_and_its_covariance_grows() -> None:
    ins = DeadReckoning(IMU)
    ins.start(START)
    traces = []
    samples = [hovering(k * MS) for k in range(0, 1001, 5)]
    for increment in cut(ImuPreintegrator(IMU, LEVEL), samples, list(range(100, 1001, 100))):
        (estimate,) = ins.add(increment)
        np.testing.assert_allclose(estimate.state.T_map_body.matrix, np.eye(4), rtol=0, atol=1e-12)
        assert np.linalg.eigvalsh(estimate.covariance)[0] > 0
        traces.append(np.trace(estimate.covariance[:3, :3]))
    assert np.all(np.diff(traces) > 0)


def cut(preintegrator: ImuPreintegrator, samples: list[ImuSample], stamps_ms: list[int]) -> list[ImuIncrement]:
    for sample in samples:
        preintegrator.add_imu(sample)
    for stamp_ms in stamps_ms:
        preintegrator.add_frame_stamp(stamp_ms * MS)
    return preintegrator.increments()


def varying(count: int) -> list[ImuSample]:
    rng = np.random.default_rng(7)
    return [ImuSample(k * 5 * MS, rng.normal(0, 0.1, 3), rng.normal(0, 1.0, 3)) for k in range(count)]


def test_without_a_start_state_the_first_increment_starts_at_the_first_image() -> None:
    preintegrator = ImuPreintegrator(IMU)
    assert preintegrator.start_ns is None
    increments = cut(preintegrator, varying(60), [50, 100, 170])
    assert preintegrator.start_ns == 50 * MS
    assert [(i.start_ns // MS, i.stamp_ns // MS) for i in increments] == [(50, 100), (100, 170)]
    assert not increments[0].gyro_bias.any()
    with pytest.raises(ValueError, match="not after"):
        preintegrator.add_frame_stamp(170 * MS)


def test_increments_are_linearised_at_the_start_bias() -> None:
    start = NavState(0, Pose.identity(), np.zeros(3), np.array([0.01, 0.0, 0.0]), np.array([0.0, 0.1, 0.0]))
    (increment,) = cut(ImuPreintegrator(IMU, start), varying(30), [100])
    np.testing.assert_array_equal(increment.gyro_bias, start.gyro_bias)
    np.testing.assert_array_equal(increment.accel_bias, start.accel_bias)


def test_dead_reckoning_does_not_depend_on_when_the_start_state_arrives() -> None:
    increments = cut(ImuPreintegrator(IMU), varying(200), list(range(50, 900, 90)))
    start = NavEstimate(NavState(increments[2].start_ns, Pose.identity(), np.ones(3), *np.zeros((2, 3))), np.eye(15))
    early, late = DeadReckoning(IMU), DeadReckoning(IMU)
    expected = [*early.start(start), *(estimate for increment in increments[2:] for estimate in early.add(increment))]
    for increment in increments[:7]:
        assert late.add(increment) == []
    assert late.estimate is None
    found = [*late.start(start), *(estimate for increment in increments[7:] for estimate in late.add(increment))]
    assert [r.state.stamp_ns for r in found] == [start.state.stamp_ns, *(i.stamp_ns for i in increments[2:])]
    for a, b in zip(expected, found, strict=True):
        np.testing.assert_array_equal(a.state.T_map_body.matrix, b.state.T_map_body.matrix)
        np.testing.assert_array_equal(a.covariance, b.covariance)


def test_dead_reckoning_knows_nothing_of_the_motion_in_a_lost_increment() -> None:
    first, lost, last = cut(ImuPreintegrator(IMU, LEVEL), varying(60), [50, 100, 150])
    whole, holed = DeadReckoning(IMU), DeadReckoning(IMU)
    for ins, increments in ((whole, (first, lost, last)), (holed, (first, last))):
        ins.start(START)
        for increment in increments:
            (estimate,) = ins.add(increment)
            assert estimate.state.stamp_ns == increment.stamp_ns
    assert whole.estimate is not None
    assert holed.estimate is not None
    growth = holed.estimate.covariance - whole.estimate.covariance
    assert np.linalg.eigvalsh(growth[:9, :9])[0] > 0


@pytest.mark.parametrize("rate_hz", [10, 20, 30])
def test_a_gap_is_detected_at_any_image_rate(rate_hz: int) -> None:
    """All intervals within it are between the same two readings, 2 s apart; intervals around it are unaffected."""
    samples = [s for s in varying(1001) if not 1000 < s.stamp_ns / MS < 3000]
    preintegrator = ImuPreintegrator(dataclasses.replace(IMU, noise_from_readings=False))
    increments = cut(preintegrator, samples, [round(1000 / rate_hz * k) for k in range(5 * rate_hz)])
    silent = [i for i in increments if i.stamp_ns > 1000 * MS and i.start_ns < 3000 * MS]
    sigmas = [np.sqrt(np.diag(i.covariance)[:6]) / i.dt_s for i in silent]
    measured = [np.sqrt(np.diag(i.covariance)[:6]) / i.dt_s for i in increments if i not in silent]
    assert min(sigma.min() for sigma in sigmas) > 0.2  # at least half of the sigmas within a gap
    assert max(sigma.max() for sigma in measured) < 0.1
    assert preintegrator.gaps == len(silent) >= 2 * rate_hz
    assert {i.samples for i in silent if i.start_ns >= 1000 * MS and i.stamp_ns < 3000 * MS} == {0}
    assert sum(i.samples for i in increments) == sum(0 < s.stamp_ns <= increments[-1].stamp_ns for s in samples)


def test_an_interval_between_close_readings_is_no_gap() -> None:
    """Images may be faster than readings."""
    preintegrator = ImuPreintegrator(IMU)
    increments = cut(preintegrator, varying(10), [11, 13, 17, 22])
    assert [i.samples for i in increments] == [0, 1, 1]
    assert preintegrator.gaps == 0
