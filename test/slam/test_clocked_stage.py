# SPDX-License-Identifier: Apache-2.0
"""When stamps jump, the back end goes on, starts again or refuses, as configured; wrong stamps change nothing."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from position_nees import position_nees

from uav_vslam.config import InputConfig, VehicleConfig
from uav_vslam.ins.increments import unknown_motion_since
from uav_vslam.slam.clocked_stage import ClockedStage
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.frame_queue import MAX_WAITING, Frame
from uav_vslam.slam.stage import SlamStage
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate, StereoFeatures

SESSION = 3
Item = StereoFeatures | ImuIncrement


def make(flight, policy: str = "bridge", *, start: bool = True) -> ClockedStage:
    config = VehicleConfig(imu=flight.vehicle.scenario.imu_config, input=InputConfig(on_time_jump=policy))
    sessions = iter(range(SESSION + 1, 100))
    clocked = ClockedStage(SlamStage(config, vehicle="uav1", session=SESSION), config, lambda: next(sessions))
    clocked.stage.rig = flight.vehicle.rig
    if start:
        clocked.start(flight.vehicle.initial)
    return clocked


def moved(item: Item, offset_s: float) -> Item:
    offset_ns = round(offset_s * NS_PER_S)
    if isinstance(item, ImuIncrement):
        return dataclasses.replace(item, start_ns=item.start_ns + offset_ns, stamp_ns=item.stamp_ns + offset_ns)
    return dataclasses.replace(item, stamp_ns=item.stamp_ns + offset_ns)


def feed(clocked: ClockedStage, frames: Sequence[Frame], offset_s: float = 0.0) -> list[FrameOutput]:
    outputs: list[FrameOutput] = []
    for features, increment in frames:
        clocked.add_features(moved(features, offset_s))
        if increment is not None:
            clocked.add_increment(moved(increment, offset_s))
        outputs += clocked.stage.run()
    return outputs


def worst_nees(flight, outputs: list[FrameOutput], offset_s: float) -> float:
    """Return the largest position NEES, per axis, of frames whose stamps are off by an offset."""
    offset_ns, poses = round(offset_s * NS_PER_S), [output.report.pose for output in outputs]
    return max(position_nees(pose, flight.vehicle.true_state(pose.stamp_ns - offset_ns)) for pose in poses)


def same(a: FrameOutput, b: FrameOutput) -> bool:
    return bool(
        np.array_equal(a.report.pose.covariance, b.report.pose.covariance)
        and np.array_equal(a.report.pose.T_map_body.t, b.report.pose.T_map_body.t)
    )


@pytest.mark.parametrize("offset_s", [-3600.0, -10.0, -1.5, 3600.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_new_session_goes_on_from_the_last_estimate_with_the_sigma_of_unknown_motion(
    flown, seed: int, offset_s: float
) -> None:
    flight = flown(seed)
    clocked = make(flight)
    feed(clocked, flight.frames[:12])
    after = feed(clocked, flight.frames[12:], offset_s)
    assert clocked.stage.session == SESSION + 1
    assert [o.report.pose.stamp_ns for o in after] == [moved(f, offset_s).stamp_ns for f, _ in flight.frames[12:]]
    assert worst_nees(flight, after, offset_s) <= 3.0
    unknown_m = 15.0 * min(abs(offset_s) - 0.2, 60.0)  # a vehicle may have flown on, at 15 m/s per axis
    assert np.sqrt(after[0].report.pose.covariance[0, 0]) > unknown_m
    assert clocked.dropped == {**dict.fromkeys(clocked.dropped, 0), "motion_refused": 1}  # that across the jump


@pytest.mark.parametrize("policy", ["bridge", "reset"])
def test_a_recording_that_begins_again_is_flown_again_to_the_same_bits(flown, policy: str) -> None:
    flight = flown(1)
    clocked = make(flight, policy)
    flights = [feed(clocked, flight.frames)]
    for _ in range(2):
        start: NavEstimate = dataclasses.replace(flight.vehicle.initial)
        clocked.start(start)
        flights.append(feed(clocked, flight.frames))
    assert clocked.stage.session == SESSION + 2
    for again in flights[1:]:
        assert len(again) == len(flights[0])
        assert all(same(a, b) for a, b in zip(again, flights[0], strict=True))


@pytest.mark.parametrize("offset_s", [-3600.0, 3600.0])
def test_a_clock_set_before_the_first_features_begins_a_session_that_flies(flown, offset_s: float) -> None:
    flight = flown(1)
    clocked = make(flight)
    early = [increment for _, increment in flight.frames[1:8] if increment is not None]
    for increment in [*(moved(one, -offset_s) for one in early), *early]:
        clocked.add_increment(increment)
    assert clocked.stage.session == SESSION + 1
    clocked.start(dataclasses.replace(flight.vehicle.initial))
    outputs = feed(clocked, flight.frames[8:])
    assert len(outputs) == len(flight.frames[1:])
    assert worst_nees(flight, outputs, 0.0) <= 3.0
    assert clocked.dropped == {**dict.fromkeys(clocked.dropped, 0), "frame_lost": len(early)}


@pytest.mark.parametrize("policy", ["bridge", "reset"])
@pytest.mark.parametrize("offset_s", [-3600.0, -10.0, -2.0])
@pytest.mark.parametrize("ahead", [0, 2, 5])
def test_features_that_begin_as_the_clock_is_set_back_fly(flown, offset_s: float, policy: str, ahead: int) -> None:
    """The INS holds its increments until it is sure of the jump, so some features of the new clock may come before."""
    flight = flown(1)
    clocked = make(flight, policy, start=False)
    for _, increment in flight.frames[1:8]:
        clocked.add_increment(moved(increment, -offset_s))
    clocked.start(dataclasses.replace(flight.vehicle.initial))
    for features, _ in flight.frames[1 : 1 + ahead]:
        clocked.add_features(features)
    for _, increment in flight.frames[1 : 1 + ahead]:
        clocked.add_increment(increment)
    outputs = feed(clocked, flight.frames[1 + ahead :])
    assert clocked.line.faults == {}
    assert clocked.stage.session == SESSION + 1
    assert outputs[-1].report.pose.stamp_ns == flight.frames[-1][0].stamp_ns
    assert worst_nees(flight, outputs, 0.0) <= 3.0


@pytest.mark.parametrize("policy", ["bridge", "reset"])
@pytest.mark.parametrize("offset_s", [-3600.0, 3600.0])
def test_a_start_that_no_frame_has_used_is_that_of_the_clock_it_is_of(flown, offset_s: float, policy: str) -> None:
    """It may come before the motion has shown that the clock was set."""
    flight = flown(1)
    clocked = make(flight, policy, start=False)
    early = [increment for _, increment in flight.frames[1:8] if increment is not None]
    for increment in early:
        clocked.add_increment(moved(increment, -offset_s))
    clocked.start(dataclasses.replace(flight.vehicle.initial))
    for increment in early:
        clocked.add_increment(increment)
    assert clocked.stage.session == SESSION + 1
    outputs = feed(clocked, flight.frames[8:])
    assert len(outputs) == len(flight.frames[1:])
    assert worst_nees(flight, outputs, 0.0) <= 3.0


@pytest.mark.parametrize("policy", ["bridge", "reset"])
def test_motion_that_was_missing_for_long_begins_a_session_though_features_went_on(flown, policy: str) -> None:
    flight, silence_s = flown(1), 40.0
    clocked = make(flight, policy)
    feed(clocked, flight.frames[:8])
    for missing_s in range(int(silence_s)):
        clocked.add_features(moved(flight.frames[8][0], float(missing_s)))
    outputs = feed(clocked, flight.frames[9:], silence_s)
    assert clocked.stage.session == SESSION + 1
    if policy == "reset":
        assert (outputs, clocked.stage.initial) == ([], None)
        return
    assert outputs[-1].report.pose.stamp_ns == moved(flight.frames[-1][0], silence_s).stamp_ns
    assert worst_nees(flight, outputs, silence_s) <= 3.0


@pytest.mark.parametrize("at_once", [False, True], ids=["front end", "cameras"])
@pytest.mark.parametrize("policy", ["bridge", "reset"])
def test_frames_that_were_missing_for_long_begin_no_session_if_the_motion_is_known(
    flown, policy: str, at_once: bool
) -> None:
    """Without images there is one increment up to the next, without a front end one for each image."""
    flight, silence_s = flown(1), 40.0
    clocked = make(flight, policy)
    feed(clocked, flight.frames[:8])
    state, last = clocked.stage.nav.state, flight.frames[7][1]
    for end_s in [silence_s] if at_once else np.arange(1.0, silence_s + 1.0):
        increment = unknown_motion_since(state, moved(last, end_s).stamp_ns, flight.vehicle.scenario.imu_config)
        clocked.add_increment(increment)
        state = dataclasses.replace(state, stamp_ns=increment.stamp_ns)
    outputs = feed(clocked, flight.frames[8:], silence_s)
    assert clocked.stage.session == SESSION
    assert outputs[-1].report.pose.stamp_ns == moved(flight.frames[-1][0], silence_s).stamp_ns


def test_features_of_a_clock_that_was_set_alone_do_not_fill_the_memory(flown) -> None:
    """No more are held than the queue takes once a jump is followed; the others are counted as they come."""
    flight, later = flown(1), 50
    clocked = make(flight)
    feed(clocked, flight.frames[:8])
    for number in range(MAX_WAITING + later):
        clocked.add_features(moved(flight.frames[8][0], -3600.0 + 0.05 * number))
    assert clocked.dropped["stamp_jump"] == later
    assert clocked.line.faults


def test_reset_waits_for_a_start_state(flown) -> None:
    flight = flown(1)
    clocked = make(flight, "reset")
    feed(clocked, flight.frames[:12])
    assert feed(clocked, flight.frames[12:], -10.0) == []
    assert (clocked.stage.session, clocked.stage.initial) == (SESSION + 1, None)


@pytest.mark.parametrize("offset_s", [10.0, 40.0])
def test_reset_follows_an_ins_that_started_again(flown, offset_s: float) -> None:
    flight = flown(1)
    clocked = make(flight, "reset")
    feed(clocked, flight.frames[:12])
    assert feed(clocked, flight.frames[13:], offset_s) == []
    assert clocked.stage.session == SESSION + 1


@pytest.mark.parametrize("policy", ["bridge", "reset"])
def test_a_lost_increment_is_no_jump(flown, policy: str) -> None:
    flight = flown(1)
    clocked = make(flight, policy)
    feed(clocked, flight.frames[:12])
    feed(clocked, flight.frames[13:])
    assert clocked.stage.session == SESSION


@pytest.mark.parametrize("offset_s", [-10.0, 40.0])
def test_refused_jumps_stop_nothing_once_the_clock_is_right_again(flown, offset_s: float) -> None:
    flight = flown(1)
    clocked = make(flight, "refuse")
    feed(clocked, flight.frames[:8])
    assert feed(clocked, flight.frames[8:14], offset_s) == []
    assert len(clocked.line.faults) == 2
    assert clocked.dropped["stamp_jump"] == 12
    after = feed(clocked, flight.frames[14:])
    assert len(after) == len(flight.frames[14:])
    assert clocked.stage.session == SESSION
    assert clocked.line.faults == {}


@pytest.mark.parametrize("kind", [StereoFeatures, ImuIncrement])
@pytest.mark.parametrize("offset_s", [-3600.0, -10.0, 60.0, 3600.0])
def test_wrong_stamps_of_one_input_change_no_bit(flown, kind: type, offset_s: float) -> None:
    flight = flown(1)
    expected = feed(make(flight), flight.frames)
    clocked, outputs = make(flight), []
    for k, frame in enumerate(flight.frames):
        wrong = [moved(item, offset_s) for item in frame if isinstance(item, kind) and k % 5 == 4]
        for item in wrong:
            (clocked.add_features if kind is StereoFeatures else clocked.add_increment)(item)
        outputs += feed(clocked, [frame])
    assert len(outputs) == len(expected)
    assert all(same(a, b) for a, b in zip(outputs, expected, strict=True))
    assert clocked.dropped["stamp_jump"] == 4


@pytest.mark.parametrize("kind", [StereoFeatures, ImuIncrement])
def test_one_input_whose_clock_was_set_moves_nothing_and_is_named(flown, kind: type) -> None:
    flight = flown(1)
    clocked = make(flight)
    feed(clocked, flight.frames[:8])
    outputs: list[FrameOutput] = []
    for frame in flight.frames[8:]:
        for item in frame:
            one = moved(item, -3600.0) if isinstance(item, kind) else item
            (clocked.add_features if isinstance(one, StereoFeatures) else clocked.add_increment)(one)
        outputs += clocked.stage.run()
    assert clocked.stage.session == SESSION
    assert list(clocked.line.faults) == ["stereo_features" if kind is StereoFeatures else "ins/increment"]
    assert worst_nees(flight, outputs, 0.0) <= 3.0 if outputs else kind is ImuIncrement
