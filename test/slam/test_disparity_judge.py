# SPDX-License-Identifier: Apache-2.0
"""When the disparity's error is judged, and what the filter takes it for until then."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import RigConfig, VehicleConfig
from uav_vslam.estimation.belief import NO_ROWS
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.filters import make_filter
from uav_vslam.ins.increments import unknown_motion_since
from uav_vslam.ins.propagation import ROTATION
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.slam.disparity_judge import JUDGED_AFTER_S, LEVEL_RAD, DisparityJudge
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate

RIG = RigConfig()
DISPARITY = 15 + 3  # row of the filter's state
JUDGED_AT = int(JUDGED_AFTER_S * Scenario().frame_rate_hz) + 2  # frame


def sigma_px(of: Filter) -> float:
    """Return the standard deviation of the disparity's error, without what the claims add."""
    return float(np.sqrt(of.belief.covariance(NO_ROWS)[DISPARITY, DISPARITY]))


def started(flight, tilt_rad: float = 0.001) -> tuple[Filter, NavEstimate]:
    covariance = flight.vehicle.initial.covariance.copy()
    covariance[6:8, 6:8] = tilt_rad**2 * np.eye(2)
    initial = dataclasses.replace(flight.vehicle.initial, covariance=covariance)
    config = VehicleConfig(imu=flight.vehicle.scenario.imu_config, rig=RIG)
    f = make_filter(initial, rig=flight.vehicle.rig, config=config)
    return f, initial


def nothing_known(flight, nav: NavEstimate) -> ImuIncrement:
    imu = flight.vehicle.scenario.imu_config
    return unknown_motion_since(nav.state, nav.state.stamp_ns + NS_PER_S // 10, imu)


def test_until_then_the_filter_expects_a_wrong_one_but_reports_by_a_right_one(flown) -> None:
    judge, (f, nav) = DisparityJudge(), started(flown(1))
    judge.after_update(f, nav, by_tracks=True)
    assert sigma_px(f) == pytest.approx(RIG.miscalibrated_sigma_px)
    assert sigma_px(judge.trusting(f)) == pytest.approx(RIG.disparity_sigma_px)
    later = dataclasses.replace(nav, state=dataclasses.replace(nav.state, stamp_ns=nav.state.stamp_ns + 4 * NS_PER_S))
    judge.after_update(f, later, by_tracks=True)
    assert sigma_px(f) == pytest.approx(RIG.disparity_sigma_px)
    assert judge.trusting(f) is f


def test_without_tracks_a_calibration_is_trusted_until_it_is_judged(flown) -> None:
    judge, (f, nav) = DisparityJudge(), started(flown(1))
    judge.after_update(f, nav, by_tracks=False)
    assert sigma_px(f) == pytest.approx(RIG.disparity_sigma_px)


@pytest.mark.parametrize("level", [True, False])
def test_what_is_not_judged_when_readings_are_missing_is_trusted(flown, level: bool) -> None:
    flight = flown(1)
    judge, (f, nav) = DisparityJudge(), started(flight, 0.5 * LEVEL_RAD if level else 2.0 * LEVEL_RAD)
    judge.after_update(f, nav, by_tracks=True)
    judge.before_prediction(f, flight.frames[1][1])
    assert sigma_px(f) == pytest.approx(RIG.miscalibrated_sigma_px if level else RIG.disparity_sigma_px)
    judge.before_prediction(f, nothing_known(flight, nav))
    assert sigma_px(f) == pytest.approx(RIG.disparity_sigma_px)
    assert judge.trusting(f) is f


@pytest.mark.parametrize("level", [False, True])
def test_until_the_tilt_is_known_evidence_does_not_count_but_what_was_estimated_stays_in_doubt(
    flown, level: bool
) -> None:
    judge, (f, nav) = DisparityJudge(), started(flown(1), 2.0 * LEVEL_RAD)
    P = f.belief.covariance(NO_ROWS)
    P[DISPARITY, DISPARITY] = 0.0
    effect = np.zeros(len(P))
    effect[0], effect[DISPARITY] = 5.0, 1.0  # metres a pixel
    f.belief = type(f.belief).from_covariance(P + 0.1 * RIG.disparity_sigma_px**2 * np.outer(effect, effect))
    doubted = P[0, 0] + 5.0**2 * f.disparity_prior.claimed_variance
    assert judge.trusting(f).nav_estimate().covariance[0, 0] == pytest.approx(doubted, rel=1e-6)
    if level:
        judge.after_update(f, nav, by_tracks=False)
        known = nav.covariance.copy()
        known[ROTATION, ROTATION] = (0.5 * LEVEL_RAD) ** 2 * np.eye(3)
        nav = dataclasses.replace(nav, covariance=known)
    judge.after_update(f, nav, by_tracks=False)
    found = f.belief.covariance(NO_ROWS)
    assert found[DISPARITY, DISPARITY] == pytest.approx(RIG.disparity_sigma_px**2)
    assert found[0, DISPARITY] / found[DISPARITY, DISPARITY] == pytest.approx(0.0 if level else 5.0, abs=1e-6)
    assert f.nav_estimate().covariance[0, 0] == pytest.approx(doubted, rel=1e-6)


def test_evidence_is_awaited_from_when_the_tilt_is_known_until_the_disparity_is_judged(flown) -> None:
    judge, (f, level), (_, tilted) = DisparityJudge(), started(flown(1)), started(flown(1), 2.0 * LEVEL_RAD)
    awaited = []
    for seconds, nav in ((0, tilted), (1, level), (3, level), (5, level)):
        state = dataclasses.replace(nav.state, stamp_ns=nav.state.stamp_ns + seconds * NS_PER_S)
        judge.after_update(f, dataclasses.replace(nav, state=state), by_tracks=True)
        awaited.append(judge.awaits_evidence)
    assert awaited == [False, True, True, False]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_a_calibration_far_off_does_not_make_the_state_certain_and_wrong(flown, seed: int) -> None:
    """By 1.4 px of 18, five times what a wrong one is expected to be off by."""
    flight = flown(seed, frames=80, tracked_px=0.1, extrinsic_bias_deg=(0.05, 0.0, 0.0))
    stage, outputs = flight.tracking_stage(0.1), []
    for features, increment in flight.frames:
        stage.add_features(features)
        if increment is not None:
            stage.add_increment(increment)
        outputs.extend(stage.run())
    errors, nees = flight.errors_and_nees(outputs)
    assert not any(output.report.recovery for output in outputs)
    assert nees[JUDGED_AT:].mean() < 5.0
    assert errors[JUDGED_AT:].max() < 2.0
