# SPDX-License-Identifier: Apache-2.0
"""Frames are processed in order once rig and start state are known."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from fed_stage import feed

from uav_vslam.config import RigConfig, StartConfig, VehicleConfig
from uav_vslam.config.vehicle import OutputFramesConfig
from uav_vslam.errors import FilterDivergence, MapError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.preintegrator import advance
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.frame_queue import MAX_WAITING
from uav_vslam.slam.rig_monitor import RigMonitor
from uav_vslam.slam.saved_map import MapOrigin, SavedMap, save_map
from uav_vslam.slam.stage import SlamStage

IN_FLIGHT = StartConfig(method="in_flight")


def make(flight, *, start: StartConfig | None = None, rig: bool = True) -> SlamStage:
    config = VehicleConfig(imu=flight.vehicle.scenario.imu_config, start=start or StartConfig())
    stage = SlamStage(config, vehicle="uav1", session=3)
    stage.rig = flight.vehicle.rig if rig else None
    return stage


def test_an_empty_map_is_refused_wherever_it_comes_from(tmp_path: Path) -> None:
    empty, file = SavedMap(MapOrigin("uav2", 1, frame="uav2/map", stamp_ns=0)), tmp_path / "empty.npz"
    save_map(empty, file)
    with pytest.raises(MapError, match="has no landmarks to start in"):
        SlamStage(VehicleConfig(start=StartConfig(method="map", map=str(file))), vehicle="uav1")
    with pytest.raises(MapError, match="has no landmarks to start in"):
        SlamStage(VehicleConfig(start=StartConfig(method="map")), vehicle="uav1").load_map(empty)


def stamps(outputs: list[FrameOutput]) -> list[int]:
    return [output.report.pose.stamp_ns for output in outputs]


@pytest.mark.parametrize("missing", ["rig", "start", "both"])
def test_frames_and_motion_that_no_longer_wait_are_counted_by_what_they_waited_for(flown, missing: str) -> None:
    flight, later = flown(1), 7
    stage = make(flight, rig=missing == "start")
    if missing == "rig":
        stage.start(flight.vehicle.initial)
    features, increment = flight.frames[1]
    for number in range(MAX_WAITING + later):
        by_ns = 50_000_000 * number
        stage.add_features(dataclasses.replace(features, stamp_ns=features.stamp_ns + by_ns))
        ends = {"start_ns": increment.start_ns + by_ns, "stamp_ns": increment.stamp_ns + by_ns}
        stage.add_increment(dataclasses.replace(increment, **ends))
        assert list(stage.run()) == []
    reason = "before_start" if missing == "start" else "before_rig"
    assert stage.dropped == {**dict.fromkeys(stage.dropped, 0), reason: later, f"motion_{reason}": later}


def test_frames_wait_for_the_rig_and_the_start_state(flown) -> None:
    flight = flown(1)
    stage = make(flight, rig=False)
    assert feed(stage, flight.frames[:6]) == []
    stage.rig = flight.vehicle.rig
    assert list(stage.run()) == []
    assert stage.missing_start == "none was received"
    stage.start(flight.vehicle.initial)
    late = list(stage.run())
    assert stage.missing_start == ""
    ready = make(flight)
    ready.start(flight.vehicle.initial)
    for a, b in zip(late, feed(ready, flight.frames[:6]), strict=True):
        assert a.report.pose.covariance.tobytes() == b.report.pose.covariance.tobytes()
        assert a.dead_reckoning.covariance.tobytes() == b.dead_reckoning.covariance.tobytes()


def test_dead_reckoning_is_output_always_and_joint_information_at_epochs(flown) -> None:
    flight = flown(1)
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    outputs = feed(stage, flight.frames)
    dead_reckoned = flight.vehicle.initial
    for output, (_, increment) in zip(outputs, flight.frames, strict=True):
        if increment is not None:
            dead_reckoned = advance(dead_reckoned, increment, flight.vehicle.scenario.imu_config)
        np.testing.assert_array_equal(output.dead_reckoning.covariance, dead_reckoned.covariance)
    at_epochs = [output.joint for output in outputs if output.joint is not None]
    assert len(at_epochs) == 3  # 3.2 s from a whole second on
    assert (at_epochs[0].vehicle, at_epochs[0].session) == ("uav1", 3)


def test_no_other_start_state_counts_once_a_frame_was_processed(flown) -> None:
    flight = flown(1)
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    feed(stage, flight.frames[:1])
    stage.start(flown(2).vehicle.initial)
    assert stage.initial is flight.vehicle.initial


def test_a_start_state_without_a_stamp_is_replaced_by_another(flown) -> None:
    """The INS refuses it and makes no increment from it, so the back end waits for the next one, too."""
    flight = flown(1)
    stage = make(flight)
    initial = flight.vehicle.initial
    stage.start(dataclasses.replace(initial, state=dataclasses.replace(initial.state, stamp_ns=0)))
    assert feed(stage, flight.frames[:1]) == []
    stage.start(initial)
    outputs = feed(stage, flight.frames[1:])
    assert stamps(outputs) == [f.stamp_ns for f, _ in flight.frames]
    assert not any(stage.dropped.values())


def test_in_flight_the_buffered_frames_are_processed_together(flown) -> None:
    flight = flown(1)
    stage = make(flight, start=IN_FLIGHT)
    counts = [len(feed(stage, [frame])) for frame in flight.frames]
    assert counts == [0] * 8 + [9] + [1] * (len(flight.frames) - 9)
    assert stage.initial is not None
    assert stage.initial.state.stamp_ns == flight.frames[0][0].stamp_ns
    assert not any(stage.dropped.values())


def test_in_flight_a_gyro_bias_beyond_its_sigma_is_warned_of_once_and_the_filter_consistent(flown) -> None:
    flight = flown(1, frames=48)
    stage = make(flight, start=IN_FLIGHT)
    outputs = feed(stage, flight.with_gyro_bias([0.02, -0.015, 0.01]))
    assert len(outputs) == len(flight.frames)
    assert ["imu.gyro_bias_sigma" in " ".join(output.warnings) for output in outputs] == [True] + [False] * 47
    bias = outputs[-1].report.nav.state.gyro_bias - flight.vehicle.imu.gyro_bias[-1]
    sigma = np.sqrt(np.diag(outputs[-1].report.nav.covariance)[9:12])
    np.testing.assert_array_less(np.abs(bias - [0.02, -0.015, 0.01]), 4.0 * sigma)


def test_in_flight_buffered_or_dropped_frames_count_as_before_the_start(flown) -> None:
    flight = flown(1)
    stage = make(flight, start=IN_FLIGHT)
    blind = [(type(features).empty(features.stamp_ns), increment) for features, increment in flight.frames[:12]]
    assert feed(stage, blind) == []
    assert stage.dropped["before_start"] == 12
    assert "are matched in the next frames" in stage.missing_start
    outputs = feed(stage, flight.frames[12:])
    assert stamps(outputs) == [features.stamp_ns for features, _ in flight.frames[12:]]
    assert stage.dropped["before_start"] == 12


@pytest.mark.parametrize("first", [0, 3])
def test_in_flight_a_frame_from_before_the_first_motion_is_dropped(flown, first: int) -> None:
    """An INS that started late: its first increment starts after the first image."""
    flight = flown(1)
    stage = make(flight, start=IN_FLIGHT)
    for features, _ in flight.frames[: first + 1]:
        stage.add_features(features)
    outputs = feed(stage, flight.frames[first + 1 :])
    assert stamps(outputs) == [features.stamp_ns for features, _ in flight.frames[first:]]
    assert stage.dropped["before_start"] == first


def test_a_reinitialised_filter_is_reported(flown) -> None:
    flight = flown(1)
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    assert [o.warnings for o in feed(stage, flight.frames[:8])] == [()] * 8
    stage._flight.backend._filter.belief.Y[3, 3] = -1.0
    outputs = feed(stage, flight.frames[8:12])
    assert [len(o.warnings) for o in outputs] == [1, 0, 0, 0]
    assert "re-initialised" in outputs[0].warnings[0]
    assert "not positive definite" in outputs[0].warnings[0]


def test_an_estimate_that_proves_indefinite_at_an_epoch_costs_a_recovery_and_no_frame(flown, monkeypatch) -> None:
    flight = flown(1)
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    outputs = feed(stage, flight.frames[:10])
    before = type(stage._flight.backend._filter).pose_landmark_information
    failures = [FilterDivergence("information is not positive definite")]

    def fail_once(self) -> np.ndarray:
        if failures:
            raise failures.pop()
        return before(self)

    monkeypatch.setattr(type(stage._flight.backend._filter), "pose_landmark_information", fail_once)
    outputs += feed(stage, flight.frames[10:])
    assert stamps(outputs) == [f.stamp_ns for f, _ in flight.frames]
    (lost,) = [o for o in outputs if o.report.recovery]
    assert "not positive definite" in lost.warnings[0]
    assert lost.joint is not None
    assert len(lost.joint.ids) == lost.report.landmarks > 0
    assert outputs[-1].report.associated > 10


def position_error_m(flight, output: FrameOutput) -> float:
    pose = output.report.pose
    return float(np.linalg.norm(pose.T_map_body.t - flight.vehicle.true_state(pose.stamp_ns).T_map_body.t))


def sigma_m(output: FrameOutput) -> float:
    return float(np.sqrt(np.trace(output.report.pose.covariance[:3, :3])))


def test_a_lost_increment_costs_no_frame(flown) -> None:
    """Its points have no tracks to show the motion, so the frame coasts; then the map corrects it."""
    flight, lost = flown(1), 12
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    outputs = feed(stage, [(f, None if k == lost else i) for k, (f, i) in enumerate(flight.frames)])
    assert stamps(outputs) == [f.stamp_ns for f, _ in flight.frames]
    assert stage.dropped == {**dict.fromkeys(stage.dropped, 0), "motion_lost": 1}
    assert [output.report.coasted for output in outputs[1:]] == [k == lost for k in range(1, len(outputs))]
    before, after = outputs[lost - 1].dead_reckoning, outputs[lost].dead_reckoning
    assert np.trace(after.covariance[:3, :3]) > np.trace(before.covariance[:3, :3])
    assert [o.dead_reckoning.state.stamp_ns for o in outputs] == stamps(outputs)
    assert not any(o.report.recovery for o in outputs)
    assert position_error_m(flight, outputs[-1]) < 0.6  # as of flights without a loss


def test_a_late_back_end_continues_from_the_start_state_with_large_uncertainty(flown) -> None:
    """The first increments are lost, but every later frame has odometry."""
    flight, late = flown(1), 14
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    outputs = feed(stage, flight.frames[late:])
    assert stamps(outputs) == [f.stamp_ns for f, _ in flight.frames[late:]]
    assert stage.dropped == {**dict.fromkeys(stage.dropped, 0), "motion_lost": 1}
    assert sigma_m(outputs[0]) > position_error_m(flight, outputs[0])
    assert outputs[-1].report.associated > 10


def test_a_repeated_increment_stops_nothing(flown) -> None:
    flight = flown(1)
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    feed(stage, flight.frames[:6])
    stage.add_increment(flight.frames[5][1])
    outputs = feed(stage, flight.frames[6:])
    assert len(outputs) == len(flight.frames) - 6
    assert stage.dropped == {**dict.fromkeys(stage.dropped, 0), "motion_refused": 1}


@pytest.mark.parametrize(("start", "first_counts"), [(StartConfig(), False), (IN_FLIGHT, True)])
def test_a_later_start_counts_only_where_none_is_searched_for(flown, start: StartConfig, first_counts: bool) -> None:
    flight = flown(1)
    stage, first = make(flight, start=start), flight.vehicle.initial
    second = dataclasses.replace(first, covariance=2.0 * first.covariance)
    stage.start(first)
    stage.start(second)
    assert stage.initial is (first if first_counts else second)


def test_a_rig_is_not_judged_before_the_start_is_trusted(flown) -> None:
    flight = flown(1)
    stage, right = make(flight, rig=False), flight.vehicle.rig.T_body_right
    turned = Pose(right.R @ so3_exp([np.deg2rad(0.3), 0.0, 0.0]), right.t)
    stage.rig = dataclasses.replace(flight.vehicle.rig, T_body_right=turned)
    stage.start(flight.vehicle.initial)
    outputs = feed(stage, flight.frames)
    monitor = RigMonitor(RigConfig())
    (contradiction,) = filter(None, (monitor.add(output.report) for output in outputs))
    assert contradiction not in [text for output in outputs for text in output.warnings]


def test_in_flight_a_lost_increment_restarts_the_initialisation(flown) -> None:
    """Unknown motion says nothing about gravity: it is not bridged before there is a start."""
    flight = flown(1)
    stage = make(flight, start=IN_FLIGHT)
    outputs = feed(stage, [(f, None if k == 3 else i) for k, (f, i) in enumerate(flight.frames)])
    assert stage.dropped["motion_lost"] == 0
    assert stamps(outputs)[0] == flight.frames[3][0].stamp_ns


def test_dead_reckoning_misses_no_step_where_the_filter_fails(flown, monkeypatch) -> None:
    flight, failing = flown(1), 6
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    feed(stage, flight.frames[:failing])

    def fail(*_) -> None:
        raise ValueError("broken")

    with monkeypatch.context() as patch:
        patch.setattr(stage._flight.backend, "process", fail)
        with pytest.raises(ValueError, match="broken"):
            feed(stage, [flight.frames[failing]])
    outputs = feed(stage, flight.frames[failing + 1 :])
    assert len(outputs) == len(flight.frames) - failing - 1
    dead_reckoned = flight.vehicle.initial
    for _, increment in flight.frames[1:]:
        dead_reckoned = advance(dead_reckoned, increment, flight.vehicle.scenario.imu_config)
    np.testing.assert_array_equal(outputs[-1].dead_reckoning.covariance, dead_reckoned.covariance)
    assert stage.dropped["motion_lost"] == 1


def test_the_quality_of_a_frame_counts_the_tracks_of_the_one_before(flown) -> None:
    flight = flown(1)
    numbers = [(1, 2, 3, 4), (3, 4, 5), (0, 0, 3), (), (3,)]
    frames = [
        (dataclasses.replace(features.chosen(np.arange(len(ids))), tracks=np.array(ids, np.uint32)), increment)
        for (features, increment), ids in zip(flight.frames, numbers, strict=False)
    ]
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    assert [output.quality.tracked for output in feed(stage, frames)] == [0, 2, 1, 0, 0]


def test_the_quality_of_a_frame_is_that_of_its_report(flown) -> None:
    stage = make(flown(1))
    stage.start(flown(1).vehicle.initial)
    first, *others = feed(stage, flown(1).frames)
    assert (first.quality.coasted, first.quality.dof) == (False, 0)  # at the start state: nothing to coast through
    for output in others:
        innovation, quality = output.report.innovation, output.quality
        assert innovation is not None
        assert (quality.nis, quality.dof) == (innovation.nis, innovation.dof)
        assert quality.associated == output.report.associated == quality.dof // 4
        assert (quality.stamp_ns, quality.coasted, quality.restarted) == (output.report.pose.stamp_ns, False, False)


@pytest.mark.parametrize("keep_map", [True, False])
@pytest.mark.parametrize(("frame", "expected"), [("", "uav1/map"), ("site/map", "site/map")])
def test_a_saved_map_names_the_frame_that_the_setting_names(keep_map: bool, frame: str, expected: str) -> None:
    config = VehicleConfig(frames=OutputFramesConfig(map=frame))
    assert SlamStage(config, vehicle="uav1", keep_map=keep_map).mapped().origin.frame == expected


@pytest.mark.parametrize(("seed", "first", "lost"), [(1, 3, 20), (3, 8, 20), (4, 3, 10)])
def test_a_start_is_not_blamed_for_an_unknown_motion(flown, seed: int, first: int, lost: int) -> None:
    """What follows it is far from what the start predicts; seed 4 sees seven landmarks in a line at first."""
    flight = flown(seed, frames=60)
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    outputs = feed(stage, [*flight.frames[:first], *flight.frames[first + lost :]])
    assert [text for output in outputs for text in output.warnings] == []


@pytest.mark.parametrize("unknown", [False, True])
def test_a_rig_is_not_blamed_for_an_unknown_motion(flown, unknown: bool) -> None:
    flight = flown(1, frames=60)
    right = flight.vehicle.rig.T_body_right
    turned = Pose(right.R @ so3_exp([np.deg2rad(0.3), 0.0, 0.0]), right.t)
    stage = make(flight, rig=False)
    stage.rig = dataclasses.replace(flight.vehicle.rig, T_body_right=turned)
    stage.start(flight.vehicle.initial)
    told = [text for output in feed(stage, flight.frames[:1]) for text in output.warnings]
    stage._flight._start_watch.stop(0)  # as for a start that was accepted
    told += [text for output in feed(stage, flight.frames[7 if unknown else 1 :]) for text in output.warnings]
    assert any("contradicts the calibration" in text for text in told) == (not unknown)


def test_images_beside_the_stamps_of_their_camera_info_are_told(flown) -> None:
    flight = flown(1)
    stage = make(flight)
    stage.start(flight.vehicle.initial)
    feed(stage, flight.frames[:3])
    late = [
        (dataclasses.replace(features, stamp_ns=features.stamp_ns + 1_000_000), up) for features, up in flight.frames
    ]
    feed(stage, late[3:9])
    assert stage.unpaired == ""
    feed(stage, late[9:20])
    assert "+1.000 ms" in stage.unpaired
    feed(stage, flight.frames[20:24])
    assert stage.unpaired == ""
