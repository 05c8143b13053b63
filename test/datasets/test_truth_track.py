# SPDX-License-Identifier: Apache-2.0
"""Samples of true motion become a track, whatever their order."""

import dataclasses

import numpy as np

from uav_vslam.datasets.messages import TruthSample
from uav_vslam.datasets.truth import truth_warnings
from uav_vslam.datasets.truth_track import TruthSeries
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.types import NS_PER_S

SPEED = np.array([2.0, 0.0, 0.0])


def sample(second: int, *, y: float = 0.0, v: np.ndarray = SPEED) -> TruthSample:
    return TruthSample(
        second * NS_PER_S, Pose(so3_exp([0.0, 0.0, 0.1 * second]), second * SPEED + [0.0, y, 0.0]), v, np.zeros(3)
    )


def test_samples_are_sorted_and_the_last_of_one_stamp_counts() -> None:
    series = TruthSeries()
    for one in (sample(2), sample(0), sample(1, y=7.0), sample(3), sample(1)):
        series.add(one)
    track = series.track()
    assert track.stamps_ns.tolist() == [0, NS_PER_S, 2 * NS_PER_S, 3 * NS_PER_S]
    np.testing.assert_array_equal(track.positions_world, np.arange(4)[:, None] * SPEED)
    np.testing.assert_array_equal(track.R_world_body[3], sample(3).T_world_body.R)
    np.testing.assert_array_equal(track.velocities_world, np.tile(SPEED, (4, 1)))


def test_what_follows_a_step_back_of_the_clock_is_left_out_and_told() -> None:
    """It would be mixed with the poses of the same stamps, metres away; a single wrong stamp changes nothing."""
    series = TruthSeries()
    for second in range(20):
        step = -10 if second >= 12 else 0
        series.add(dataclasses.replace(sample(second), stamp_ns=(second + step) * NS_PER_S))
    track = series.track()
    np.testing.assert_array_equal(track.positions_world, np.arange(12)[:, None] * SPEED)
    assert "the 8 poses that follow are left out" in " ".join(truth_warnings(track))
    for wrong in (-10, 10):
        series = TruthSeries()
        for second in range(20):
            series.add(dataclasses.replace(sample(second), stamp_ns=(second + wrong * (second == 12)) * NS_PER_S))
        assert series.track().set_back == 0


def test_velocities_that_were_not_recorded_are_differences() -> None:
    series = TruthSeries()
    for second in range(4):
        series.add(sample(second, v=np.full(3, np.nan)))
    np.testing.assert_allclose(series.track().velocities_world, np.tile(SPEED, (4, 1)))


def test_no_samples_are_an_empty_track() -> None:
    track = TruthSeries().track()
    assert len(track) == 0
    assert track.R_world_body.shape == (0, 3, 3)
    assert not track.turns
