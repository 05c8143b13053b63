# SPDX-License-Identifier: Apache-2.0
"""Frames go through once rig and start state are known, in order, whatever comes first."""

import numpy as np
import pytest

from uav_vslam.config import StartConfig, VehicleConfig
from uav_vslam.ins.propagator import advance
from uav_vslam.slam.stage import FrameOutput, SlamStage

IN_FLIGHT = StartConfig(method="in_flight")


def make(flight, *, start: StartConfig | None = None, rig: bool = True) -> SlamStage:
    config = VehicleConfig(imu=flight.vehicle.scenario.imu_config, start=start or StartConfig())
    stage = SlamStage(config, vehicle="uav1", session=3)
    stage.rig = flight.vehicle.rig if rig else None
    return stage


def feed(stage: SlamStage, frames) -> list[FrameOutput]:
    """Add frames one by one and return what comes out."""
    outputs: list[FrameOutput] = []
    for features, increment in frames:
        stage.add_features(features)
        if increment is not None:
            stage.add_increment(increment)
        outputs += stage.run()
    return outputs


def stamps(outputs: list[FrameOutput]) -> list[int]:
    return [output.report.pose.stamp_ns for output in outputs]


def test_frames_wait_for_the_rig_and_the_start_state(flown) -> None:
    flight = flown(1)
    stage = make(flight, rig=False)
    assert feed(stage, flight.frames[:6]) == []
    stage.rig = flight.vehicle.rig
    assert list(stage.run()) == []
    assert stage.missing_start == "none has been given"
    stage.start(flight.vehicle.initial)
    late = list(stage.run())
    assert stage.missing_start == ""
    ready = make(flight)
    ready.start(flight.vehicle.initial)
    for a, b in zip(late, feed(ready, flight.frames[:6]), strict=True):
        assert a.report.pose.covariance.tobytes() == b.report.pose.covariance.tobytes()
        assert a.dead_reckoning.covariance.tobytes() == b.dead_reckoning.covariance.tobytes()


def test_dead_reckoning_goes_along_and_beliefs_come_at_epochs(flown) -> None:
    flight = flown(1)
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    outputs = feed(stage, flight.frames)
    reckoned = flight.vehicle.initial
    for output, (_, increment) in zip(outputs, flight.frames, strict=True):
        if increment is not None:
            reckoned = advance(reckoned, increment, flight.vehicle.scenario.imu_config)
        np.testing.assert_array_equal(output.dead_reckoning.covariance, reckoned.covariance)
    at_epochs = [output.joint for output in outputs if output.joint is not None]
    assert len(at_epochs) == 3  # 3.2 s from a whole second on
    assert (at_epochs[0].vehicle, at_epochs[0].session) == ("uav1", 3)


def test_only_the_first_start_state_counts(flown) -> None:
    flight = flown(1)
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    stage.start(flown(2).vehicle.initial)
    assert stage.initial is flight.vehicle.initial


def test_in_flight_the_held_frames_come_out_together_from_the_first_on(flown) -> None:
    flight = flown(1)
    stage = make(flight, start=IN_FLIGHT)
    counts = [len(feed(stage, [frame])) for frame in flight.frames]
    assert counts == [0] * 8 + [9] + [1] * (len(flight.frames) - 9)
    assert stage.initial is not None
    assert stage.initial.state.stamp_ns == flight.frames[0][0].stamp_ns
    assert stage.dropped == {"before_start": 0, "frame_lost": 0, "without_motion": 0}


def test_in_flight_frames_that_are_held_back_or_slid_over_count_as_before_the_start(flown) -> None:
    flight = flown(1)
    stage = make(flight, start=IN_FLIGHT)
    blind = [(type(features).empty(features.stamp_ns), increment) for features, increment in flight.frames[:12]]
    assert feed(stage, blind) == []
    assert stage.dropped["before_start"] == 12
    assert "are found again in later frames" in stage.missing_start
    outputs = feed(stage, flight.frames[12:])
    assert stamps(outputs) == [features.stamp_ns for features, _ in flight.frames[12:]]
    assert stage.dropped["before_start"] == 12


@pytest.mark.parametrize("first", [0, 3])
def test_in_flight_a_frame_from_before_the_first_motion_is_dropped(flown, first: int) -> None:
    """An INS that came up late: its first increment begins at a later image than the first one seen."""
    flight = flown(1)
    stage = make(flight, start=IN_FLIGHT)
    for features, _ in flight.frames[: first + 1]:
        stage.add_features(features)
    outputs = feed(stage, flight.frames[first + 1 :])
    assert stamps(outputs) == [features.stamp_ns for features, _ in flight.frames[first:]]
    assert stage.dropped["before_start"] == first


def test_a_filter_that_begins_anew_is_warned_of(flown) -> None:
    flight = flown(1)
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    assert [o.warnings for o in feed(stage, flight.frames[:8])] == [()] * 8
    stage._backend._filter.belief.Y[3, 3] = -1.0
    outputs = feed(stage, flight.frames[8:12])
    assert [len(o.warnings) for o in outputs] == [1, 0, 0, 0]
    assert "begins anew" in outputs[0].warnings[0]
    assert "not positive definite" in outputs[0].warnings[0]
