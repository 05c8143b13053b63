# SPDX-License-Identifier: Apache-2.0
"""Where the IMU does not know the motion, tracks show it: the flight goes on as if nothing had happened."""

import dataclasses

import numpy as np
import pytest
from fed_stage import feed
from flown_copy import copy_of

from uav_vslam.ins.increments import unknown_motion
from uav_vslam.ins.preintegrator import advance
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.imu_fault import ImuFaultDetector
from uav_vslam.slam.seen_motion import MIN_INLIERS, MotionFinder, Step
from uav_vslam.slam.stage import SlamStage
from uav_vslam.types import ImuIncrement, NavEstimate, StereoFeatures

FRAMES, SIGMA_PX, FIRST = 45, 0.05, 10
SEEDS = range(300, 305)


def fly(stage: SlamStage, flight, frames: range, lost: range = range(0)) -> list[FrameOutput]:
    """Fly some frames, without the increments of the lost ones."""
    given = [(features, None if k in lost else increment) for k, (features, increment) in enumerate(flight.frames)]
    outputs = feed(stage, given[frames.start : frames.stop])
    assert stage.dropped["motion_lost"] == len(lost)
    return outputs


@pytest.mark.slow
def test_four_seconds_without_any_motion_cost_little_accuracy_and_no_consistency(flown) -> None:
    """Before tracks showed the motion, single flights were 66 m off at a sigma of 3 m."""
    with_all, without, nees = [], [], []
    for seed in SEEDS:
        flight = flown(seed, frames=FRAMES, tracked_px=SIGMA_PX)
        stage = flight.tracking_stage(SIGMA_PX)
        begun = fly(stage, flight, range(FIRST))
        rest = range(FIRST, FRAMES)
        whole = begun + fly(copy_of(stage), flight, rest)
        outputs = begun + fly(stage, flight, rest, lost=range(FIRST, FIRST + 28))
        assert len(outputs) == FRAMES
        assert not any(output.report.recovery or output.report.coasted for output in outputs[1:])
        errors_m, claimed = flight.errors_and_nees(outputs)
        without.append(errors_m[-1])
        nees.append(claimed)
        with_all.append(flight.errors_and_nees(whole)[0][-1])
    assert np.linalg.norm(without) <= 1.3 * np.linalg.norm(with_all)
    assert np.mean(nees) <= 1.5
    assert np.max(nees) <= 5.0


def step(flight, finder: MotionFinder, number: int, features: StereoFeatures, increment: ImuIncrement | None) -> Step:
    vehicle = flight.vehicle
    at = vehicle.true_state(int(vehicle.frame_stamps_ns[number - 1]))
    imu = vehicle.scenario.imu_config
    return finder.step(
        increment, features, at, rig=vehicle.rig, imu=imu, threshold_px=4.0, imu_fault=ImuFaultDetector(imu.gravity)
    )


def unknown(flight, number: int) -> ImuIncrement:
    stamps, zero = flight.vehicle.frame_stamps_ns, np.zeros(3)
    imu = flight.vehicle.scenario.imu_config
    return unknown_motion(int(stamps[number - 1]), int(stamps[number]), gyro_bias=zero, accel_bias=zero, imu=imu)


def test_the_increment_leads_to_the_pose_that_is_seen_and_says_nothing_itself(flown) -> None:
    flight, finder, k = flown(1, frames=FRAMES, tracked_px=SIGMA_PX), MotionFinder(), 10
    step(flight, finder, k - 1, flight.frames[k - 1][0], None)
    features = flight.frames[k][0]
    wrong = features.pixels.copy()
    wrong[:5, :2] += 30.0
    found = step(flight, finder, k, dataclasses.replace(features, pixels=wrong), unknown(flight, k))
    known = np.isin(features.tracks, flight.frames[k - 1][0].tracks)
    assert MIN_INLIERS <= found.tracks == (known & (found.features.tracks != 0)).sum()
    assert (found.features.tracks[:5] == np.where(known[:5], 0, features.tracks[:5])).all()
    assert known[:5].any()
    assert len(found.features) == len(features)
    start, end = (flight.vehicle.true_state(int(flight.vehicle.frame_stamps_ns[n])) for n in (k - 1, k))
    P = np.eye(15) * 1e-6
    reached = advance(NavEstimate(start, P), found.increment, flight.vehicle.scenario.imu_config)
    assert np.linalg.norm(reached.state.T_map_body.t - end.T_map_body.t) < 0.5
    assert np.linalg.norm(reached.state.v_map - end.v_map) < 5.0
    assert np.sqrt(np.diag(reached.covariance)[:3]).min() > 10.0


def test_a_known_motion_is_left_alone(flown) -> None:
    flight, finder = flown(1, frames=FRAMES, tracked_px=SIGMA_PX), MotionFinder()
    step(flight, finder, 9, flight.frames[9][0], None)
    features, increment = flight.frames[10]
    assert step(flight, finder, 10, features, increment) == Step(increment, features)


def test_without_tracks_an_unknown_motion_stays_unknown_and_the_frame_coasts(flown) -> None:
    flight, finder = flown(1, frames=FRAMES), MotionFinder()
    step(flight, finder, 9, flight.frames[9][0], None)
    motion = unknown(flight, 10)
    found = step(flight, finder, 10, flight.frames[10][0], motion)
    assert (found.increment, len(found.features), found.tracks) == (motion, 0, 0)
