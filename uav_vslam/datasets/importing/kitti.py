# SPDX-License-Identifier: Apache-2.0
"""A sequence of KITTI's odometry benchmark [geiger12] as a flight recording, with the IMU of its raw drive if given.

Layout: `sequences/NN/{image_0,image_1,image_2,image_3}/NNNNNN.png`, `calib.txt`, `times.txt`, and `poses/NN.txt` beside
`sequences`. The images are rectified; poses are those of camera 0 in its first frame (x right, y down, z forward). The
benchmark has no IMU: body is camera 0 with x forward, y left, z up. With the raw drive (`kitti_oxts`) body is the
IMU's frame, whose axes are these as well, and the world is level, its x to the east.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.camera_calibration import is_rotation, rigid_pose
from uav_vslam.datasets.flight_writer import FlightRecording
from uav_vslam.datasets.importing.kitti_oxts import OXTS_NOISE, OxtsRecording
from uav_vslam.datasets.importing.motion import InitialSigma, Motion, imu_samples, motion_of_poses
from uav_vslam.datasets.importing.pictures import (
    Picture,
    PicturePair,
    existing,
    first_readable,
    frames,
    paired,
    uncovered_text,
)
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.importing.source import Source
from uav_vslam.datasets.importing.tables import UNREADABLE, in_range, numbered_lines, numbers, table_of
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.evaluation.files.kitti_axes import R_FLU_RDF
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

GREY, COLOUR = (0, 1), (2, 3)  # left and right camera
RAW_IMAGES = "image_0?/data"  # below a raw drive
T_FLU_OPTICAL = Pose(R_FLU_RDF, np.zeros(3))
POSE_GAP_NS = 500_000_000  # poses come at 10 Hz
SETTINGS = {  # of a car on a road, with a baseline of 0.54 m
    "frontend.min_depth_m": 3.0,
    "frontend.max_depth_m": 100.0,
    "backend.depth_sigma_ratio": 0.0,
}
NO_IMU = (
    "KITTI odometry has no IMU, and the graph needs one: this bag holds images, calibration and poses only. Import "
    "again with --oxts DRIVE/oxts of the raw drive to run it"
)


@dataclass(frozen=True, slots=True)
class _Calibration:
    """Projection matrices (3, 4) of the rectified cameras by number, and T_cam0_velo or None."""

    projections: dict[int, Array]
    T_cam0_velo: Pose | None
    path: Path


def read_kitti(
    sequence: Path,
    *,
    vehicle: str = "uav1",
    sigma: InitialSigma | None = None,
    colour: bool = False,
    oxts: OxtsRecording | None = None,
    problems: Problems | None = None,
) -> Source:
    """Read a sequence.

    Args:
        sequence: the folder `sequences/NN`.
        vehicle: its ROS namespace.
        sigma: stated uncertainty of the start state.
        colour: use cameras 2 and 3 where there are the grey ones as well.
        oxts: IMU readings of the raw drive; None for none.
        problems: collects what is left out.

    Raises:
        BagError: a file is missing or malformed, no images pair up, or the raw drive is another one.
        CalibrationError: calib.txt lacks something.
    """
    problems = problems or Problems()
    if not (sequence / "calib.txt").exists():
        benchmark = "sequences/NN of the odometry benchmark, with calib.txt, times.txt and image_0"
        if any(sequence.glob(RAW_IMAGES)):
            raise BagError(
                f"{sequence} is a raw drive; give the sequence that was made of it, {benchmark}, and the drive's IMU "
                "by --oxts"
            )
        raise BagError(f"{sequence} has no calib.txt; give the folder of one sequence, {benchmark}")
    cameras = COLOUR if colour or not (sequence / "image_0").is_dir() else GREY
    calibration = _read_calibration(sequence / "calib.txt", problems)
    relative_ns = _times(sequence / "times.txt")
    stamps_ns = oxts.stamps_of(relative_ns) if oxts else relative_ns
    recorded = _pairs(sequence, cameras, stamps_ns, problems)
    if not recorded:
        raise BagError(f"{sequence}: no pictures of image_{cameras[0]} and image_{cameras[1]} pair up")
    pairs, notes = oxts.covered(recorded) if oxts else (recorded, (NO_IMU,))
    if oxts and not pairs:
        raise BagError(f"{sequence}: {uncovered_text(recorded, oxts.imu, None)}; give the drive of this sequence")
    T_body_cam0 = oxts.T_body_cam0(calibration.T_cam0_velo) if oxts else T_FLU_OPTICAL
    T_world_first = oxts.pose_at(int(stamps_ns[0])) if oxts else Pose.identity()
    truth, warnings = _truth(sequence, stamps_ns, T_body_cam0, T_world_first, problems)
    rig = _rig(calibration, cameras, pairs, T_body_cam0)
    flight = FlightRecording(
        vehicle=vehicle,
        rig=rig,
        imu=imu_samples(oxts.imu) if oxts else (),
        truth=truth.samples(oxts.imu if oxts else None) if truth else (),
        frames=frames(pairs, rig, problems),
        initial=oxts.start(pairs[0].stamp_ns, truth, sigma) if oxts else None,
    )
    if truth is None:
        notes += ("no poses of this sequence: nothing can be evaluated",)
    settings = {**SETTINGS, **(OXTS_NOISE if oxts else {})}
    warnings = _beyond_times(sequence, cameras, len(stamps_ns)) + warnings
    return Source(flight, len(pairs), settings=settings, notes=notes, warnings=warnings, runnable=oxts is not None)


def _read_calibration(path: Path, problems: Problems) -> _Calibration:
    """Return the content of calib.txt: `P0:` to `P3:` and `Tr:` with 12 numbers each."""
    matrices: dict[str, Array] = {}
    for line, text in numbered_lines(path):
        name, _, rest = text.partition(":")
        try:
            matrices[name.strip()] = np.array(numbers(rest.split())).reshape(3, 4)
        except ValueError as error:
            problems.add(UNREADABLE, path, f"a row must hold a name and 12 numbers ({error})", line=line)
    projections = {k: matrices[f"P{k}"] for k in range(4) if f"P{k}" in matrices}
    Tr = matrices.get("Tr", matrices.get("Tr_velo_to_cam"))
    return _Calibration(projections, None if Tr is None else rigid_pose(Tr, f"{path}: Tr"), path)


def _times(path: Path) -> NDArray[np.int64]:
    """Return (N,) times of the pictures since the first one [ns]."""
    stamps = []
    for line, text in numbered_lines(path):
        try:
            stamps.append(in_range(round(numbers([text])[0] * NS_PER_S)))
        except (ValueError, OverflowError):  # leaving one out would shift all later pictures
            raise BagError(f"{path}:{line}: {text!r} is no time; download the file again") from None
    if not stamps or np.any(np.diff(stamps) <= 0):
        raise BagError(f"{path}: {len(stamps)} times, which must increase; download the file again")
    return np.array(stamps, np.int64)


def _pairs(
    sequence: Path, cameras: tuple[int, int], stamps_ns: NDArray[np.int64], problems: Problems
) -> list[PicturePair]:
    sides: list[list[Picture]] = []
    for camera in cameras:
        folder = sequence / f"image_{camera}"
        listed = [(stamp, folder / f"{k:06d}.png", k + 1) for k, stamp in enumerate(stamps_ns.tolist())]
        sides.append(existing(listed, sequence / "times.txt", problems))
    left, right = sides
    return paired(left, right, problems)


def _beyond_times(sequence: Path, cameras: tuple[int, int], times: int) -> tuple[str, ...]:
    """Return in words how many pictures have no time: a download that was cut short, or another sequence's file."""
    names = (path.stem for camera in cameras for path in (sequence / f"image_{camera}").glob("*.png"))
    count = sum(name.isdecimal() and int(name) >= times for name in names)
    return (f"{count} pictures are beyond the {times} lines of times.txt, and left out",) if count else ()


def _rig(
    calibration: _Calibration, cameras: tuple[int, int], pairs: Sequence[PicturePair], T_body_cam0: Pose
) -> StereoRig:
    """Return the rig of rectified cameras, P = K [I | t] with t from camera 0 to this one."""
    readable = first_readable(pairs)
    if readable is None:
        raise BagError(f"{pairs[0].left.path}: no pair from it on can be decoded, and the image size must be known")
    sides = []
    for number, pixels in zip(cameras, readable[1:], strict=True):
        if number not in calibration.projections:
            raise CalibrationError(f"{calibration.path}: no row 'P{number}:' with 12 numbers")
        P = calibration.projections[number]
        K = P[:, :3]
        if np.any(np.tril(K, -1)) or np.any(K.diagonal() <= 0.0):
            raise CalibrationError(f"{calibration.path}: P{number} is no K [I | t] with focal lengths above 0")
        t_cam_cam0 = np.linalg.solve(K, P[:, 3])
        camera = PinholeCamera(pixels.shape[1], pixels.shape[0], K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        sides.append((camera, T_body_cam0 @ Pose(np.eye(3), np.asarray(-t_cam_cam0, float))))
    (left, T_body_left), (right, T_body_right) = sides
    return StereoRig(left, right, T_body_left, T_body_right)


def _truth(
    sequence: Path, stamps_ns: NDArray[np.int64], T_body_cam0: Pose, T_world_first: Pose, problems: Problems
) -> tuple[Motion | None, tuple[str, ...]]:
    """Return the motion of the body, None if the sequence has no poses, and a warning if rows are missing."""
    path = sequence.resolve().parent.parent / "poses" / f"{sequence.resolve().name}.txt"
    if not path.is_file():
        return None, ()
    lines = list(numbered_lines(path))
    rows: list[tuple[int, int, list[float]]] = []
    for k, (line, text) in enumerate(lines):
        try:
            row = numbers(text.split())
            if len(row) != 12 or k >= len(stamps_ns):
                raise ValueError(f"{len(row)} numbers in row {k + 1} of {len(stamps_ns)}")
            if not is_rotation(np.array(row).reshape(3, 4)[:, :3]):
                raise ValueError("its first three columns are no rotation")
            rows.append((int(stamps_ns[k]), line, row))
        except ValueError as error:
            problems.add(UNREADABLE, path, f"a row must be a 3x4 pose of a picture ({error})", line=line)
    table = table_of(rows, 12, path, problems)
    T_cam0_body = T_body_cam0.inverse()
    T_world_cam0 = T_world_first @ T_body_cam0
    poses = [T_world_cam0 @ Pose(M[:, :3], M[:, 3]) @ T_cam0_body for M in table.values.reshape(-1, 3, 4)]
    quaternions = quaternion_wxyz_from_rotation(np.array([pose.R for pose in poses]))
    positions = np.array([pose.t for pose in poses])
    motion = motion_of_poses(table.stamps_ns, positions, quaternions, source=path, gap_ns=POSE_GAP_NS)
    if len(lines) >= len(stamps_ns):
        return motion, ()
    text = f"{path} has {len(lines)} rows for {len(stamps_ns)} pictures, and they count for the first ones"
    return motion, (f"{text}; if a row before the last is missing, all after it are wrong",)
