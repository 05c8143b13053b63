# SPDX-License-Identifier: Apache-2.0
"""TUM-VI's layout [schubert18] as a flight recording: EuRoC's tables, Kalibr's calibration, fisheye lenses, 16 bits.

Layout: `mav0/{cam0,cam1,imu0,mocap0}/data.csv`, the pictures in `mav0/cam?/data`, and Kalibr's camchain and IMU files
beside mav0, in it, or in `dso`. Body is the IMU's frame. The mocap's world has its z up; it may see the sequence's
begin and end only.
"""

from pathlib import Path

from uav_vslam.datasets.calibration_files import read_calibration
from uav_vslam.datasets.flight_writer import FlightRecording
from uav_vslam.datasets.importing.euroc import asl_pairs
from uav_vslam.datasets.importing.motion import InitialSigma, Motion, imu_samples, motion_of_poses
from uav_vslam.datasets.importing.pictures import covered_pairs, frames, pairs_with_readings, shifted, uncovered_text
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.importing.rigs import rig_of_files
from uav_vslam.datasets.importing.source import IN_FLIGHT, Source
from uav_vslam.datasets.importing.tables import read_imu_table, read_table, require_unit
from uav_vslam.errors import BagError, CalibrationError

TRUTH_FILE = "mav0/mocap0/data.csv"
CALIBRATION_FOLDERS = (".", "dso", "mav0")
CAMERA_FILES, IMU_FILES = ("camchain-imucam*.yaml", "camchain*.yaml"), ("imu*.yaml",)
SETTINGS = {  # of a hand-held rig with a baseline of 0.1 m and small images
    "frontend.max_depth_m": 30.0,
    "frontend.search_scale": 1.0,
    "frontend.scale": 1.0,
    "backend.depth_sigma_ratio": 0.0,
    "backend.retention": "most_observed",
}


def read_tumvi(
    folder: Path,
    *,
    vehicle: str = "uav1",
    sigma: InitialSigma | None = None,
    calibration: tuple[Path, ...] = (),
    problems: Problems | None = None,
) -> Source:
    """Read a sequence; it starts at the first image pair with readings and, if there is any, ground truth.

    Args:
        folder: that holds mav0.
        vehicle: its ROS namespace.
        sigma: stated uncertainty of the start state.
        calibration: files of Kalibr; empty: those that are found.
        problems: collects what is left out.

    Raises:
        BagError: a file is missing or malformed, or no images pair up.
        CalibrationError: no calibration is found, or it lacks a camera or the IMU.
    """
    problems = problems or Problems()
    if not (folder / "mav0").is_dir():
        raise BagError(f"{folder} has no folder mav0; give the folder that holds it")
    files = calibration or _calibration_files(folder)
    rig, offset_ns = rig_of_files(files)
    imu = read_imu_table(folder / "mav0" / "imu0" / "data.csv", problems)
    recorded = shifted(asl_pairs(folder / "mav0", problems), offset_ns)
    pairs, without = pairs_with_readings(recorded, imu)
    notes = [f"calibration: {', '.join(map(str, files))}", *without]
    truth = _truth(folder / TRUTH_FILE, problems)
    pairs, outside = covered_pairs(pairs, truth, lacking=f"no {TRUTH_FILE}")
    notes.extend(outside)
    offset = f"images are stamped {offset_ns / 1e6:+.3f} ms, the clock offset in the calibration"
    if not pairs:
        text = uncovered_text(recorded, imu, truth) + (f" ({offset})" if offset_ns else "")
        raise BagError(f"{folder}: {text}; check the stamps in data.csv")
    if offset_ns:
        notes.append(offset)
    flight = FlightRecording(
        vehicle=vehicle,
        rig=rig,
        imu=imu_samples(imu),
        truth=truth.samples(imu) if truth else (),
        frames=frames(pairs, rig, problems),
        initial=truth.start(pairs[0].stamp_ns, sigma or InitialSigma()) if truth else None,
    )
    settings = {**SETTINGS, **read_calibration(files).noise, **({} if truth else IN_FLIGHT)}
    return Source(flight, len(pairs), settings=settings, notes=tuple(notes))


def _calibration_files(folder: Path) -> tuple[Path, ...]:
    """Return Kalibr's files of a sequence: the first camera file, and the first IMU file if there is one.

    Raises:
        CalibrationError: there is no camera file.
    """
    found = []
    for patterns in (CAMERA_FILES, IMU_FILES):
        matches = (path for name in CALIBRATION_FOLDERS for p in patterns for path in sorted((folder / name).glob(p)))
        found.append(next(matches, None))
    cameras, imu = found
    if cameras is None:
        raise CalibrationError(f"{folder}: no {' or '.join(CAMERA_FILES)} there, in dso or in mav0; use --calibration")
    return (cameras, imu) if imu else (cameras,)


def _truth(path: Path, problems: Problems) -> Motion | None:
    if not path.is_file():
        return None
    try:
        table = read_table(path, 7, problems, check=lambda row: require_unit(row[3:7]))
    except BagError as error:
        raise BagError(f"{error}; without this file the flight is imported to start in flight") from None
    return motion_of_poses(table.stamps_ns, table.values[:, :3], table.values[:, 3:7], source=path)
