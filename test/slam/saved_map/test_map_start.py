# SPDX-License-Identifier: Apache-2.0
"""A flight without a start state begins in the map of another one, says what it depends on, and stays consistent."""

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from position_nees import position_nees
from scipy.stats import chi2

from uav_vslam.config import FusionConfig, StartConfig, VehicleConfig
from uav_vslam.errors import ConfigError, MapError, UavVslamError
from uav_vslam.fleet import cooperate
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.offline.track import track_vehicle
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.landmarks import observe
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.clocked_stage import ClockedStage
from uav_vslam.slam.frame_queue import Frame
from uav_vslam.slam.map_initializer import MapInitializer
from uav_vslam.slam.saved_map import load_map, save_map
from uav_vslam.slam.stage import SlamStage
from uav_vslam.types import NS_PER_S

pytestmark = pytest.mark.slow

SEEDS = (1, 2, 3)


def in_map(flight, path: Path) -> VehicleConfig:
    return dataclasses.replace(flight.config, start=StartConfig(method="map", map=str(path)))


def fly_over(flight, path: Path, *, keep_map: bool = False) -> VehicleTrack:
    """Fly the second vehicle in the first one's map."""
    save_map(flight.saved, path)
    return track_vehicle(SimulatedSource(flight.vehicles[1], flight.field), in_map(flight, path), keep_map=keep_map)


def first_frames(flight) -> list[Frame]:
    """Return frames of the second vehicle with the increments between them."""
    vehicle, zero = flight.vehicles[1], np.zeros(3)
    samples, imu = vehicle.imu.samples(), vehicle.scenario.imu_config
    steps = [
        preintegrate(samples, int(a), int(b), gyro_bias=zero, accel_bias=zero, imu=imu)
        for a, b in itertools.pairwise(vehicle.frame_stamps_ns[:12])
    ]
    views = itertools.islice(observe(vehicle, flight.field), 12)
    return list(zip([features for features, _ in views], [None, *steps], strict=True))


@pytest.fixture(scope="module")
def over(mapped, tmp_path_factory: pytest.TempPathFactory) -> dict[int, VehicleTrack]:
    """Return flights in maps, by seed."""
    folder = tmp_path_factory.mktemp("maps")
    return {seed: fly_over(mapped(seed), folder / f"{seed}.npz", keep_map=seed == 1) for seed in SEEDS}


def test_the_vehicle_knows_within_seconds_where_it_is(mapped, over: dict[int, VehicleTrack]) -> None:
    values, errors_m = [], []
    for seed, track in over.items():
        vehicle = mapped(seed).vehicles[1]
        assert track.start is not None
        assert track.start.state.stamp_ns - int(vehicle.frame_stamps_ns[0]) < 2 * NS_PER_S
        for output in track.outputs[10::10]:
            pose = output.report.pose
            truth = vehicle.true_state(pose.stamp_ns)
            values.append(position_nees(pose, truth))
            errors_m.append(np.linalg.norm(truth.T_map_body.t - pose.T_map_body.t))
    assert 0.1 < np.mean(values) < 2.0
    assert np.median(errors_m) < 2.0  # landmark level, 1 px; the map itself errs by some decimetres


def test_a_search_goes_on_with_settings_that_have_changed(mapped) -> None:
    """As one that has had them from the beginning, to the bit."""
    flight = mapped(1)
    vague = dataclasses.replace(flight.config, backend=dataclasses.replace(flight.config.backend, sigma_px=4.0))
    rig, starts = flight.vehicles[1].rig, []
    for first in (flight.config, vague):
        search = MapInitializer(rig, dataclasses.replace(first, start=StartConfig(method="map")), flight.saved)
        search.configure(dataclasses.replace(vague, start=StartConfig(method="map")))
        found = next(start for frame in first_frames(flight) if (start := search.add(*frame)) is not None)
        starts.append(found.initial)
    assert starts[0].covariance.tobytes() == starts[1].covariance.tobytes()
    assert starts[0].state.T_map_body.t.tobytes() == starts[1].state.T_map_body.t.tobytes()


def test_the_start_is_where_it_claims_to_be_and_uses_no_frame_again(mapped, over: dict[int, VehicleTrack]) -> None:
    for seed, track in over.items():
        vehicle, start = mapped(seed).vehicles[1], track.start
        assert start is not None
        true = vehicle.true_state(start.state.stamp_ns)
        T = start.state.T_map_body
        error = np.concatenate([true.T_map_body.t - T.t, true.v_map - start.state.v_map])
        error = np.concatenate([error, so3_log(true.T_map_body.R @ T.R.T)])
        assert error @ np.linalg.solve(start.covariance[:9, :9], error) < chi2.ppf(0.999, 9)
        assert np.linalg.norm(error[:3]) < 1.0
        assert track.outputs[0].report.pose.stamp_ns == start.state.stamp_ns
        assert track.outputs[0].increment is None
        processed = len(track.outputs) + track.dropped["before_start"]
        assert processed == len(vehicle.frame_stamps_ns)


def test_a_gyro_bias_far_beyond_its_sigma_is_found_in_the_map_too(mapped, tmp_path: Path) -> None:
    flight, bias = mapped(1), np.array([0.02, -0.015, 0.01])
    vehicle = flight.vehicles[1]
    readings = dataclasses.replace(vehicle.imu, gyro=vehicle.imu.gyro + bias, gyro_bias=vehicle.imu.gyro_bias + bias)
    biased = dataclasses.replace(vehicle, imu=readings)
    track = fly_over(dataclasses.replace(flight, vehicles=[flight.vehicles[0], biased]), tmp_path / "map.npz")
    assert track.start is not None
    error = track.start.state.gyro_bias - readings.gyro_bias[0]
    assert error @ np.linalg.solve(track.start.covariance[9:12, 9:12], error) < chi2.ppf(0.999, 3)
    assert "imu.gyro_bias_sigma" in " ".join(track.outputs[0].warnings)
    last = track.outputs[-1].report.pose
    assert np.linalg.norm(vehicle.true_state(last.stamp_ns).T_map_body.t - last.T_map_body.t) < 2.0


def test_its_beliefs_and_its_map_name_the_map_they_depend_on(mapped, over: dict[int, VehicleTrack]) -> None:
    flight, track = mapped(1), over[1]
    joints = [output.joint for output in track.outputs if output.joint is not None]
    assert {joint.prior_id for joint in joints} == {flight.saved.hash}
    assert {joint.sources for joint in joints} == {("uav2/1", "uav1/1")}
    assert track.saved_map is not None
    assert track.saved_map.origin.sources == ("uav2/1", "uav1/1")
    assert track.saved_map.hash != flight.saved.hash


def test_a_map_beside_a_given_start_is_independent_evidence(mapped, tmp_path: Path) -> None:
    flight, path = mapped(1), tmp_path / "map.npz"
    save_map(flight.saved, path)
    config = dataclasses.replace(flight.config, start=StartConfig(map=str(path)))
    track = track_vehicle(SimulatedSource(flight.vehicles[1], flight.field), config)
    last = next(output.joint for output in reversed(track.outputs) if output.joint is not None)
    assert (last.prior_id, last.sources) == ("", ("uav2/1",))
    epoch = cooperate({"uav2": track}, {"uav2": config})["uav2"].fusion.epoch
    assert epoch is not None
    assert epoch.map_landmarks > 0
    assert epoch.weight == 1.0
    assert np.linalg.eigvalsh(epoch.own.covariance - epoch.pose.covariance)[0] > -1e-9  # a sum only gains


def test_fusion_intersects_with_the_map_that_the_start_depends_on(mapped, over, tmp_path: Path) -> None:
    flight, path = mapped(1), tmp_path / "map.npz"
    save_map(flight.saved, path)
    config = in_map(flight, path)
    epoch = cooperate({"uav2": over[1]}, {"uav2": config})["uav2"].fusion.epoch
    assert epoch is not None
    assert epoch.map_landmarks > 0
    assert epoch.weight < 1.0
    assert np.trace(epoch.pose.covariance[:3, :3]) < np.trace(epoch.own.covariance[:3, :3])


def test_without_the_right_ground_there_is_no_start_and_a_reason(mapped, tmp_path: Path) -> None:
    flight, path = mapped(1), tmp_path / "map.npz"
    save_map(mapped(2).saved, path)
    with pytest.raises(UavVslamError, match="resemble landmarks of one section of the map"):
        track_vehicle(SimulatedSource(flight.vehicles[1], flight.field), in_map(flight, path))


def test_a_map_that_leans_contradicts_gravity(mapped) -> None:
    """Gravity refuses a pose that fits the landmarks, where the map is tilted by more than it claims."""
    flight = mapped(1)
    tilt = np.deg2rad(25.0)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    leaning = tuple(
        dataclasses.replace(section, positions=section.positions @ turn.T, anchor=turn @ section.anchor)
        for section in flight.saved.sections
    )
    search = MapInitializer(flight.vehicles[1].rig, flight.config, dataclasses.replace(flight.saved, sections=leaning))
    assert all(search.add(*frame) is None for frame in first_frames(flight))
    assert "degrees from gravity's" in search.reason


def test_a_map_is_loaded_before_the_flight_only(mapped, over, tmp_path: Path) -> None:
    flight, path = mapped(1), tmp_path / "map.npz"
    save_map(flight.saved, path)
    stage = SlamStage(dataclasses.replace(flight.config, start=StartConfig(method="map")), vehicle="uav2")
    assert stage.missing_start == "no map is loaded; set start.map"
    stage.load_map(load_map(path))
    assert stage.missing_start == "none was received"
    stage.start(over[1].start)
    with pytest.raises(MapError, match="before the flight"):
        stage.load_map(load_map(path))
    with pytest.raises(MapError, match=r"start\.method is given"):
        SlamStage(flight.config, vehicle="uav2").load_map(load_map(path))


@pytest.mark.parametrize("method", ["map", "given"])
def test_a_new_session_in_flight_needs_the_map_s_file_no_more(mapped, tmp_path: Path, method: str) -> None:
    """Its disk may be gone, and whoever resets a vehicle has no other."""
    flight, path = mapped(1), tmp_path / "map.npz"
    save_map(flight.saved, path)
    config = dataclasses.replace(flight.config, start=StartConfig(method=method, map=str(path)))
    clocked = ClockedStage(SlamStage(config, vehicle="uav2"), config, lambda: 2)
    path.unlink()
    clocked.reset()
    assert (clocked.stage.session, clocked.stage.missing_start) == (2, "none was received")


def test_a_map_s_own_hash_is_the_prior() -> None:
    with pytest.raises(ConfigError, match=r"fusion\.prior_id"):
        VehicleConfig(start=StartConfig(map="map.npz"), fusion=FusionConfig(prior_id="survey"))
