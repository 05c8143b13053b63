# SPDX-License-Identifier: Apache-2.0
"""Writes a simulated flight as the folders of data sets that are no bags, in their units, axes and file formats."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import yaml

from uav_vslam.datasets.flight_writer import FlightRecording, SourceFrame, SourceImage, write_flights
from uav_vslam.datasets.messages import TruthSample
from uav_vslam.evaluation.files.geodetic import Datum, to_geodetic
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rpy_from_rotation, so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, NavState, StereoFrame

T_VELO_IMU = Pose(so3_exp([0.01, -0.02, 0.03]), np.array([-0.8, 0.3, -0.8]))
SCENARIO = Scenario(frames=24, scale=0.25, vehicles=1, seed=5, noise_sigma=1.0)


@dataclass(frozen=True, slots=True)
class Flight:
    """A simulated vehicle, its images, and the state at its first frame."""

    vehicle: SimulatedVehicle
    frames: Sequence[StereoFrame]

    @property
    def start(self) -> NavState:
        """The true state at the first frame, with the biases unknown."""
        true = self.vehicle.true_state(self.frames[0].stamp_ns)
        return dataclasses.replace(true, gyro_bias=np.zeros(3), accel_bias=np.zeros(3))


def fly(rig: StereoRig | None = None, scenario: Scenario = SCENARIO) -> Flight:
    """Fly and render, with another rig than the simulator's own if given."""
    vehicle = simulate_vehicle(scenario, 0)
    vehicle = dataclasses.replace(vehicle, rig=rig or vehicle.rig)
    return Flight(vehicle, list(RenderedFlight(vehicle)))


def truth_of(flight: Flight, stamps_ns: Sequence[int]) -> list[TruthSample]:
    """Return the true motion at stamps."""
    states = [flight.vehicle.true_state(stamp) for stamp in stamps_ns]
    return [TruthSample(state.stamp_ns, state.T_map_body, state.v_map, np.zeros(3)) for state in states]


def write_direct(
    flight: Flight,
    out: Path,
    *,
    covariance: np.ndarray,
    origin: np.ndarray | None = None,
    frames: Sequence[StereoFrame | SourceFrame] = (),
) -> Path:
    """Record the flight without a detour, from its true state.

    Args:
        flight: the flight.
        out: bag to make.
        covariance: (15, 15) of the start state.
        origin: (3,) subtracted from positions [m].
        frames: other images than the flight's; empty for those.
    """
    shift = Pose(np.eye(3), np.zeros(3) if origin is None else -origin)
    start = dataclasses.replace(flight.start, T_map_body=shift @ flight.start.T_map_body)
    truth = truth_of(flight, flight.vehicle.frame_stamps_ns.tolist())
    recording = FlightRecording(
        flight.vehicle.name,
        flight.vehicle.rig,
        flight.vehicle.imu.samples(),
        [dataclasses.replace(sample, T_world_body=shift @ sample.T_world_body) for sample in truth],
        frames or flight.frames,
        NavEstimate(start, covariance),
    )
    write_flights(out, [recording])
    return out


def fisheye_rig() -> StereoRig:
    """Return a rig like TUM-VI's: equidistant lenses and small square images, looking down."""
    lens = np.array([0.0034, 0.0007, -0.002, 0.0002])
    left = PinholeCamera(256, 256, 330.0, 331.0, 127.0, 128.5, lens, "equidistant")
    right = PinholeCamera(256, 256, 332.0, 329.5, 126.0, 127.5, 2.0 * lens, "equidistant")
    down = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    T_left_right = Pose(so3_exp([0.002, -0.003, 0.001]), np.array([0.8, 0.01, 0.0]))
    T_body_left = Pose(down, np.array([0.1, 0.05, -0.02]))
    return StereoRig(left, right, T_body_left, T_body_left @ T_left_right)


def rectified_rig() -> StereoRig:
    """Return a rig like KITTI's: two equal, parallel cameras without distortion, looking down."""
    camera = PinholeCamera(320, 240, 410.0, 410.0, 160.5, 117.25)
    T_body_left = Pose(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0.3, 0.1, -0.2]))
    return StereoRig(camera, camera, T_body_left, T_body_left @ Pose(np.eye(3), np.array([0.8, 0.0, 0.0])))


def write_tumvi(flight: Flight, folder: Path, *, timeshift_s: float = 0.0) -> Path:
    """Write TUM-VI's layout: 16-bit pictures, Kalibr's files, poses at 120 Hz whose quaternions change sign."""
    cameras = ((flight.vehicle.rig.left, flight.vehicle.rig.T_body_left, "left"),)
    cameras += ((flight.vehicle.rig.right, flight.vehicle.rig.T_body_right, "right"),)
    chain = {}
    for k, (camera, T_body_cam, side) in enumerate(cameras):
        data = folder / "mav0" / f"cam{k}" / "data"
        data.mkdir(parents=True)
        rows = ["#timestamp [ns],filename"]
        for frame in flight.frames:
            stamp = frame.stamp_ns - round(timeshift_s * NS_PER_S)
            cv2.imwrite(str(data / f"{stamp}.png"), np.asarray(getattr(frame, side), np.uint16) * 257)
            rows.append(f"{stamp},{stamp}.png")
        (data.parent / "data.csv").write_text("\n".join(rows) + "\n")
        chain[f"cam{k}"] = {
            "camera_model": "pinhole",
            "distortion_model": "equidistant",
            "distortion_coeffs": camera.distortion.tolist(),
            "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
            "resolution": [camera.width, camera.height],
            "T_cam_imu": T_body_cam.inverse().matrix.tolist(),
            "timeshift_cam_imu": timeshift_s,
        }
    (folder / "dso").mkdir()
    (folder / "dso" / "camchain.yaml").write_text(yaml.safe_dump(chain))
    noise = {"gyroscope_noise_density": 1.6e-4, "accelerometer_noise_density": 2.8e-3}
    (folder / "dso" / "imu_config.yaml").write_text(yaml.safe_dump(noise))
    readings = [_row(s.stamp_ns, *s.gyro, *s.accel) for s in flight.vehicle.imu.samples()]
    _write_rows(folder / "mav0" / "imu0" / "data.csv", "#timestamp [ns],w,w,w,a,a,a", readings)
    stamps = range(flight.frames[0].stamp_ns, flight.frames[-1].stamp_ns + 1, NS_PER_S // 120)
    poses = [
        _row(s.stamp_ns, *s.T_world_body.t, *((-1.0) ** k * s.T_world_body.quaternion_wxyz))
        for k, s in enumerate(truth_of(flight, [*stamps, flight.frames[-1].stamp_ns]))
    ]
    _write_rows(folder / "mav0" / "mocap0" / "data.csv", "#timestamp [ns],p,p,p,qw,qx,qy,qz", poses)
    return folder


def write_kitti(flight: Flight, root: Path) -> tuple[Path, Path]:
    """Write a sequence of KITTI's odometry benchmark and the oxts folder of its raw drive; return both."""
    rig, sequence, drive = flight.vehicle.rig, root / "sequences" / "03", root / "raw" / "date" / "drive_extract"
    stamps = flight.vehicle.frame_stamps_ns
    for k, side in enumerate(("left", "right")):
        (sequence / f"image_{k}").mkdir(parents=True)
        for number, frame in enumerate(flight.frames):
            cv2.imwrite(str(sequence / f"image_{k}" / f"{number:06d}.png"), getattr(frame, side))
    P0 = np.column_stack([rig.left.K, np.zeros(3)])
    P1 = np.column_stack([rig.left.K, rig.left.K @ rig.T_right_left.t])
    Tr = (rig.T_body_left.inverse() @ T_VELO_IMU.inverse()).matrix[:3]
    rows = [
        f"{name}: {_words(matrix)}" for name, matrix in (("P0", P0), ("P1", P1), ("P2", P0), ("P3", P1), ("Tr", Tr))
    ]
    (sequence / "calib.txt").write_text("\n".join(rows) + "\n")
    (sequence / "times.txt").write_text("".join(f"{(s - stamps[0]) / NS_PER_S:.6e}\n" for s in stamps))
    poses = [s.T_world_body @ rig.T_body_left for s in truth_of(flight, stamps.tolist())]
    (root / "poses").mkdir()
    lines = [_words((poses[0].inverse() @ pose).matrix[:3]) for pose in poses]
    (root / "poses" / "03.txt").write_text("\n".join(lines) + "\n")
    _write_oxts(flight, drive)
    return sequence, drive / "oxts"


def _write_oxts(flight: Flight, drive: Path) -> None:
    (drive / "oxts" / "data").mkdir(parents=True)
    (drive / "image_00").mkdir()
    samples = flight.vehicle.imu.samples()
    for k, sample in enumerate(samples):
        state = flight.vehicle.true_state(sample.stamp_ns)
        v = state.v_map
        row = [0.0, 0.0, 0.0, *rpy_from_rotation(state.T_map_body.R), v[1], v[0], 0.0, 0.0, v[2]]
        row += [*sample.accel, 0.0, 0.0, 0.0, *sample.gyro, 0.0, 0.0, 0.0]
        (drive / "oxts" / "data" / f"{k:010d}.txt").write_text(_words(row))
    _write_times(drive / "oxts" / "timestamps.txt", [sample.stamp_ns for sample in samples])
    _write_times(drive / "image_00" / "timestamps.txt", flight.vehicle.frame_stamps_ns.tolist())
    R, t = T_VELO_IMU.R, T_VELO_IMU.t
    (drive.parent / "calib_imu_to_velo.txt").write_text(f"calib_time: 25-May-2012\nR: {_words(R)}\nT: {_words(t)}\n")


def _write_times(path: Path, stamps_ns: Sequence[int]) -> None:
    whole = [datetime.fromtimestamp(s // NS_PER_S, tz=UTC).strftime("%Y-%m-%d %H:%M:%S") for s in stamps_ns]
    path.write_text("".join(f"{w}.{s % NS_PER_S:09d}\n" for w, s in zip(whole, stamps_ns, strict=True)))


def _write_rows(path: Path, header: str, rows: Sequence[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([header, *rows]) + "\n")


def _row(stamp_ns: int, *values: float) -> str:
    return ",".join([str(stamp_ns), *(repr(float(value)) for value in values)])


def _words(values: object) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


KAGARU_DATUM = (-27.8, 152.9, 60.0)
R_OF_FRD_AND_NED = np.diag([1.0, -1.0, -1.0]), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
TINT = {"r": 1.0, "g": 0.85, "b": 0.6}  # of the grey ground, so that a wrong Bayer pattern shows


def mosaic(grey: np.ndarray, pattern: str) -> np.ndarray:
    """Return the Bayer mosaic of a tinted grey image."""
    tile = np.array([TINT[letter] for letter in pattern]).reshape(2, 2)
    gains = np.tile(tile, (grey.shape[0] // 2, grey.shape[1] // 2))
    return np.asarray(np.rint(grey * gains), np.uint8)


def mosaics(flight: Flight) -> list[SourceFrame]:
    """Return the frames as raw Bayer images, the right ones 1.3 ms later."""
    return [
        SourceFrame(
            SourceImage(frame.stamp_ns, mosaic(frame.left, "rggb"), encoding="bayer_rggb8"),
            SourceImage(frame.stamp_ns + 1_300_000, mosaic(frame.right, "rggb"), encoding="bayer_rggb8"),
        )
        for frame in flight.frames
    ]


def write_kagaru(flight: Flight, folder: Path, *, pattern: str = "rggb", clock_s: float = 0.0) -> Path:
    """Write Bayer pictures, frame times and a log in NED, FRD, degrees and g, whose clock is `clock_s` ahead."""
    for name, side, late_ns in (("front", "left", 0), ("back", "right", 1_300_000)):
        (folder / name).mkdir(parents=True)
        lines = []
        for k, frame in enumerate(flight.frames):
            cv2.imwrite(str(folder / name / f"img{k}.pgm"), mosaic(getattr(frame, side), pattern))
            lines.append(f"{frame.stamp_ns + late_ns:d}"[:-9] + "." + f"{frame.stamp_ns + late_ns:d}"[-9:])
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    names = "Time,Gyr_X,Gyr_Y,Gyr_Z,Acc_X,Acc_Y,Acc_Z,Roll,Pitch,Yaw,Latitude,Longitude,Altitude,Vel_X,Vel_Y,Vel_Z"
    lines = ["XSens log", names]
    for sample in flight.vehicle.imu.samples():
        stamp = sample.stamp_ns + round(clock_s * NS_PER_S)
        lines.append(f"{stamp // NS_PER_S}.{stamp % NS_PER_S:09d}," + ",".join(_log_row(flight, sample)))
    (folder / "xsens.csv").write_text("\n".join(lines) + "\n")
    return folder


def _log_row(flight: Flight, sample: ImuSample) -> list[str]:
    R_flu_frd, R_enu_ned = R_OF_FRD_AND_NED
    state = flight.vehicle.true_state(sample.stamp_ns)
    R_ned_frd = R_enu_ned.T @ state.T_map_body.R @ R_flu_frd
    longitude, latitude, altitude = to_geodetic(state.T_map_body.t[None], Datum(*KAGARU_DATUM))[0]
    values = [*np.rad2deg(R_flu_frd.T @ sample.gyro), *(R_flu_frd.T @ sample.accel / 9.80665)]
    values += np.rad2deg(rpy_from_rotation(R_ned_frd)).tolist()
    return [f"{v:.9f}" for v in [*values, latitude, longitude, altitude, *(R_enu_ned.T @ state.v_map)]]


def kagaru_layout(flight: Flight, path: Path, **changes: object) -> Path:
    """Write the layout of such a folder; `changes` of its log are by name."""
    rig, R_flu_frd = flight.vehicle.rig, R_OF_FRD_AND_NED[0]
    T_frd_left = Pose(R_flu_frd.T, np.zeros(3)) @ rig.T_body_left
    cameras = {"left": rig.left, "right": rig.right}
    lenses = {side: {"intrinsics": [c.fx, c.fy, c.cx, c.cy]} for side, c in cameras.items()}
    columns = {
        "gyro": ["Gyr_X", "Gyr_Y", "Gyr_Z"],
        "accel": [5, 6, 7],
        "attitude": ["Roll", "Pitch", "Yaw"],
        "position": ["Latitude", "Longitude", "Altitude"],
        "velocity": ["Vel_X", "Vel_Y", "Vel_Z"],
    }
    units = {"gyro_unit": "deg/s", "accel_unit": "g", "body_axes": "FRD", "world_axes": "NED", "delimiter": "comma"}
    log = {"file": "xsens.csv", "header_line": 2, "time_columns": ["Time"], **columns, **units, **changes}
    sides = {"left": {"images": "front/*.pgm", "times": "front.txt"}}
    sides["right"] = {"images": "back/*.pgm", "times": "back.txt"}
    tree = {
        "cameras": {**sides, "bayer": "rggb"},
        "log": log,
        "calibration": {
            "size": [rig.left.width, rig.left.height],
            **lenses,
            "T_imu_left": T_frd_left.matrix.ravel().tolist(),
            "T_left_right": (rig.T_body_left.inverse() @ rig.T_body_right).matrix.ravel().tolist(),
        },
        "datum": list(KAGARU_DATUM),
        "base": "kagaru",
        "run": {"imu": {"gyro_noise": 1.3e-4}},
    }
    path.write_text(yaml.safe_dump(tree))
    return path


def kalibr_in_frd(flight: Flight, folder: Path) -> Path:
    """Write Kalibr's file of the flight's rig, calibrated with a sensor in FRD."""
    rig = flight.vehicle.rig
    T_frd_body = Pose(R_OF_FRD_AND_NED[0].T, np.zeros(3))
    tree = {
        f"cam{k}": {
            "camera_model": "pinhole",
            "distortion_model": "none",
            "distortion_coeffs": [],
            "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
            "resolution": [camera.width, camera.height],
            "T_cam_imu": (T_frd_body @ T_body_cam).inverse().matrix.tolist(),
        }
        for k, (camera, T_body_cam) in enumerate(((rig.left, rig.T_body_left), (rig.right, rig.T_body_right)))
    }
    path = folder / "camchain-imucam.yaml"
    path.write_text(yaml.safe_dump(tree))
    return path
