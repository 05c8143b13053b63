# SPDX-License-Identifier: Apache-2.0
"""Cameras that expose one row after another: undone where it is configured, measured and named where it is not."""

import dataclasses
import pickle
import re

import numpy as np
import pytest
from fed_stage import feed

from uav_vslam.config import RigConfig, StartConfig
from uav_vslam.offline.track import _last_outputs, track_vehicle
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.landmarks import LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.first_frames import AGAIN, READOUT
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.rolling_shutter import exposed_at_once
from uav_vslam.slam.shutter_monitor import ShutterMonitor
from uav_vslam.slam.slam_flight import SlamFlight, Timing
from uav_vslam.types import PoseEstimate

PX = 0.05
NAMED = "the rows of an image are exposed one after another"


def named(outputs: list[FrameOutput]) -> list[str]:
    return [text for output in outputs for text in output.warnings if NAMED in text]


def mean_error(flight, poses: list[PoseEstimate]) -> float:
    """Return the mean position error [m]."""
    true = [flight.vehicle.true_state(pose.stamp_ns).T_map_body.t for pose in poses]
    return float(np.linalg.norm([pose.T_map_body.t for pose in poses] - np.array(true), axis=1).mean())


def add(monitor: ShutterMonitor, flight, k: int) -> str:
    """Add a frame at the true states."""
    features, increment = flight.frames[k]
    before, now = (flight.vehicle.true_state(ns) for ns in (increment.start_ns, increment.stamp_ns))
    return monitor.add(features, before, now, increment, flight.vehicle.rig)


@pytest.mark.parametrize("readout_s", [0.02, -0.02])
def test_points_are_where_a_global_shutter_shows_them(flown, readout_s: float) -> None:
    flight = flown(3, frames=24, tracked_px=1e-6)
    vehicle, landmarks = flight.vehicle, scatter_landmarks([flight.vehicle])
    shown = observe(vehicle, landmarks, noise=LandmarkNoise(sigma_px=1e-6, readout_s=readout_s))
    at_once = observe(vehicle, landmarks, noise=LandmarkNoise(sigma_px=1e-6))
    off, left = [], []
    for (rolled, seen), (right, truly), (_, increment) in zip(shown, at_once, flight.frames, strict=True):
        if increment is None:
            continue
        nav = vehicle.true_state(rolled.stamp_ns)
        undone = exposed_at_once(rolled, nav, increment, rig=vehicle.rig, readout_s=readout_s)
        _, rows, others = np.intersect1d(seen, truly, return_indices=True)
        off.append(np.abs(rolled.pixels[rows] - right.pixels[others]))
        left.append(np.abs(undone.pixels[rows] - right.pixels[others]))
    assert np.percentile(np.vstack(off), 95) > 3.0
    assert np.percentile(np.vstack(left), 95) < 0.08  # gusts after the stamp
    assert np.vstack(left).max() < 0.2


def test_a_global_shutter_costs_nothing_and_the_first_frame_of_a_rolling_one_is_not_used(flown) -> None:
    flight = flown(3, frames=24, tracked_px=PX)
    features, nav = flight.frames[0][0], flight.vehicle.initial.state
    assert exposed_at_once(features, nav, None, rig=flight.vehicle.rig, readout_s=0.0) is features
    first = exposed_at_once(features, nav, None, rig=flight.vehicle.rig, readout_s=0.01)
    assert (len(first), first.stamp_ns) == (0, features.stamp_ns)


@pytest.mark.slow
def test_a_known_readout_costs_next_to_nothing(flown) -> None:
    nees = []
    for seed, readout_s in ((1, 0.01), (2, 0.02), (3, -0.015)):
        flight = flown(seed, frames=36, tracked_px=PX, readout_s=readout_s)
        found = feed(flight.tracking_stage(PX, readout_s=readout_s), flight.frames)
        right = flown(seed, frames=36, tracked_px=PX)
        assert not any(output.warnings or output.report.recovery for output in found)
        assert not any(output.report.coasted for output in found[2:])  # the second frame is the first one used
        errors, of_flight = flight.errors_and_nees(found)
        of_global = right.errors_and_nees(feed(right.tracking_stage(PX), right.frames))[0]
        assert errors[-1] < 1.5 * of_global[-1] + 0.2
        nees.append(of_flight.mean())
    assert np.mean(nees) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "readout_s"), [(1, 0.003), (2, 0.01), (3, 0.02), (4, 0.02)])
def test_a_readout_that_is_not_configured_is_measured_and_named(flown, seed: int, readout_s: float) -> None:
    """Even where it leads the filter astray meanwhile."""
    flight = flown(seed, frames=24, tracked_px=PX, readout_s=readout_s)
    (warning,) = named(feed(flight.tracking_stage(PX), flight.frames))
    found_ms, sigma_ms = map(float, re.search(r"last one (\S+) ms ± (\S+) ms after the first", warning).groups())
    assert sigma_ms < 0.25
    assert found_ms == pytest.approx(1e3 * readout_s, rel=0.02, abs=4.0 * sigma_ms)
    assert f"set that to {1e-3 * found_ms:.5f};" in warning


@pytest.mark.parametrize("configured_s", [0.0, 0.009])
def test_what_has_been_measured_is_used_from_the_start_on(flown, configured_s: float) -> None:
    flight = flown(2, frames=24, tracked_px=PX, readout_s=0.01)
    right = feed(flight.tracking_stage(PX, readout_s=0.01), flight.frames)
    outputs = feed(flight.tracking_stage(PX, readout_s=configured_s), flight.frames)
    (at,) = (k for k, output in enumerate(outputs) if output.report.recovery == AGAIN.format(READOUT))
    assert f"the filter was re-initialised: {AGAIN.format(READOUT)}" in outputs[at].warnings
    assert not any(output.warnings or output.report.coasted for output in outputs[at + 1 :])
    assert [output.report.pose.stamp_ns for output in outputs[at].earlier] == [
        output.report.pose.stamp_ns for output in outputs[:at]
    ]
    errors, nees = flight.errors_and_nees(outputs)
    of_right = flight.errors_and_nees(right)[0]
    assert errors[-1] < 1.1 * of_right[-1] + 0.05
    assert nees[at:].mean() < 1.5
    before, since = (
        {one for output in part for one in output.report.sightings[:, 0]} for part in (outputs[:at], outputs[at:])
    )
    assert before.isdisjoint(since)  # peers may know the landmarks that are given up


def test_of_frames_that_were_used_again_twice_the_last_outputs_are_smoothed(flown) -> None:
    flight = flown(2, frames=6, tracked_px=PX)
    first, second, third = (feed(flight.tracking_stage(PX), flight.frames) for _ in range(3))
    first[2] = dataclasses.replace(second[2], earlier=tuple(second[:2]))
    first[4] = dataclasses.replace(third[4], earlier=tuple(third[:4]))
    last = _last_outputs(VehicleTrack("uav1", outputs=first))
    assert [id(output) for output in last] == [id(output) for output in (*third[:4], *first[4:])]


def test_a_readout_that_explains_no_more_is_not_used(flown, monkeypatch) -> None:
    flight = flown(1, frames=24, tracked_px=PX)
    stage, right = flight.tracking_stage(PX), flight.tracking_stage(PX)
    expected = feed(right, flight.frames)
    monkeypatch.setattr(SlamFlight, "contradicting_timing", Timing(0.02, 0.0))
    for output, other in zip(feed(stage, flight.frames), expected, strict=True):
        assert output.readout_s == 0.0
        np.testing.assert_array_equal(output.report.pose.T_map_body.t, other.report.pose.T_map_body.t)
    (first,) = feed(stage.restarted(2, flight.vehicle.initial), flight.frames[:1])
    assert first.readout_s == 0.0


def test_live_settings_leave_what_has_been_measured_and_a_new_session_begins_with_it(flown) -> None:
    flight = flown(2, frames=24, tracked_px=PX, readout_s=0.01)
    stage = flight.tracking_stage(PX)
    config = stage._config
    feed(stage, flight.frames[:20])
    stage.configure(config)
    (*_, output) = feed(stage, flight.frames[20:])
    assert output.readout_s == pytest.approx(0.01, abs=5e-4)
    again = stage.restarted(2, flight.vehicle.initial)
    (output, *_) = feed(again, flight.frames[:2])
    assert output.readout_s == pytest.approx(0.01, abs=5e-4)


def test_a_flight_that_goes_on_from_a_checkpoint_is_not_flown_again(flown) -> None:
    flight = flown(2, frames=24, tracked_px=PX, readout_s=0.01)
    stage = flight.tracking_stage(PX)
    feed(stage, flight.frames[:6])
    outputs = feed(pickle.loads(pickle.dumps(stage)), flight.frames[6:])
    assert named(outputs)
    assert not any(output.report.recovery == AGAIN.format(READOUT) for output in outputs)


@pytest.mark.slow
@pytest.mark.parametrize("ratio_error", [0.0, 0.003, -0.003])
def test_a_global_shutter_is_not_suspected(flown, ratio_error: float) -> None:
    """Nor where a wrong focal length of the right camera changes the depths along the columns."""
    for seed in range(1, 9):
        flight = flown(seed, frames=24, tracked_px=PX, focal_ratio_bias=ratio_error)
        stage = flight.tracking_stage(PX)
        assert named(feed(stage, flight.frames)) == []
        assert not stage._flight._shutter.watching  # it has been judged


def test_a_pair_with_an_unknown_motion_does_not_count(flown) -> None:
    flight, monitor = flown(1, frames=24, tracked_px=PX), ShutterMonitor(RigConfig())
    for k in range(1, 9):
        add(monitor, flight, k)
    assert monitor._found.count == 7  # the first frame has none before
    monitor.begin(flight.frames[9][0])
    add(monitor, flight, 10)
    assert monitor._found.count == 8
    add(monitor, flight, 12)  # the one before is missing
    assert monitor._found.count == 8


def test_at_rest_nothing_is_measured(flown) -> None:
    flight, monitor = flown(1, frames=24, tracked_px=PX), ShutterMonitor(RigConfig())
    features, step = flight.frames[5]
    nav = dataclasses.replace(flight.vehicle.true_state(features.stamp_ns), v_map=np.zeros(3))
    still = dataclasses.replace(step, start_ns=step.stamp_ns, rate_start=nav.gyro_bias, rate_end=nav.gyro_bias)
    assert [monitor.add(features, nav, nav, still, flight.vehicle.rig) for _ in range(30)] == [""] * 30
    assert monitor._found.count == 0
    assert monitor.watching


@pytest.mark.parametrize(("seed", "readout_s"), [(11, 0.02), (13, -0.02)])
def test_a_start_in_flight_is_found(flown, seed: int, readout_s: float) -> None:
    flight = flown(seed, frames=30, tracked_px=PX, readout_s=readout_s)
    given = flight.tracking_stage(PX, readout_s=readout_s)._config
    config = dataclasses.replace(given, start=StartConfig(method="in_flight"))
    source = SimulatedSource(flight.vehicle, features=tuple(features for features, _ in flight.frames))
    track = track_vehicle(source, config)
    assert track.warnings == []
    assert len(track.outputs) == 30
    nav = track.outputs[-1].report.nav
    true = flight.vehicle.true_state(nav.state.stamp_ns)
    of_body, truly = (state.T_map_body.R.T @ state.v_map for state in (nav.state, true))
    assert np.linalg.norm(of_body - truly) < 0.3


@pytest.mark.slow
def test_the_smoothed_flight_uses_the_same_points(flown) -> None:
    flight = flown(5, frames=36, tracked_px=PX, readout_s=-0.02)
    config = flight.tracking_stage(PX, readout_s=-0.02)._config
    source = SimulatedSource(flight.vehicle, features=tuple(features for features, _ in flight.frames))
    track = track_vehicle(source, config, smoothing=True)
    assert not any("smoothed" in text for text in track.warnings)
    ignored = dataclasses.replace(config, rig=dataclasses.replace(config.rig, readout_s=0.0))
    assert mean_error(flight, track.smoothed) < 1.1 * mean_error(flight, track.poses)
    measured = track_vehicle(source, ignored, smoothing=True)
    assert mean_error(flight, measured.poses) > 1.5 * mean_error(flight, track.poses)  # the first frames
    assert mean_error(flight, measured.smoothed) < 1.1 * mean_error(flight, track.smoothed)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "readout_s", "late_s"), [(1, 0.02, -0.02), (7, 0.018, -0.015)])
def test_a_readout_is_found_beside_an_offset_of_the_clock(flown, seed: int, readout_s: float, late_s: float) -> None:
    """With both the filter is lost before ten frames, and its velocities scatter what pairs of frames show of one."""
    flight = flown(seed, frames=60, tracked_px=PX, readout_s=readout_s)
    outputs = feed(flight.tracking_stage(PX), flight.with_late_images(late_s))
    assert len(named(outputs)) == 1
    assert outputs[-1].readout_s == pytest.approx(readout_s, abs=0.004)
    assert outputs[-1].report.time_offset.mean_s == pytest.approx(-late_s, abs=0.002)
    errors, nees = flight.errors_and_nees(outputs[12:])
    assert errors[-1] < 3.0  # tens of metres where it is not found
    assert nees.mean() < 2.0
