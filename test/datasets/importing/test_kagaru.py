# SPDX-License-Identifier: Apache-2.0
"""A made-up folder of Bayer pictures, frame times and a log in NED, degrees and g gives the flight it was made from."""

import contextlib
import dataclasses
import io
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from data_sets import (
    KAGARU_DATUM,
    SCENARIO,
    TINT,
    Flight,
    fly,
    kagaru_layout,
    kalibr_in_frd,
    mosaic,
    mosaics,
    write_direct,
    write_kagaru,
)

from uav_vslam.cli.main import main
from uav_vslam.config import load_vehicle
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.datasets.importing.axes import rotation_to_enu, rotation_to_flu
from uav_vslam.datasets.importing.columns import Clock
from uav_vslam.datasets.importing.kagaru import read_kagaru
from uav_vslam.datasets.importing.kagaru_log import read_motion
from uav_vslam.datasets.importing.kagaru_settings import LogSettings, read_settings
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.errors import BagError, CalibrationError, ConfigError
from uav_vslam.evaluation.files.geodetic import Datum, from_geodetic, to_geodetic
from uav_vslam.types import ImuSample, StereoFrame

Capsys = pytest.CaptureFixture[str]

FRAMES = 20
NINE_DIGITS = 1e-8  # of a log with nine decimals, in radians, m/s^2 and m/s
POSITION_M = 2e-4  # nine decimals of a degree are 0.1 mm
ROTATION = 1e-9
EYE = np.eye(4).ravel().tolist()
OURS = Path(__file__).parents[3] / "config" / "import" / "kagaru.yaml"


@pytest.fixture(scope="module")
def flight() -> Flight:
    return fly(scenario=dataclasses.replace(SCENARIO, frames=FRAMES, scale=0.375))


@pytest.fixture(scope="module")
def folder(flight: Flight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_kagaru(flight, tmp_path_factory.mktemp("kagaru"))


def imported(folder: Path, layout: Path, out: Path, *options: str) -> BagFlight:
    assert main(["import", "kagaru", str(folder), str(out), "--layout", str(layout), *options]) == 0
    return open_flight(out, "uav1")


@dataclasses.dataclass(frozen=True)
class Imported:
    """The flight as it was imported: its bag and settings, the flight in it, and what was said."""

    bag: Path
    config: Path
    flight: BagFlight
    out: str
    err: str


@pytest.fixture(scope="module")
def whole(flight: Flight, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Imported:
    scratch, out, err = tmp_path_factory.mktemp("whole"), io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        found = imported(folder, kagaru_layout(flight, scratch / "layout.yaml"), scratch / "out")
    return Imported(scratch / "out", scratch / "out.yaml", found, out.getvalue(), err.getvalue())


@pytest.mark.slow
def test_the_flight_comes_back(flight: Flight, whole: Imported) -> None:
    found = whole.flight
    assert "warning" not in whole.err
    assert "datum: -27.800000000 152.900000000 60.000" in whole.out
    np.testing.assert_allclose(found.rig.T_body_left.matrix, flight.vehicle.rig.T_body_left.matrix, atol=ROTATION)
    np.testing.assert_allclose(found.rig.T_body_right.matrix, flight.vehicle.rig.T_body_right.matrix, atol=ROTATION)
    events = list(found.iter_events())
    readings = [event for event in events if isinstance(event, ImuSample)]
    np.testing.assert_array_equal([r.stamp_ns for r in readings], flight.vehicle.imu.stamps_ns)
    np.testing.assert_allclose([r.gyro for r in readings], flight.vehicle.imu.gyro, atol=NINE_DIGITS)
    np.testing.assert_allclose([r.accel for r in readings], flight.vehicle.imu.accel, atol=NINE_DIGITS)
    frames = [event for event in events if isinstance(event, StereoFrame)]
    assert [frame.stamp_ns for frame in frames] == [frame.stamp_ns for frame in flight.frames]
    truth, start = found.truth(), found.initial_state
    assert truth is not None
    assert start is not None
    for stamp, R, p, v in zip(
        truth.stamps_ns, truth.R_world_body, truth.positions_world, truth.velocities_world, strict=True
    ):
        state = flight.vehicle.true_state(int(stamp))
        np.testing.assert_allclose(R, state.T_map_body.R, atol=NINE_DIGITS)
        np.testing.assert_allclose(p, state.T_map_body.t, atol=POSITION_M)
        np.testing.assert_allclose(v, state.v_map, atol=NINE_DIGITS)
    np.testing.assert_allclose(start.state.v_map, flight.start.v_map, atol=1e-3)  # between rows, in a turn
    assert load_vehicle(whole.config).imu.gyro_noise == 1.3e-4
    assert load_vehicle(whole.config).backend == load_vehicle(OURS.parents[1] / "kagaru.yaml").backend


def test_the_pictures_are_read_in_the_colours_of_their_bayer_pattern(flight: Flight, whole: Imported) -> None:
    frame = next(event for event in whole.flight.iter_events() if isinstance(event, StereoFrame))
    expected = cv2.cvtColor(mosaic(flight.frames[0].left, "rggb"), cv2.COLOR_BayerRGGB2BGR)
    np.testing.assert_array_equal(frame.left, expected)
    means = frame.left.reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(means[:2] / means[2], [TINT["b"], TINT["g"]], rtol=0.01)


@pytest.mark.slow
def test_the_imported_flight_runs_as_the_direct_bag(flight: Flight, whole: Imported, tmp_path: Path) -> None:
    assert whole.flight.initial_state is not None
    covariance = whole.flight.initial_state.covariance
    direct = write_direct(flight, tmp_path / "direct", covariance=covariance, frames=mosaics(flight))
    errors = []
    for bag in (whole.bag, direct):
        results = tmp_path / f"{bag.name}_results"
        options = ["--no-plots", "--no-maps", "--no-smoothing", "--results", str(results)]
        assert main(["run", str(bag), "--config", str(whole.config), *options]) == 0
        summary = json.loads((results / "latest" / "summary.json").read_text())["vehicles"]["uav1"]
        assert summary["frames_processed"] == len(flight.frames)
        errors.append(summary["s_slam"]["ate_m"])
    assert errors[0] == pytest.approx(errors[1], rel=0.05)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"accel_unit": "m/s^2"}, "accel_unit"),
        ({"gyro_unit": "rad/s"}, "gyro_unit"),
        ({"body_axes": "FLU"}, "body_axes"),
        ({"world_axes": "ENU"}, "world_axes"),
        ({"angle_unit": "rad"}, "angle_unit"),
        ({"gyro": ["Gyr_Y", "Gyr_X", "Gyr_Z"]}, "columns of gyro"),
        ({"accel": [7, 6, 5]}, "columns of accel"),
        ({"position_kind": "local", "position": ["Time", "Time", "Altitude"]}, "km from the origin of the world"),
    ],
)
def test_a_wrong_unit_axis_or_column_contradicts_the_attitude_and_is_told(
    change: dict[str, object], said: str, flight: Flight, folder: Path, tmp_path: Path
) -> None:
    source = read_kagaru(folder, kagaru_layout(flight, tmp_path / "layout.yaml", **change))
    assert any(said in warning for warning in source.warnings), source.warnings


def test_clocks_apart_are_joined_by_the_offset(flight: Flight, tmp_path: Path) -> None:
    folder = write_kagaru(flight, tmp_path / "data", clock_s=3600.5)
    with pytest.raises(BagError, match=r"none of 20 image pairs is covered by IMU readings and .*time_offset_s"):
        read_kagaru(folder, kagaru_layout(flight, tmp_path / "layout.yaml"))
    source = read_kagaru(folder, kagaru_layout(flight, tmp_path / "layout.yaml", time_offset_s=-3600.5))
    assert [sample.stamp_ns for sample in source.flight.imu] == flight.vehicle.imu.stamps_ns.tolist()
    assert source.frame_count == FRAMES


def test_a_kalibr_file_is_turned_with_the_sensors_axes(flight: Flight, folder: Path, tmp_path: Path) -> None:
    tree = yaml.safe_load(kagaru_layout(flight, tmp_path / "layout.yaml").read_text())
    tree["calibration"] = {"files": [kalibr_in_frd(flight, tmp_path).name]}
    (tmp_path / "layout.yaml").write_text(yaml.safe_dump(tree))
    rig = read_kagaru(folder, tmp_path / "layout.yaml").flight.rig
    np.testing.assert_allclose(rig.T_body_right.matrix, flight.vehicle.rig.T_body_right.matrix, atol=ROTATION)


def test_without_pose_in_the_log_the_run_starts_in_flight(
    flight: Flight, folder: Path, tmp_path: Path, capsys: Capsys
) -> None:
    imported(folder, kagaru_layout(flight, tmp_path / "layout.yaml", attitude=[]), tmp_path / "out")
    assert load_vehicle(tmp_path / "out.yaml").start.method == "in_flight"
    assert "nothing can be evaluated" in capsys.readouterr().out


def test_frame_times_that_do_not_match_the_pictures_are_refused_unless_they_name_them(
    flight: Flight, folder: Path, tmp_path: Path
) -> None:
    tree = yaml.safe_load(kagaru_layout(flight, tmp_path / "layout.yaml").read_text())
    lines = (folder / "front.txt").read_text().splitlines()
    short = folder / "short.txt"
    short.write_text("\n".join(lines[:-1]))
    tree["cameras"]["left"]["times"] = "short.txt"
    (tmp_path / "layout.yaml").write_text(yaml.safe_dump(tree))
    with pytest.raises(BagError, match="19 lines for 20 pictures"):
        read_kagaru(folder, tmp_path / "layout.yaml")
    for name, back in (("short", "front"), ("long", "back")):
        lines = (folder / f"{back}.txt").read_text().splitlines()
        named = [f"{line} img{k}.pgm" for k, line in enumerate(lines)]
        (folder / f"{name}.txt").write_text("\n".join(named[:-1]))
    tree["cameras"] |= {"name_column": 2, "right": {"images": "back/*.pgm", "times": "long.txt"}}
    (tmp_path / "layout.yaml").write_text(yaml.safe_dump(tree))
    assert read_kagaru(folder, tmp_path / "layout.yaml").frame_count == FRAMES - 1


def test_the_first_pictures_may_be_broken(flight: Flight, tmp_path: Path) -> None:
    folder = write_kagaru(flight, tmp_path / "kagaru")
    (folder / "front" / "img0.pgm").write_bytes(b"P5 cut short")
    source = read_kagaru(folder, kagaru_layout(flight, tmp_path / "layout.yaml"))
    assert len(list(source.flight.frames)) == FRAMES - 1


def test_stamps_may_be_in_the_names_of_the_pictures(flight: Flight, tmp_path: Path) -> None:
    folder = write_kagaru(flight, tmp_path / "data")
    for name in ("front", "back"):
        lines = (folder / f"{name}.txt").read_text().splitlines()
        for k, line in enumerate(lines):
            (folder / name / f"img{k}.pgm").rename(folder / name / f"cam1_{line.replace('.', '')}.pgm")
    tree = yaml.safe_load(kagaru_layout(flight, tmp_path / "layout.yaml").read_text())
    tree["cameras"] |= {"time_units": ["ns"]} | {
        side: {"images": f"{name}/*.pgm"} for side, name in (("left", "front"), ("right", "back"))
    }
    (tmp_path / "layout.yaml").write_text(yaml.safe_dump(tree))
    frames = list(read_kagaru(folder, tmp_path / "layout.yaml").flight.frames)
    assert [frame.stamp_ns for frame in frames] == [frame.stamp_ns for frame in flight.frames]


@pytest.mark.parametrize(
    ("edit", "error", "said"),
    [
        ({"cameras": {"bayr": "rggb"}}, ConfigError, "did you mean cameras.bayer"),
        ({"log": {"gyro": ["Gyr_X", "Gyr_Y"]}}, ConfigError, "3 columns"),
        ({"log": {"gyro": ["a", "b", "c"]}}, ConfigError, r"xsens.csv: no column 'a'; it has Time, Gyr_X"),
        ({"log": {"time_offset_s": 3e9}}, ConfigError, "log.time_offset_s = 3000000000.0 is not allowed"),
        ({"log": {"world_axes": "NEU"}}, ConfigError, "three right-handed directions"),
        ({"log": {"file": "none.csv"}}, BagError, "none.csv: can't be read"),
        ({"cameras": {"left": {"images": "nowhere/*.png"}}}, BagError, "no picture nowhere"),
        ({"cameras": {"pair_tolerance_s": 0.0}}, BagError, "none of 20 left and 20 right pictures pair up"),
        ({"calibration": {"size": [640, 480]}}, CalibrationError, "calibrate at the recorded size"),
        ({"calibration": {"T_imu_left": [1.0] * 16}}, CalibrationError, "no rotation"),
        (
            {"calibration": {"T_left_right": EYE}},
            CalibrationError,
            r"layout.yaml: calibration: baseline is 0.*places both",
        ),
        ({"calibration": {"left": {"intrinsics": [0.0] * 4}}}, CalibrationError, "calibration.left: focal length"),
        ({"run": {"imu": {"giro_noise": 1.0}}}, ConfigError, r"unknown key imu\.giro_noise"),
    ],
)
def test_what_is_wrong_in_a_layout_is_named(
    edit: dict[str, dict[str, object]],
    error: type[Exception],
    said: str,
    flight: Flight,
    folder: Path,
    tmp_path: Path,
) -> None:
    tree = yaml.safe_load(kagaru_layout(flight, tmp_path / "layout.yaml").read_text())
    for section, changes in edit.items():
        tree[section] |= changes
    (tmp_path / "layout.yaml").write_text(yaml.safe_dump(tree))
    with pytest.raises(error, match=said):
        list(read_kagaru(folder, tmp_path / "layout.yaml").flight.frames)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ({"xyzzy": 1}, "known keys: base, calibration, cameras, datum, log, run, start_sigma, truth"),
        ({"datum": [1.0, 2.0]}, r"layout.yaml: datum = \[1.0, 2.0\] is not allowed; use latitude, longitude"),
        ({"start_sigma": [1.0, 1.0]}, r"start_sigma = \[1.0, 1.0\] is not allowed; use 5 numbers above 0"),
        ({"start_sigma": [0, 1, 1, 1, 1]}, "use 5 numbers above 0"),
        ({"start_sigma": [1e-300, 1, 1, 1, 1]}, "of a size from 1e-12"),
    ],
)
def test_what_is_wrong_at_the_top_of_a_layout_is_named(edit: dict[str, object], said: str, tmp_path: Path) -> None:
    path = tmp_path / "layout.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(OURS.read_text()) | edit))
    with pytest.raises(ConfigError, match=said):
        read_settings(path)


def test_broken_lines_of_the_log_are_left_out_and_named(flight: Flight, tmp_path: Path, capsys: Capsys) -> None:
    folder = write_kagaru(flight, tmp_path / "data")
    lines = (folder / "xsens.csv").read_text().splitlines()
    lines[10], lines[20] = "garbage", lines[20].rpartition(",")[0]  # the velocity is cut: the readings are whole
    (folder / "xsens.csv").write_text("\n".join(lines))
    found = imported(folder, kagaru_layout(flight, tmp_path / "layout.yaml"), tmp_path / "out")
    assert "3 lines that can't be read" in capsys.readouterr().out
    listed = (tmp_path / "out.warnings.txt").read_text()
    assert listed.count(f"{folder}/xsens.csv:11: ") == 2  # as a reading and as a pose
    assert listed.count(f"{folder}/xsens.csv:21: ") == 1
    readings = [event for event in found.iter_events() if isinstance(event, ImuSample)]
    assert len(readings) == len(flight.vehicle.imu.stamps_ns) - 1


def test_rows_of_the_truth_without_a_valid_quaternion_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "truth.txt").write_text("0 0 0 0 1 0 0 0\n1 0 0 0 0 0 0 0\n2 0 0 0 0 0 0 1\n")
    columns = ["2", "3", "4"], ["5", "6", "7", "8"]
    log = LogSettings(file="truth.txt", position=columns[0], attitude=columns[1], position_kind="local")
    problems = Problems()
    found, _ = read_motion(tmp_path, log, (), problems)
    assert found is not None
    assert found.stamps_ns.tolist() == [0, 2_000_000_000]
    assert problems.lines == [f"{tmp_path / 'truth.txt'}:2: the quaternion's norm is 0, not 1"]


def test_positions_that_are_none_are_left_out_and_named(flight: Flight, tmp_path: Path) -> None:
    folder = write_kagaru(flight, tmp_path / "data")
    path = folder / "xsens.csv"
    lines = path.read_text().splitlines()
    fixed = lines[5].split(",")
    lines[5] = ",".join([*fixed[:10], "0.0", "0.0", "0.0", *fixed[13:]])
    path.write_text("\n".join(lines))
    layout, problems = kagaru_layout(flight, tmp_path / "layout.yaml"), Problems()
    source = read_kagaru(folder, layout, problems=problems)
    assert problems.lines == [f"{path}:6: latitude and longitude are 0, as receivers write them without a fix"]
    assert len(list(source.flight.truth)) == len(list(source.flight.imu)) - 1
    swapped = kagaru_layout(flight, tmp_path / "layout.yaml", position=["Longitude", "Latitude", "Altitude"])
    with pytest.raises(BagError, match="no row holds"):
        read_kagaru(folder, swapped, problems=problems)
    assert f"{path}:3: there is no latitude 152.9, longitude -27.8; check the order of position" in problems.lines


def test_longitudes_counted_from_0_to_360_are_those_west_of_greenwich(tmp_path: Path) -> None:
    found = []
    log = LogSettings(file="log.txt", position=("2", "3", "4"), attitude=("5", "6", "7"))
    for longitude in (254.75, -105.25):
        (tmp_path / "log.txt").write_text(f"0 40 {longitude} 1600 0 0 0\n1 40 {longitude + 1e-3} 1600 0 0 0\n")
        motion, origin = read_motion(tmp_path, log, (), Problems())
        assert motion is not None
        found.append((motion.table.values, origin))
    assert found[0][1] == found[1][1] == Datum(40.0, -105.25, 1600.0)
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-6)


@pytest.mark.parametrize("pattern", ["{folder}/front/*.pgm", "front/**/img*.pgm"])
def test_patterns_may_be_absolute_and_reach_into_folders(
    pattern: str, flight: Flight, folder: Path, tmp_path: Path
) -> None:
    tree = yaml.safe_load(kagaru_layout(flight, tmp_path / "layout.yaml").read_text())
    tree["cameras"]["left"]["images"] = pattern.format(folder=folder)
    (tmp_path / "layout.yaml").write_text(yaml.safe_dump(tree))
    assert read_kagaru(folder, tmp_path / "layout.yaml").frame_count == FRAMES


def test_the_layout_that_we_ship_is_valid() -> None:
    layout, run = read_settings(OURS)
    assert layout.cameras.bayer == "rggb"
    assert layout.log.world_axes == "NED"
    assert "imu.gyro_noise" in run


def test_axes_are_right_handed_and_what_their_letters_say() -> None:
    np.testing.assert_array_equal(rotation_to_enu("NED") @ [1.0, 2.0, 3.0], [2.0, 1.0, -3.0])
    np.testing.assert_array_equal(rotation_to_enu("NWU") @ [1.0, 2.0, 3.0], [-2.0, 1.0, 3.0])
    np.testing.assert_array_equal(rotation_to_flu("FRD") @ [1.0, 2.0, 3.0], [1.0, -2.0, -3.0])
    for letters in ("NEU", "NNE", "XYZ", "", "NE"):
        with pytest.raises(ConfigError, match="right-handed"):
            rotation_to_enu(letters)


def test_stamps_of_seconds_since_1970_keep_their_nanoseconds() -> None:
    assert Clock(("1",), ("s",), 0).stamp_ns(["1283212800.123456789"]) == 1_283_212_800_123_456_789
    assert Clock(("1", "2"), ("s", "ns"), -7).stamp_ns(["1283212800", "123456789"]) == 1_283_212_800_123_456_782
    for text in ("soon", "nan", "inf", "1e999999"):
        with pytest.raises(ValueError, match=r"time|NaN"):
            Clock(("1",), ("s",), 0).stamp_ns([text])
    with pytest.raises(ValueError, match="as ROS stamps are"):
        Clock(("1",), ("s",), -1).stamp_ns(["0"])


def test_geodetic_positions_come_back_and_north_is_along_y() -> None:
    datum = Datum(*KAGARU_DATUM)
    points = np.array([[0.0, 0.0, 0.0], [500.0, -300.0, 70.0]])
    np.testing.assert_allclose(from_geodetic(to_geodetic(points, datum), datum), points, atol=1e-6)
    north = from_geodetic(np.array([[KAGARU_DATUM[1], KAGARU_DATUM[0] + 1e-3, KAGARU_DATUM[2]]]), datum)[0]
    np.testing.assert_allclose(north, [0.0, 110.8, 0.0], atol=0.1)  # a thousandth of a degree of the meridian
