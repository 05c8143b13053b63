# SPDX-License-Identifier: Apache-2.0
"""Whole flights without ROS over jumps of the clock and silences: never over-confident, and the fault is named."""

import copy
import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import pytest
from flown_copy import copy_of
from position_nees import position_nees

from uav_vslam.config import InputConfig, VehicleConfig
from uav_vslam.errors import BagError
from uav_vslam.pipeline import VehiclePipeline, VehicleTrack
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.types import NS_PER_S, ImuSample, StereoFeatures

Event = ImuSample | StereoFeatures
AFTER_S, FRAMES = 4.0, 58  # when it happens, of 8.1 s
SEEDS = (1, 2, 3)


@functools.cache
def recorded(seed: int) -> tuple[SimulatedVehicle, tuple[Event, ...], int]:
    """Return a vehicle, its sensor data in stamp order, and the stamp at which it happens [ns]."""
    (vehicle,) = simulate_fleet(dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, vehicles=1, seed=seed))
    events = tuple(SimulatedSource(vehicle, scatter_landmarks([vehicle])).iter_events())
    return vehicle, events, events[0].stamp_ns + round(AFTER_S * NS_PER_S)


def moved(event: Event, offset_s: float) -> Event:
    return dataclasses.replace(event, stamp_ns=event.stamp_ns + round(offset_s * NS_PER_S))


def ready(vehicle: SimulatedVehicle, policy: str) -> VehiclePipeline:
    """Return a pipeline that has had no sensor data yet."""
    config = VehicleConfig(imu=vehicle.scenario.imu_config, input=InputConfig(on_time_jump=policy))
    return VehiclePipeline(vehicle.initial, rig=vehicle.rig, config=config, vehicle="uav1")


@functools.cache
def flown_until_it_happens(seed: int, policy: str) -> tuple[VehiclePipeline, tuple[Event, ...]]:
    """Return a pipeline and the sensor data that it has had; flights that begin alike go on with a copy of it."""
    vehicle, events, at_ns = recorded(seed)
    pipeline, had = ready(vehicle, policy), tuple(event for event in events if event.stamp_ns < at_ns)
    for event in had:
        if isinstance(event, ImuSample):
            pipeline.add_imu(event)
        else:
            pipeline.add_frame(event)
    return pipeline, had


def fly(vehicle: SimulatedVehicle, events: Sequence[Event], policy: str = "bridge") -> VehicleTrack:
    pipeline, had = flown_until_it_happens(vehicle.scenario.seed, policy)
    if all(a is b for a, b in zip(events, had, strict=False)):
        unused, stage = pipeline._frontend, pipeline._slam
        copied = {id(unused): unused, id(stage): copy_of(stage)}  # no images; OpenCV's detectors can't be copied
        pipeline, events = copy.deepcopy(pipeline, copied), events[len(had) :]
    else:
        pipeline = ready(vehicle, policy)
    for _ in pipeline.run(events):
        pass
    return pipeline.track


def nees(vehicle: SimulatedVehicle, track: VehicleTrack, *, after_ns: int, offset_s: float = 0.0) -> list[float]:
    """Return the position NEES per axis of each frame; stamps after one are off by an offset."""
    found = []
    for pose in track.poses:
        true_ns = pose.stamp_ns - round(offset_s * NS_PER_S) if pose.stamp_ns > after_ns else pose.stamp_ns
        found.append(position_nees(pose, vehicle.true_state(true_ns)))
    return found


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("leap_s", [3.0, 10.0])
def test_a_clock_that_was_set_ahead_costs_no_frame_and_no_consistency(seed: int, leap_s: float) -> None:
    vehicle, events, at_ns = recorded(seed)
    track = fly(vehicle, [moved(e, leap_s) if e.stamp_ns > at_ns else e for e in events])
    assert len(track.outputs) == FRAMES
    assert max(nees(vehicle, track, after_ns=at_ns, offset_s=leap_s)) <= 3.0
    assert any("the clock of IMU and image jumped by +10.1 s" in text for text in track.warnings) == (leap_s > 5.0)
    assert not any("calibration" in text for text in track.warnings)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("silent", [(ImuSample,), (ImuSample, StereoFeatures)])
def test_a_silence_of_three_seconds_is_an_unknown_motion(seed: int, silent: tuple[type, ...]) -> None:
    """On average: the first updates after it, at an attitude that is off by a radian, may claim too much."""
    vehicle, events, at_ns = recorded(seed)
    gap = range(at_ns, at_ns + 3 * NS_PER_S)
    track = fly(vehicle, [e for e in events if not (isinstance(e, silent) and e.stamp_ns in gap)])
    before = sum(output.report.pose.stamp_ns <= at_ns for output in track.outputs)
    assert np.mean(nees(vehicle, track, after_ns=at_ns)[before:]) <= 3.0
    assert not any("calibration" in text for text in track.warnings)


@pytest.mark.parametrize("seed", SEEDS)
def test_nine_of_ten_readings_lost_at_random_cost_no_consistency(seed: int) -> None:
    vehicle, events, at_ns = recorded(seed)
    rng = np.random.default_rng(seed)
    track = fly(vehicle, [e for e in events if not isinstance(e, ImuSample) or rng.random() >= 0.9])
    assert np.mean(nees(vehicle, track, after_ns=at_ns)) <= 3.0


@pytest.mark.parametrize("kind", [ImuSample, StereoFeatures])
@pytest.mark.parametrize("offset_s", [-10.0, 10.0])
def test_the_clock_of_one_sensor_alone_is_refused_while_it_is_wrong(kind: type, offset_s: float) -> None:
    vehicle, events, at_ns = recorded(1)
    wrong = range(at_ns, at_ns + 2 * NS_PER_S)
    changed = [moved(e, offset_s) if isinstance(e, kind) and e.stamp_ns in wrong else e for e in events]
    track = fly(vehicle, changed)
    assert track.dropped["stamp_jump"] == sum(a is not b for a, b in zip(changed, events, strict=True))
    assert np.mean(nees(vehicle, track, after_ns=at_ns)) <= 3.0
    assert track.outputs[-1].report.pose.stamp_ns == vehicle.frame_stamps_ns[-1]


NAMES = {ImuSample: "IMU", StereoFeatures: "image"}


@pytest.mark.parametrize("kind", [ImuSample, StereoFeatures])
@pytest.mark.parametrize("offset_s", [-3.0, -1.0, -0.3, -0.05, 0.05, 0.3, 1.0, 3.0])
def test_the_clock_of_one_sensor_alone_that_is_set_by_a_little_is_named_and_costs_no_consistency(
    kind: type, offset_s: float
) -> None:
    """Images are paired with the motion of another time otherwise: NEES of 60 to 10000."""
    vehicle, events, at_ns = recorded(1)
    track = fly(vehicle, [moved(e, offset_s) if isinstance(e, kind) and e.stamp_ns > at_ns else e for e in events])
    assert max(nees(vehicle, track, after_ns=at_ns)) <= 3.0
    (warning,) = track.warnings
    assert warning.startswith(f"{NAMES[kind]} stamps jump by {offset_s:+.2f} s")
    assert track.dropped["stamp_jump"] >= sum(isinstance(e, kind) and e.stamp_ns > at_ns for e in events) - 1


@pytest.mark.parametrize("kind", [ImuSample, StereoFeatures])
@pytest.mark.parametrize("offset_s", [-1.0, -0.05, 0.05, 1.0])
def test_it_is_used_again_when_its_clock_is_right_again(kind: type, offset_s: float) -> None:
    vehicle, events, at_ns = recorded(1)
    wrong = range(at_ns, at_ns + 2 * NS_PER_S)
    changed = [moved(e, offset_s) if isinstance(e, kind) and e.stamp_ns in wrong else e for e in events]
    track = fly(vehicle, changed)
    refused = sum(a is not b for a, b in zip(changed, events, strict=True))
    assert refused - 1 <= track.dropped["stamp_jump"] <= refused + 1
    assert np.mean(nees(vehicle, track, after_ns=at_ns)) <= 3.0
    assert track.outputs[-1].report.pose.stamp_ns == vehicle.frame_stamps_ns[-1]


@pytest.mark.parametrize("kind", [ImuSample, StereoFeatures])
@pytest.mark.parametrize("lost_s", [0.05, 0.3, 1.0])
def test_readings_and_images_that_are_merely_lost_are_no_clock(kind: type, lost_s: float) -> None:
    vehicle, events, at_ns = recorded(1)
    lost = range(at_ns, at_ns + round(lost_s * NS_PER_S))
    track = fly(vehicle, [e for e in events if not (isinstance(e, kind) and e.stamp_ns in lost)])
    assert not track.dropped
    assert not track.warnings
    assert len(track.outputs) == FRAMES - (kind is StereoFeatures) * sum(
        s in lost for s in vehicle.frame_stamps_ns.tolist()
    )


@pytest.mark.parametrize("seed", [1, 7])
def test_a_second_without_readings_costs_no_consistency(seed: int) -> None:
    """Of the landmarks, few are still in view, on one side of the image: they fit a tilt as well as a shift."""
    vehicle, events, at_ns = recorded(seed)
    lost = range(at_ns, at_ns + NS_PER_S)
    track = fly(vehicle, [e for e in events if not (isinstance(e, ImuSample) and e.stamp_ns in lost)])
    before = sum(output.report.pose.stamp_ns < lost.stop for output in track.outputs)
    assert np.mean(nees(vehicle, track, after_ns=at_ns)[before:]) <= 3.0


@pytest.mark.parametrize(("policy", "jump_s"), [("bridge", -10.0), ("bridge", 60.0), ("reset", 10.0)])
def test_a_recording_of_another_flight_ends_with_the_reason(policy: str, jump_s: float) -> None:
    vehicle, events, at_ns = recorded(1)
    with pytest.raises(BagError, match=r"the clock of IMU and image jumped by .* another flight"):
        fly(vehicle, [moved(e, jump_s) if e.stamp_ns > at_ns else e for e in events], policy)


def test_refused_stamps_are_counted_and_the_flight_goes_on() -> None:
    vehicle, events, at_ns = recorded(1)
    wrong = range(at_ns, at_ns + 2 * NS_PER_S)
    track = fly(vehicle, [moved(e, -10.0) if e.stamp_ns in wrong else e for e in events], "refuse")
    assert track.dropped["stamp_jump"] == sum(e.stamp_ns in wrong for e in events)
    said = [text.partition(" stamps jump by ")[0] for text in track.warnings if " stamps jump by " in text]
    assert sorted(said) == ["IMU", "image"]  # once each
    assert len(track.outputs) == FRAMES - sum(stamp_ns in wrong for stamp_ns in vehicle.frame_stamps_ns.tolist())
