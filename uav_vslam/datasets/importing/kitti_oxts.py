# SPDX-License-Identifier: Apache-2.0
"""The IMU of KITTI's raw drives [geiger13]: `oxts/{timestamps.txt,data/*.txt}`, best those at 100 Hz.

Each file of `data` is one row: latitude, longitude, altitude, roll, pitch, yaw (0 = east), velocity to north and east,
forward, leftward and upward velocity, acceleration (x forward, y left, z up; at rest +g in z), more accelerations,
angular rate about the same axes, and others that are not used. All in degrees, metres, radians and seconds.
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.camera_calibration import rigid_pose
from uav_vslam.datasets.importing.motion import InitialSigma, Motion, motion_of_poses
from uav_vslam.datasets.importing.pictures import PicturePair, pairs_with_readings
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.importing.tables import (
    UNREADABLE,
    Table,
    in_range,
    numbered_lines,
    numbers,
    read_text,
    table_of,
)
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, rotation_from_rpy
from uav_vslam.types import NS_PER_S, NavEstimate, NavState

COLUMNS = 20  # up to the angular rate
ROLL_PITCH_YAW, NORTH_EAST, UP, ACCEL, GYRO = slice(3, 6), (7, 6), 10, slice(11, 14), slice(17, 20)
SAME_DRIVE_NS = 20_000_000  # times of the benchmark are those of the raw pictures
OXTS_GAP_NS = 500_000_000
SLOW_NS = 50_000_000  # a period beyond this makes poor preintegration
SIGMA = InitialSigma(position_m=0.01, velocity=0.1, attitude_deg=0.2, gyro_bias=1e-3, accel_bias=5e-2)
OXTS_NOISE = {  # of an OXTS RT3003, as GTSAM's example on this set has them
    "imu.gyro_noise": 1.75e-4,
    "imu.accel_noise": 1e-2,
    "imu.gyro_bias_walk": 2.91e-6,
    "imu.accel_bias_walk": 1.67e-4,
}


@dataclass(frozen=True, slots=True)
class OxtsRecording:
    """Readings of a raw drive.

    Attributes:
        imu: rows of angular rate [rad/s] and specific force [m/s^2] in the body.
        motion: attitude and velocity as its navigation filter had them; positions are zero.
        picture_stamps_ns: of the benchmark's pictures and later ones [ns].
        T_velo_imu: pose of the IMU in the laser scanner.
    """

    imu: Table
    motion: Motion
    picture_stamps_ns: NDArray[np.int64]
    T_velo_imu: Pose

    def stamps_of(self, relative_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the stamps of the benchmark's pictures [ns].

        Args:
            relative_ns: (N,) times since the first one, from times.txt [ns].

        Raises:
            BagError: the raw drive's pictures have other times.
        """
        stamps = self.picture_stamps_ns[: len(relative_ns)]
        if len(stamps) < len(relative_ns):
            raise BagError(f"the raw drive has {len(stamps)} pictures from the first one on, not {len(relative_ns)}")
        apart_ns = int(np.abs(stamps - stamps[0] - relative_ns + relative_ns[0]).max())
        if apart_ns > SAME_DRIVE_NS:
            raise BagError(
                f"times.txt and the raw drive's pictures differ by {apart_ns / 1e6:.0f} ms; give the drive of this "
                "sequence, and --first-frame if the sequence begins later than the drive"
            )
        return stamps

    def covered(self, pairs: list[PicturePair]) -> tuple[list[PicturePair], tuple[str, ...]]:
        """Return the pairs between the first and the last reading, and notes."""
        kept, outside = pairs_with_readings(pairs, self.imu)
        notes = []
        if len(pairs) < len(self.picture_stamps_ns):
            notes.append(
                f"the raw drive has {len(self.picture_stamps_ns)} pictures from the first one on, and the sequence "
                f"{len(pairs)}: if that does not begin with the first, give --first-frame"
            )
        notes.extend(outside)
        period_ns = float(np.median(np.diff(self.imu.stamps_ns)))
        if period_ns > SLOW_NS:
            rate = NS_PER_S / period_ns
            notes.append(f"the IMU's rate is {rate:.0f} Hz; the unsynchronised drive (_extract) has 100 Hz")
        return kept, tuple(notes)

    def T_body_cam0(self, T_cam0_velo: Pose | None) -> Pose:
        """Return the pose of camera 0 in the IMU's frame.

        Raises:
            CalibrationError: the sequence does not place the laser scanner.
        """
        if T_cam0_velo is None:
            raise CalibrationError("calib.txt has no row 'Tr:' from the laser scanner to camera 0; it places the IMU")
        return (T_cam0_velo @ self.T_velo_imu).inverse()

    def pose_at(self, stamp_ns: int) -> Pose:
        """Return the attitude at a stamp, at the origin."""
        return self.motion.start(stamp_ns, SIGMA).state.T_map_body

    def start(self, stamp_ns: int, truth: Motion | None, sigma: InitialSigma | None) -> NavEstimate:
        """Return the start state: pose of the poses if there are any, attitude otherwise; velocity of the drive."""
        own = self.motion.start(stamp_ns, sigma or SIGMA)
        if truth is None or not truth.covers(stamp_ns):
            return own
        pose = truth.start(stamp_ns, SIGMA).state.T_map_body
        return NavEstimate(NavState(stamp_ns, pose, own.state.v_map, np.zeros(3), np.zeros(3)), own.covariance)


def read_oxts(folder: Path, *, first_frame: int, image_times: Path | None, problems: Problems) -> OxtsRecording:
    """Read the readings of a raw drive.

    Args:
        folder: DATE/DRIVE/oxts.
        first_frame: number of the sequence's first picture in the drive.
        image_times: timestamps.txt of the drive's camera 0; None: that in image_00 beside `folder`.
        problems: collects rows that are left out.

    Raises:
        BagError: a file is missing, or no row can be read.
        CalibrationError: DATE/calib_imu_to_velo.txt is missing or malformed.
    """
    listed = folder / "timestamps.txt"
    rows: list[tuple[int, int, list[float]]] = []
    for k, (line, text) in enumerate(numbered_lines(listed)):
        path = folder / "data" / f"{k:010d}.txt"
        try:
            row = numbers(path.read_text(encoding="utf-8-sig").split()[:COLUMNS])
            if len(row) < COLUMNS:
                raise ValueError(f"{len(row)} numbers, not {COLUMNS}")
            rows.append((_stamp_ns(text), line, row))
        except (OSError, ValueError) as error:
            problems.add(UNREADABLE, listed, f"{path.name}: {error}", line=line)
    table = table_of(rows, COLUMNS, listed, problems)
    if len(table) < 2:
        raise BagError(f"{listed}: a single reading can be used, which covers no picture; give the whole drive")
    pictures = image_times or folder.parent / "image_00" / "timestamps.txt"
    stamps = np.array([_picture_stamp_ns(pictures, *numbered) for numbered in numbered_lines(pictures)], np.int64)
    date_folder = folder.resolve().parent.parent
    return OxtsRecording(
        Table(table.stamps_ns, np.column_stack([table.values[:, GYRO], table.values[:, ACCEL]])),
        _motion(table, listed),
        stamps[first_frame:],
        _T_velo_imu(date_folder / "calib_imu_to_velo.txt"),
    )


def _motion(table: Table, source: Path) -> Motion:
    quaternions = quaternion_wxyz_from_rotation(rotation_from_rpy(*table.values[:, ROLL_PITCH_YAW].T))
    velocities = table.values[:, [*NORTH_EAST, UP]]
    zeros = np.zeros((len(table), 3))
    return motion_of_poses(
        table.stamps_ns, zeros, quaternions, source=source, velocities_world=velocities, gap_ns=OXTS_GAP_NS
    )


def _picture_stamp_ns(path: Path, line: int, text: str) -> int:
    try:
        return _stamp_ns(text)
    except ValueError as error:  # leaving one out would shift all later pictures
        raise BagError(f"{path}:{line}: {error}; download the file again") from None


def _stamp_ns(text: str) -> int:
    """Return "2011-10-03 12:55:34.997992704" in nanoseconds."""
    seconds, _, fraction = text.strip().partition(".")
    whole = datetime.strptime(seconds, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    return in_range(int(whole.timestamp()) * NS_PER_S + int(fraction.ljust(9, "0")[:9] or 0))


def _T_velo_imu(path: Path) -> Pose:
    """Return the pose in a file with rows `R:` and `T:`."""
    rows = dict(line.split(":", 1) for line in read_text(path).splitlines() if ":" in line)
    try:
        R, t = (np.array(numbers(rows[name].split())).reshape(3, -1) for name in ("R", "T"))
        return rigid_pose(np.column_stack([R, t]), f"{path}: R and T")
    except (KeyError, ValueError) as error:
        raise CalibrationError(f"{path}: rows 'R:' with 9 and 'T:' with 3 numbers are needed ({error})") from None
