# SPDX-License-Identifier: Apache-2.0
"""A start state that the truth contradicts, and truth that can't be scored against, are told."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import VehicleConfig, replaced
from uav_vslam.datasets.truth_track import TruthTrack
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.imu_series import ImuSeries
from uav_vslam.inspection.finding import Severity
from uav_vslam.inspection.start import check_start, check_truth
from uav_vslam.types import NS_PER_S, NavEstimate, NavState

CONFIG = VehicleConfig()
IMAGES_NS = np.arange(50, dtype=np.int64) * NS_PER_S // 5
AHEAD = np.array([20.0, 0.0, 0.0])
ELSEWHERE = Pose(so3_exp([0.1, 0.2, 2.0]), np.array([100.0, 5.0, 0.0]))


def truth_every(seconds: float, turn: Pose | None = None) -> TruthTrack:
    """Straight flight, seen from a frame of its own."""
    T = turn or Pose.identity()
    stamps_ns = np.arange(0, IMAGES_NS[-1] + 1, round(seconds * NS_PER_S), dtype=np.int64)
    positions = T.apply(stamps_ns[:, None] / NS_PER_S * AHEAD)
    return TruthTrack(
        stamps_ns, positions, np.tile(T.R, (len(stamps_ns), 1, 1)), np.tile(T.R @ AHEAD, (len(stamps_ns), 1))
    )


def start(R: np.ndarray, velocity: np.ndarray) -> NavEstimate:
    state = NavState(0, Pose(R, np.zeros(3)), velocity, np.zeros(3), np.zeros(3))
    return NavEstimate(state, 1e-4 * np.eye(15))


def findings(given: NavEstimate, truth: TruthTrack) -> list[str]:
    found = check_start([given], IMAGES_NS, ImuSeries(), CONFIG, truth)
    return [each.seen for each in found if "the truth's" in each.seen]


@pytest.mark.parametrize("turn", [Pose.identity(), ELSEWHERE])
def test_a_start_is_compared_with_truth_of_any_frame(turn: Pose) -> None:
    truth = truth_every(0.02, turn)
    assert findings(start(np.eye(3), AHEAD), truth) == []
    (no_speed,) = findings(start(np.eye(3), np.zeros(3)), truth)
    assert no_speed.startswith("in the body its velocity is 0.00 0.00 0.00 m/s, the truth's 20.00 ")
    assert findings(start(so3_exp([0.0, 0.0, 1.5]), AHEAD), truth)


@pytest.mark.parametrize(("turn", "told"), [(ELSEWHERE, True), (Pose.identity(), False)])
def test_truth_of_a_frame_of_its_own_is_told(turn: Pose, told: bool) -> None:
    found = check_start([start(np.eye(3), AHEAD)], IMAGES_NS, ImuSeries(), CONFIG, truth_every(0.02, turn))
    (seen,) = [each.seen for each in found if each.subject == "truth origin"] or [""]
    assert seen == ("where the flight starts it is 100 m and 115 deg from the start state" if told else "")


@pytest.mark.parametrize("method", ["in_flight", "map"])
@pytest.mark.parametrize("recorded", [[], [start(np.eye(3), 9e9 * AHEAD)]])
def test_where_the_start_is_searched_for_a_recorded_one_is_neither_missed_nor_judged(
    recorded: list[NavEstimate], method: str
) -> None:
    config = replaced(CONFIG, {"start.method": method, "start.map": "map.npz"}, where="test")
    (found,) = check_start(recorded, IMAGES_NS, ImuSeries(), config, None)
    assert (found.severity, found.seen) == (Severity.OK, f"start.method {method}: estimated from images and IMU")


def test_a_start_without_a_covariance_is_told_that_alone() -> None:
    bad = dataclasses.replace(start(np.eye(3), np.zeros(3)), covariance=-np.eye(15))
    (found,) = check_start([bad], IMAGES_NS, ImuSeries(), CONFIG, truth_every(0.02))
    assert found.subject == "start covariance"


def test_a_start_that_is_uncertain_enough_is_not_contradicted() -> None:
    wide = dataclasses.replace(start(np.eye(3), np.zeros(3)), covariance=25.0 * np.eye(15))
    assert findings(wide, truth_every(0.02)) == []


@pytest.mark.parametrize(("seconds", "told"), [(0.02, False), (0.7, True)])
def test_truth_that_is_too_rare_to_score_against_is_told(seconds: float, told: bool) -> None:
    found = check_truth(truth_every(seconds), IMAGES_NS, recorded=True)
    assert any(each.subject == "truth rate" for each in found) is told
