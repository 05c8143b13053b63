# SPDX-License-Identifier: Apache-2.0
"""A cut's vehicles read back as the legs of the source, whatever its topics, frames, clocks and calibration."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uav_vslam.cli.main import main
from uav_vslam.config import ImuConfig, InputConfig, VehicleConfig, load_fleet
from uav_vslam.config.vehicle import OutputFramesConfig
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.datasets.cdr import decode
from uav_vslam.datasets.cut_options import CutOptions
from uav_vslam.datasets.cut_writer import FLEET_FILE, write_cut
from uav_vslam.datasets.cutting import Cut, plan_cut, poses_of, source_of, with_drawn_starts
from uav_vslam.datasets.rosbag import iter_raw
from uav_vslam.datasets.starts import SIGMA_POSITION_M, true_start
from uav_vslam.errors import BagError, UavVslamError
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.recordings.foreign import (
    FOREIGN_TOPICS,
    edited,
    kalibr_of,
    renamed,
    rewritten,
    shifted,
    turned,
    with_imu_edge,
    without,
)
from uav_vslam.types import ImuSample, StereoFrame

FLIGHT = Scenario(frames=24, vehicles=1, scale=0.125, seed=5)  # 3.2 s
LEGS = CutOptions(legs_s=((0.1, 1.0), (1.5, 3.0)))
FRAMES = 7, 11
FOREIGN = dataclasses.replace(FOREIGN_TOPICS, truth="/uav1/ground_truth/odometry")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("source") / "flight"
    record(FLIGHT, path)
    return path


def planned(flight: BagFlight, options: CutOptions = LEGS, imu: ImuConfig | None = None) -> Cut:
    config = VehicleConfig(input=flight.input, imu=imu or ImuConfig())
    return plan_cut(flight, *poses_of(flight), config, options)


def cut_of(flight: BagFlight, out: Path) -> Cut:
    cut = planned(flight)
    write_cut(out, flight, cut.vehicles, VehicleConfig(input=flight.input))
    return cut


def assert_is_leg(found: BagFlight, flight: BagFlight, first_ns: int, last_ns: int, shift_ns: int, frames: int) -> None:
    """Check that the images are those of the leg, and that the readings cover it, bit for bit."""
    expected = [event for event in flight.iter_events() if first_ns <= event.stamp_ns <= last_ns]
    events = list(found.iter_events())
    inside = [event for event in events if first_ns <= event.stamp_ns - shift_ns <= last_ns]
    assert [event.stamp_ns - shift_ns for event in inside] == [event.stamp_ns for event in expected]
    assert sum(isinstance(event, StereoFrame) for event in events) == found.frame_count == frames
    for event, original in zip(inside, expected, strict=True):
        if isinstance(original, ImuSample):
            assert isinstance(event, ImuSample)
            np.testing.assert_array_equal(event.gyro, original.gyro)
            np.testing.assert_array_equal(event.accel, original.accel)
        else:
            assert isinstance(event, StereoFrame)
            np.testing.assert_array_equal(event.left, original.left)
            np.testing.assert_array_equal(event.right, original.right)
    readings = [event.stamp_ns - shift_ns for event in events if isinstance(event, ImuSample)]
    assert readings[0] < first_ns
    assert readings[-1] > last_ns


@pytest.mark.slow
def test_each_vehicle_is_its_leg_bit_for_bit_and_all_start_at_once(source: Path, tmp_path: Path) -> None:
    flight = open_flight(source, "uav1")
    cut = cut_of(flight, tmp_path / "cut")
    starts = []
    for vehicle, frames in zip(cut.vehicles, FRAMES, strict=True):
        found = open_flight(tmp_path / "cut", vehicle.name)
        assert_is_leg(found, flight, vehicle.first_ns, vehicle.last_ns, vehicle.shift_ns, frames)
        np.testing.assert_allclose(found.rig.T_right_left.matrix, flight.rig.T_right_left.matrix, atol=1e-12)
        starts.append(next(event.stamp_ns for event in found.iter_events() if isinstance(event, StereoFrame)))
    assert starts[0] == starts[1] == cut.vehicles[0].first_ns


def test_the_truth_stays_in_one_frame(source: Path, tmp_path: Path) -> None:
    flight = open_flight(source, "uav1")
    cut = cut_of(flight, tmp_path / "cut")
    whole = flight.truth()
    assert whole is not None
    at = {int(stamp): k for k, stamp in enumerate(whole.stamps_ns)}
    for vehicle in cut.vehicles:
        truth = open_flight(tmp_path / "cut", vehicle.name).truth()
        assert truth is not None
        rows = [at[int(stamp) - vehicle.shift_ns] for stamp in truth.stamps_ns]
        np.testing.assert_array_equal(truth.positions_world, whole.positions_world[rows])
        np.testing.assert_allclose(truth.velocities_world, whole.velocities_world[rows], atol=1e-12)
        assert whole.stamps_ns[rows[0]] <= vehicle.first_ns
        assert whole.stamps_ns[rows[-1]] >= vehicle.last_ns


Foreign = Callable[[Path, Path], tuple[Path, InputConfig]]


def other_names(source: Path, folder: Path) -> tuple[Path, InputConfig]:
    return rewritten(source, folder / "bag", renamed), InputConfig(topics=FOREIGN)


def lagging_camera_with_a_kalibr_file(source: Path, folder: Path) -> tuple[Path, InputConfig]:
    late = [edited(f"/uav1/{side}/image_raw", lambda image: shifted(image, 5_000_000)) for side in ("left", "right")]
    bag = rewritten(source, folder / "bag", *late, without("/tf_static", "/uav1/left/camera_info"))
    return bag, InputConfig(calibration=(kalibr_of(source, folder, timeshift_s=-0.005),))


def imu_upside_down(source: Path, folder: Path) -> tuple[Path, InputConfig]:
    changes = [edited("/uav1/imu/data_raw", turned), edited("/tf_static", with_imu_edge)]
    return rewritten(source, folder / "bag", *changes), InputConfig()


def stereo_three_milliseconds_apart(source: Path, folder: Path) -> tuple[Path, InputConfig]:
    early = edited("/uav1/right/image_raw", lambda image: shifted(image, -3_000_000))
    return rewritten(source, folder / "bag", early), InputConfig()


@pytest.mark.parametrize(
    "made", [other_names, lagging_camera_with_a_kalibr_file, imu_upside_down, stereo_three_milliseconds_apart]
)
def test_a_strangers_recording_becomes_a_conventional_one(made: Foreign, source: Path, tmp_path: Path) -> None:
    bag, config = made(source, tmp_path)
    flight = source_of(bag, None, config)
    cut = cut_of(flight, tmp_path / "cut")
    for vehicle, frames in zip(cut.vehicles, FRAMES, strict=True):
        found = open_flight(tmp_path / "cut", vehicle.name)
        assert_is_leg(found, flight, vehicle.first_ns, vehicle.last_ns, vehicle.shift_ns, frames)


def test_the_overlap_of_rendered_images_is_that_of_their_footprints(source: Path) -> None:
    """Flown at once, the legs are seven frames at 20 m/s apart, and an image shows 40.9 m along the flight."""
    options, apart_s = CutOptions(legs_s=((0.0, 0.95), (0.95, 1.95)), within_s=0.07), 7 / FLIGHT.frame_rate_hz
    met = planned(open_flight(source, "uav1"), options).meetings["uav1", "uav2"]
    assert met.overlap == pytest.approx(1.0 - apart_s * 20.0 / 40.9, abs=0.15)  # 20 points a view, unevenly
    assert met.shared == 1.0
    assert met.heading_deg < 3.0
    assert met.view_angle_deg == pytest.approx(np.degrees(np.arctan(apart_s * 20.0 / 70.0)), abs=3.0)
    assert met.gap_s == pytest.approx(apart_s, abs=0.01)


def test_an_imu_of_its_own_keeps_its_axes(source: Path, tmp_path: Path) -> None:
    bag, config = imu_upside_down(source, tmp_path)
    cut_of(open_flight(bag, "uav1", config), tmp_path / "cut")
    vehicle = next(raw for raw in iter_raw([tmp_path / "cut"], ["/uav2/imu/data_raw"]))
    assert decode(vehicle).header.frame_id == "uav2/imu"
    assert decode(vehicle).linear_acceleration.z < 0


def test_a_start_is_the_truth_with_the_recorded_uncertainty(source: Path) -> None:
    flight = open_flight(source, "uav1")
    imu = ImuConfig(gyro_bias_walk=1e-2)
    cut = planned(flight, imu=imu)
    truth, _ = poses_of(flight)
    for vehicle in cut.vehicles:
        row = int(np.flatnonzero(truth.stamps_ns == vehicle.first_ns)[0])
        state = vehicle.start.state
        np.testing.assert_allclose(state.T_map_body.t, truth.positions[row], atol=1e-12)
        np.testing.assert_allclose(state.T_map_body.R, truth.rotations[row], atol=1e-12)
        assert flight.initial_state is not None
        np.testing.assert_array_equal(
            np.diag(vehicle.start.covariance)[:9], np.diag(flight.initial_state.covariance)[:9]
        )
    grown = np.diag(cut.vehicles[1].start.covariance - cut.vehicles[0].start.covariance)[9:12]
    since_s = (cut.vehicles[1].first_ns - cut.vehicles[0].first_ns) * 1e-9
    np.testing.assert_allclose(grown, 1e-4 * since_s)


def test_biases_are_as_uncertain_before_the_recorded_start_as_after_it(source: Path) -> None:
    flight = open_flight(source, "uav1")
    recorded, imu = flight.initial_state, ImuConfig(gyro_bias_walk=1e-2, accel_bias_walk=1e-1)
    assert recorded is not None
    truth, velocities = poses_of(flight)
    stamp_ns = int(truth.stamps_ns[len(truth) // 2])
    around = [
        dataclasses.replace(recorded, state=dataclasses.replace(recorded.state, stamp_ns=stamp_ns + offset_ns))
        for offset_ns in (-1_000_000_000, 1_000_000_000)
    ]
    earlier, later = (true_start(truth, velocities, stamp_ns, start, imu).covariance for start in around)
    np.testing.assert_array_equal(earlier, later)
    assert np.linalg.eigvalsh(later).min() > 0


def test_a_start_without_bias_variances_is_refused_by_name(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def without_bias_variances(start: Any) -> Any:
        covariance = np.array(start.covariance).reshape(15, 15)
        covariance[9:] = 0.0
        return dataclasses.replace(start, covariance=covariance.ravel())

    bag = rewritten(source, tmp_path / "bag", edited("/uav1/initial_state", without_bias_variances))
    for command in (["cut", str(bag), str(tmp_path / "pair")], ["study", "split", str(bag)]):
        assert main([*command, "--legs", "0-1,1.5-3"]) == 2
        error = capsys.readouterr().err
        assert "the covariance of the start state at" in error
        assert error.count("\n") == 1


def test_without_a_recorded_start_it_is_as_uncertain_as_a_simulated_one(source: Path, tmp_path: Path) -> None:
    flight = open_flight(rewritten(source, tmp_path / "bag", without("/uav1/initial_state")), "uav1")
    start = planned(flight).vehicles[0].start
    np.testing.assert_allclose(np.sqrt(np.diag(start.covariance)[:3]), SIGMA_POSITION_M)
    np.testing.assert_array_equal(start.state.gyro_bias, np.zeros(3))


def test_drawn_starts_err_as_their_covariance_says_and_repeat(source: Path) -> None:
    cut = planned(open_flight(source, "uav1"))
    squares = []
    for seed in range(200):
        for true, drawn in zip(cut.vehicles, with_drawn_starts(cut, seed).vehicles, strict=True):
            a, b = true.start.state, drawn.start.state
            xi = so3_log(a.T_map_body.R @ b.T_map_body.R.T)
            error = np.concatenate([a.T_map_body.t - b.T_map_body.t, a.v_map - b.v_map, xi])
            squares.append(error @ np.linalg.solve(true.start.covariance[:9, :9], error) / 9)
            np.testing.assert_array_equal(a.accel_bias, b.accel_bias)
    assert np.mean(squares) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 9 / len(squares)))  # chi-square, four sigma
    one, again = (with_drawn_starts(cut, 7).vehicles[1].start.state.T_map_body.t for _ in range(2))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, with_drawn_starts(cut, 8).vehicles[1].start.state.T_map_body.t)


def test_the_fleet_file_names_the_vehicles_and_keeps_the_settings(source: Path, tmp_path: Path) -> None:
    flight = open_flight(source, "uav1")
    config = VehicleConfig(imu=ImuConfig(gravity=9.7), input=InputConfig(pair_tolerance_s=0.004))
    recorded = InputConfig(topics=FOREIGN, pair_tolerance_s=0.004)
    own = dataclasses.replace(config, input=recorded, frames=OutputFramesConfig(map="map", odom="odom"))
    write_cut(tmp_path / "cut", flight, planned(flight).vehicles, own)
    fleet = load_fleet(tmp_path / "cut" / FLEET_FILE)
    assert list(fleet.vehicles) == ["uav1", "uav2"]
    assert fleet.vehicles["uav2"] == config
    assert open_flight(fleet.replay.bags, "uav2").frame_count == FRAMES[1]


def test_pairs_without_a_pose_within_a_leg_are_counted_as_written(source: Path, tmp_path: Path) -> None:
    """The poses of the second leg have a gap of 0.8 s, too long to interpolate."""
    flight = open_flight(source, "uav1")
    (poses, velocities), config = poses_of(flight), VehicleConfig()
    since_s = (poses.stamps_ns - next(e.stamp_ns for e in flight.iter_events() if isinstance(e, StereoFrame))) * 1e-9
    kept = (since_s < 1.8) | (since_s > 2.6)
    cut = plan_cut(flight, poses.select(kept), velocities[kept], config, LEGS)
    written: list[None] = []
    write_cut(tmp_path / "cut", flight, cut.vehicles, config, lambda: written.append(None))
    counts = [vehicle.frames for vehicle in cut.vehicles]
    assert counts == [open_flight(tmp_path / "cut", vehicle.name).frame_count for vehicle in cut.vehicles]
    assert len(written) == sum(counts) == sum(FRAMES)


def test_an_interrupted_cut_leaves_nothing(source: Path, tmp_path: Path) -> None:
    flight = open_flight(source, "uav1")

    def interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_cut(tmp_path / "cut", flight, planned(flight).vehicles, VehicleConfig(), interrupt)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_refused(source: Path, tmp_path: Path) -> None:
    flight = open_flight(source, "uav1")
    with pytest.raises(BagError, match="exists"):
        write_cut(source, flight, planned(flight).vehicles, VehicleConfig())


def test_a_leg_without_frames_is_refused(source: Path) -> None:
    with pytest.raises(UavVslamError, match=r"leg 5-6 s has 0 image pairs"):
        planned(open_flight(source, "uav1"), CutOptions(legs_s=((0.0, 1.0), (5.0, 6.0))))


def test_a_recording_without_truth_is_refused(source: Path, tmp_path: Path) -> None:
    flight = open_flight(rewritten(source, tmp_path / "bag", without("/uav1/ground_truth/odometry")), "uav1")
    with pytest.raises(BagError, match="ground_truth"):
        poses_of(flight)


def test_positions_alone_are_nothing_to_cut_along(source: Path, tmp_path: Path) -> None:
    def position_alone(truth: Any) -> Any:
        q = truth.pose.pose.orientation
        q.w, q.x, q.y, q.z = 1.0, 0.0, 0.0, 0.0
        return truth

    gnss = rewritten(source, tmp_path / "gnss", edited("/uav1/ground_truth/odometry", position_alone))
    with pytest.raises(UavVslamError, match=r"one orientation throughout.*--trajectory"):
        planned(open_flight(gnss, "uav1"))
