# SPDX-License-Identifier: Apache-2.0
"""Whole simulated flights through the offline graph: repeatable, consistent, and better with peers than alone."""

import dataclasses
import functools
import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from position_nees import position_nees
from scipy.stats import chi2

from uav_vslam.config import BackendConfig, FusionConfig, StartConfig, VehicleConfig
from uav_vslam.evaluation.consistency import nees
from uav_vslam.evaluation.start_frame import in_start_frame
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.fleet import CooperativeTrack, cooperate
from uav_vslam.pipeline import VehiclePipeline, VehicleTrack
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, PoseEstimate, StereoFeatures

Array = NDArray[np.float64]

FRAMES = 40  # 5.5 s, 110 m
RUNS = 12  # of the consistency test
SEEDS_IN_FLIGHT = range(1, 7)

# A consistent filter's end NEES over 12 flights of 3 degrees of freedom each is chi-square with 36. The 99 % band of
# its mean is 0.50 to 1.71. Power: an over-confidence of 2.5 (sigmas too small by 1.6) is detected with 92 %, the
# thesis's model (27 here) always.
BAND = tuple(chi2.ppf([0.005, 0.995], 3 * RUNS) / (3 * RUNS))


def simulated(seed: int, *, vehicles: int = 1, frames: int = FRAMES) -> list[SimulatedSource]:
    scenario = dataclasses.replace(SCENARIOS["kagaru"], frames=frames, vehicles=vehicles, seed=seed)
    fleet = simulate_fleet(scenario)
    field = scatter_landmarks(fleet)
    return [SimulatedSource(vehicle, field) for vehicle in fleet]


def config_of(source: SimulatedSource, *, model: str = "ri15", **fusion: object) -> VehicleConfig:
    return VehicleConfig(
        imu=source.simulated.scenario.imu_config, backend=BackendConfig(model=model), fusion=FusionConfig(**fusion)
    )


def fly(source: SimulatedSource, config: VehicleConfig, events=None) -> VehicleTrack:
    pipeline = VehiclePipeline(source.initial_state, rig=source.rig, config=config, vehicle=source.vehicle)
    for _ in pipeline.run(source.iter_events() if events is None else events):
        pass
    return pipeline.track


def fly_fleet(seed: int, **fusion: object) -> tuple[list[SimulatedSource], dict[str, VehicleTrack], dict]:
    sources = simulated(seed, vehicles=2)
    configs = {s.vehicle: config_of(s, **fusion) for s in sources}
    tracks = {s.vehicle: fly(s, configs[s.vehicle]) for s in sources}
    return sources, tracks, cooperate(tracks, configs)


@functools.cache
def flown(
    seed: int = 1, mode: str = "wideband"
) -> tuple[list[SimulatedSource], dict[str, VehicleTrack], dict[str, CooperativeTrack]]:
    return fly_fleet(seed, mode=mode)


def position_error(vehicle: SimulatedVehicle, pose: PoseEstimate) -> Array:
    return np.asarray(vehicle.true_state(pose.stamp_ns).T_map_body.t - pose.T_map_body.t)


def end_nees(seed: int, model: str) -> float:
    (source,) = simulated(seed)
    pose = fly(source, config_of(source, model=model)).outputs[-1].report.pose
    return position_nees(pose, source.simulated.true_state(pose.stamp_ns))


@pytest.mark.slow
def test_the_default_model_is_consistent() -> None:
    mean = np.mean([end_nees(seed, "ri15") for seed in range(1, RUNS + 1)])
    assert BAND[0] < mean < BAND[1]


@pytest.mark.slow
def test_the_thesis_model_is_overconfident() -> None:
    mean = np.mean([end_nees(seed, "euler9") for seed in range(1, RUNS // 2 + 1)])
    assert mean > 3 * BAND[1]


@pytest.mark.slow
def test_the_same_flight_twice_gives_the_same_bytes() -> None:
    runs = [flown(), fly_fleet(1)]
    for name in ("uav1", "uav2"):
        (tracks_a, fused_a), (tracks_b, fused_b) = ((run[1][name], run[2][name]) for run in runs)
        own = [track.poses for track in (tracks_a, tracks_b)]
        for a, b in itertools.chain(zip(*own, strict=True), zip(fused_a.poses, fused_b.poses, strict=True)):
            assert a.stamp_ns == b.stamp_ns
            assert a.T_map_body.matrix.tobytes() == b.T_map_body.matrix.tobytes()
            assert a.covariance.tobytes() == b.covariance.tobytes()
        for a, b in zip(tracks_a.outputs, tracks_b.outputs, strict=True):
            assert a.report.nav.covariance.tobytes() == b.report.nav.covariance.tobytes()
            assert a.dead_reckoning.covariance.tobytes() == b.dead_reckoning.covariance.tobytes()


def test_the_network_does_not_affect_the_own_track() -> None:
    """The own-only track of a vehicle is the same with and without a peer, in any mode."""
    _, alone, _ = flown(mode="none")
    _, together, _ = flown()
    for a, b in zip(alone["uav1"].outputs, together["uav1"].outputs, strict=True):
        assert a.report.pose.T_map_body.matrix.tobytes() == b.report.pose.T_map_body.matrix.tobytes()


def test_without_cooperation_the_fused_track_is_the_own_one() -> None:
    _, tracks, fleet = flown(mode="none")
    for name, member in fleet.items():
        assert member.exchange.outbox.packets_sent == 0
        assert member.fusion.inbox.peers == {}
        for own, fused in zip((o.report.pose for o in tracks[name].outputs), member.poses, strict=True):
            np.testing.assert_allclose(fused.T_map_body.t, own.T_map_body.t, rtol=0, atol=1e-9)
            # Between epochs the fused covariance grows with the own one but does not shrink with it.
            assert np.linalg.eigvalsh(fused.covariance - own.covariance)[0] > -1e-6 * np.trace(own.covariance)
            assert np.trace(fused.covariance[:3, :3]) < 1.1 * np.trace(own.covariance[:3, :3])


def test_peers_share_landmarks_and_reduce_each_others_uncertainty() -> None:
    sources, tracks, fleet = flown()
    for source in sources:
        member, own = fleet[source.vehicle], tracks[source.vehicle].outputs[-1].report.pose
        epoch = member.fusion.epoch
        assert epoch is not None
        assert next(iter(epoch.common.values())) >= 5
        assert epoch.weight == 1.0
        fused = member.poses[-1]
        assert np.trace(fused.covariance[:3, :3]) < 0.9 * np.trace(own.covariance[:3, :3])
        assert np.linalg.eigvalsh(fused.covariance)[0] > 0
        # and it stays within three of its own sigmas of the truth
        sigma = np.sqrt(np.trace(fused.covariance[:3, :3]))
        assert np.linalg.norm(position_error(source.simulated, fused)) < 3 * sigma


def test_every_frame_has_an_output_dead_reckoning_and_a_fused_pose() -> None:
    sources, tracks, fleet = flown()
    for source in sources:
        track = tracks[source.vehicle]
        stamps = source.simulated.frame_stamps_ns.tolist()
        assert [o.report.pose.stamp_ns for o in track.outputs] == stamps
        assert [o.dead_reckoning.state.stamp_ns for o in track.outputs] == stamps
        assert [p.stamp_ns for p in fleet[source.vehicle].poses] == stamps
        assert track.frames_in == FRAMES
        assert track.dropped == {}
        assert sum(o.joint is not None for o in track.outputs) == 5  # 5.5 s from a whole second on


def test_slam_beats_dead_reckoning() -> None:
    sources, tracks, _ = flown()
    for source in sources:
        last = tracks[source.vehicle].outputs[-1]
        slam = np.linalg.norm(position_error(source.simulated, last.report.pose))
        ins = np.linalg.norm(position_error(source.simulated, last.dead_reckoning.pose))
        assert slam < 0.7 * ins


def test_frames_from_before_the_start_are_dropped_and_counted() -> None:
    (source,) = simulated(1, frames=8)
    start = source.simulated.initial.state.stamp_ns
    early = [StereoFeatures.empty(start - 2_000_000), StereoFeatures.empty(start - 1_000_000)]
    events = sorted([*source.iter_events(), *early], key=lambda event: event.stamp_ns)
    track = fly(source, config_of(source), events)
    assert track.dropped == {"before_start": 2}
    assert track.frames_in == 10
    assert len(track.outputs) == 8


def test_a_lone_reading_from_the_future_is_dropped_and_stops_nothing() -> None:
    (source,) = simulated(1, frames=8)
    events = list(source.iter_events())
    reading = next(event for event in events[50:] if isinstance(event, ImuSample))
    hour_ns = 3600 * NS_PER_S
    place = next(k for k, event in enumerate(events) if event is reading)
    events.insert(place, dataclasses.replace(reading, stamp_ns=reading.stamp_ns + hour_ns))
    track, undisturbed = fly(source, config_of(source), events), fly(source, config_of(source))
    assert track.dropped == {"stamp_jump": 1}
    for a, b in zip(track.outputs, undisturbed.outputs, strict=True):
        np.testing.assert_array_equal(a.report.nav.covariance, b.report.nav.covariance)


def test_single_readings_that_are_no_motion_are_left_out_and_cost_nothing() -> None:
    (source,) = simulated(1)
    readings = [event for event in source.iter_events() if isinstance(event, ImuSample)]
    wild = {one.stamp_ns for one in readings[200::500]}
    events = [
        dataclasses.replace(event, gyro=event.gyro + 5.0)
        if isinstance(event, ImuSample) and event.stamp_ns in wild
        else event
        for event in source.iter_events()
    ]
    track, undisturbed = fly(source, config_of(source), events), fly(source, config_of(source))
    assert track.dropped == {"imu_outlier": len(wild)}
    assert not track.warnings
    for a, b in zip(track.poses, undisturbed.poses, strict=True):
        assert np.linalg.norm(a.T_map_body.t - b.T_map_body.t) < 0.1


def test_frames_at_the_end_are_completed_with_the_last_readings() -> None:
    (source,) = simulated(1, frames=8)
    last = int(source.simulated.frame_stamps_ns[-1])
    events = [e for e in source.iter_events() if not (isinstance(e, ImuSample) and e.stamp_ns > last - 50_000_000)]
    track = fly(source, config_of(source), events)
    assert len(track.outputs) == 8


def test_an_output_is_yielded_as_soon_as_readings_reach_its_frame() -> None:
    (source,) = simulated(1, frames=5)
    pipeline = VehiclePipeline(source.initial_state, rig=source.rig, config=config_of(source), vehicle="uav1")
    for event in source.iter_events():
        if isinstance(event, ImuSample):
            for output in pipeline.add_imu(event):
                assert output.report.pose.stamp_ns <= event.stamp_ns < output.report.pose.stamp_ns + 5_000_000
        else:
            outputs = pipeline.add_frame(event)
            assert [o.report.pose.stamp_ns for o in outputs] in ([], [event.stamp_ns])


@functools.cache
def flown_from_nowhere(seed: int) -> tuple[SimulatedSource, VehicleTrack]:
    """A flight of 8 s without any start state but gravity; the filter's prior sigma is 5 m/s."""
    (source,) = simulated(seed, frames=58)
    config = dataclasses.replace(config_of(source), start=StartConfig(method="in_flight", velocity_sigma=5.0))
    pipeline = VehiclePipeline(None, rig=source.rig, config=config, vehicle=source.vehicle)
    for _ in pipeline.run(source.iter_events()):
        pass
    assert pipeline.missing_start == ""
    return source, pipeline.track


@pytest.mark.parametrize("seed", SEEDS_IN_FLIGHT)
def test_a_start_in_flight_settles_within_five_seconds(seed: int) -> None:
    source, track = flown_from_nowhere(seed)
    assert len(track.outputs) == track.frames_in == 58
    assert track.dropped == {}
    assert track.warnings == []
    start_ns = track.outputs[0].report.pose.stamp_ns
    for output in track.outputs:
        if output.report.pose.stamp_ns < start_ns + 5 * NS_PER_S:
            continue
        true, state = source.simulated.true_state(output.report.pose.stamp_ns), output.report.nav.state
        R, R_true = state.T_map_body.R, true.T_map_body.R
        assert np.linalg.norm(R.T @ state.v_map - R_true.T @ true.v_map) < 0.5  # in the body: maps differ in yaw
        assert np.rad2deg(np.arccos(R[2] @ R_true[2])) < 1.5  # five sigmas of the accelerometer's bias


def test_after_a_start_in_flight_the_filter_is_consistent() -> None:
    """In the vehicle's own frame, which the first frame defines."""
    found = []
    for seed in SEEDS_IN_FLIGHT:
        source, track = flown_from_nowhere(seed)
        first_ns = track.outputs[0].report.pose.stamp_ns
        estimate = Trajectory.from_estimates(track.poses)
        truth = in_start_frame(true_trajectory(source.simulated), estimate)
        assert truth is not None
        values = nees(estimate, truth)
        assert values is not None
        found.append(float(values.position[estimate.stamps_ns > first_ns + 5 * NS_PER_S].mean()))
    assert np.mean(found) < 2.0


def test_a_start_that_the_first_frames_contradict_is_reported() -> None:
    (source,) = simulated(1, frames=24)
    initial = source.initial_state
    wrong = dataclasses.replace(initial.state, v_map=initial.state.v_map + np.array([2.0, 0.0, 0.0]))
    pipeline = VehiclePipeline(
        NavEstimate(wrong, initial.covariance), rig=source.rig, config=config_of(source), vehicle="uav1"
    )
    for _ in pipeline.run(source.iter_events()):
        pass
    (warning,) = pipeline.track.warnings
    assert "check initial_state" in warning


@pytest.mark.parametrize("order", [("uav1", "uav2"), ("uav2", "uav1")])
def test_cooperation_does_not_depend_on_the_order_of_the_vehicles(order: tuple[str, str]) -> None:
    sources, tracks, fleet = flown()
    configs = {s.vehicle: config_of(s) for s in sources}
    again = cooperate({name: tracks[name] for name in order}, configs)
    for name in order:
        assert again[name].poses[-1].covariance.tobytes() == fleet[name].poses[-1].covariance.tobytes()
