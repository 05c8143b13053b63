# SPDX-License-Identifier: Apache-2.0
"""EuRoC's ASL folder layout as a flight recording; body is the IMU's frame, whose axes are not FLU on that sensor.

Layout: `mav0/{cam0,cam1,imu0,state_groundtruth_estimate0}/{data.csv,sensor.yaml}`, cam0 is left. Images are copied
byte for byte, lens distortion included. The world's z is up; gravity there is 9.81 m/s^2.
"""

import math
from pathlib import Path

import numpy as np

from uav_vslam.datasets.calibration_files import parse_calibration
from uav_vslam.datasets.calibration_tree import yaml_tree
from uav_vslam.datasets.flight_writer import FlightRecording
from uav_vslam.datasets.importing.motion import InitialSigma, Motion, imu_samples
from uav_vslam.datasets.importing.pictures import (
    PicturePair,
    covered_pairs,
    frames,
    paired,
    pairs_with_readings,
    read_list,
    uncovered_text,
)
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.importing.source import IN_FLIGHT, Source
from uav_vslam.datasets.importing.tables import read_imu_table, read_table, read_text, require_unit
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NS_PER_S

TRUTH_FOLDER = "state_groundtruth_estimate0"
TRACKED_S = 0.2  # usual time between images below which points can be tracked


def read_euroc(
    folder: Path, *, vehicle: str = "uav1", sigma: InitialSigma | None = None, problems: Problems | None = None
) -> Source:
    """Read a sequence; it starts at the first image pair with readings and, if there is any, ground truth.

    Args:
        folder: holds cam0, cam1, imu0 and maybe the ground truth, itself or in its `mav0`.
        vehicle: its ROS namespace.
        sigma: stated uncertainty of the start state.
        problems: collects what is left out.

    Raises:
        BagError: a file is missing or malformed, no images pair up, or none has readings and ground truth.
        CalibrationError: a lens is not supported, or the cameras' calibrations contradict each other.
    """
    problems = problems or Problems()
    mav0 = folder if (folder / "cam0").is_dir() else folder / "mav0"
    if not (mav0 / "cam0").is_dir():
        raise BagError(f"{folder} has no folder cam0; give the sequence's mav0 folder")
    left, T_body_left = _camera(mav0 / "cam0")
    right, T_body_right = _camera(mav0 / "cam1")
    imu = read_imu_table(mav0 / "imu0" / "data.csv", problems)
    truth = _truth(mav0 / TRUTH_FOLDER / "data.csv", problems)
    recorded = asl_pairs(mav0, problems)
    pairs, without = pairs_with_readings(recorded, imu)
    pairs, outside = covered_pairs(pairs, truth, lacking=f"no {TRUTH_FOLDER}")
    if not pairs:
        raise BagError(f"{mav0}: {uncovered_text(recorded, imu, truth)}; check the stamps in data.csv")
    rig = StereoRig(left, right, T_body_left, T_body_right)
    flight = FlightRecording(
        vehicle=vehicle,
        rig=rig,
        imu=imu_samples(imu),
        truth=truth.samples(imu) if truth else (),
        frames=frames(pairs, rig, problems),
        initial=truth.start(pairs[0].stamp_ns, sigma or InitialSigma()) if truth else None,
    )
    base = "euroc_video" if _usual_gap_s(pairs) < TRACKED_S else "euroc"
    return Source(flight, len(pairs), base=base, settings={} if truth else IN_FLIGHT, notes=without + outside)


def _truth(path: Path, problems: Problems) -> Motion | None:
    if not path.is_file():
        return None
    return Motion(read_table(path, 16, problems, check=lambda row: require_unit(row[3:7])), path)


def asl_pairs(mav0: Path, problems: Problems) -> list[PicturePair]:
    """Return the pairs of pictures with equal stamps of cam0 and cam1."""
    left, right = (read_list(mav0 / cam / "data.csv", mav0 / cam / "data", problems) for cam in ("cam0", "cam1"))
    return paired(left, right, problems)


def _usual_gap_s(pairs: list[PicturePair]) -> float:
    """Return the median time between pictures [s]; infinity for a single pair."""
    gaps_ns = np.diff([pair.stamp_ns for pair in pairs])
    return float(np.median(gaps_ns)) / NS_PER_S if len(gaps_ns) else math.inf


def _camera(folder: Path) -> tuple[PinholeCamera, Pose]:
    """Return the intrinsics and T_body_cam of a sensor.yaml."""
    path = folder / "sensor.yaml"
    calibration = parse_calibration(yaml_tree(read_text(path), path), path)
    T_body_cam = calibration.T_body_cam(0)
    if T_body_cam is None:
        raise CalibrationError(f"{path}: no camera with T_BS; is it an ASL folder (mav0)?")
    return calibration.cameras[0].camera, T_body_cam
