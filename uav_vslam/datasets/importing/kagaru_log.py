# SPDX-License-Identifier: Apache-2.0
"""The log of a navigation system in our units and axes: readings in the body (FLU), motion in the world (ENU).

The readings are compared with the attitude and the positions of the same log: a wrong unit or axis shows there.
"""

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.importing.axes import rotation_to_enu, rotation_to_flu
from uav_vslam.datasets.importing.columns import read_columns
from uav_vslam.datasets.importing.kagaru_settings import LogSettings
from uav_vslam.datasets.importing.motion import Motion, motion_of_poses
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.importing.tables import Table, require_rate_of_an_imu, require_unit
from uav_vslam.errors import ConfigError
from uav_vslam.evaluation.files.geodetic import Datum, from_geodetic, within_180
from uav_vslam.geometry.rotation import (
    quaternion_wxyz_from_rotation,
    rotation_from_quaternion_wxyz,
    rotation_from_rpy,
    so3_log,
)
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

GRAVITY = 9.80665  # [m/s^2] as "g" of a data sheet
NAVIGATION_GAP_NS = 1_500_000_000  # navigation solutions may come at 1 Hz
FORCE_OFF = 3.0  # [m/s^2] of the mean specific force from gravity, beyond which the log contradicts itself
RATE_OFF = 0.5  # share of the rotations' root mean square that the gyroscope may miss
RATE_PERIOD_NS = 1_000_000_000
LATITUDE_DEG, LONGITUDE_DEG = 90.0, 360.0  # largest; longitudes may be counted from 0 or from -180
FAR_M = 100_000.0  # no flight is so far from the origin of its world
LEAST_TURN = np.deg2rad(1.0)  # in that period; below it is nothing to compare


def read_imu(folder: Path, log: LogSettings, problems: Problems) -> Table:
    """Return rows of angular rate [rad/s] and specific force [m/s^2] in the body.

    Raises:
        ConfigError: the columns are not named.
        BagError: the file can't be read.
    """
    if not (log.file and log.gyro and log.accel):
        raise ConfigError("log.file, log.gyro and log.accel must be given: the graph needs an IMU")
    file = log.text_file(folder / log.file)
    table = read_columns(file, log.clock, [*log.gyro, *log.accel], problems)
    require_rate_of_an_imu(table, file.path)
    R_body_sensor = rotation_to_flu(log.body_axes)
    gyro = table.values[:, :3] * (np.pi / 180.0 if log.gyro_unit == "deg/s" else 1.0)
    accel = table.values[:, 3:] * (GRAVITY if log.accel_unit == "g" else 1.0)
    return Table(table.stamps_ns, np.column_stack([gyro @ R_body_sensor.T, accel @ R_body_sensor.T]))


def read_motion(
    folder: Path, log: LogSettings, datum: tuple[float, ...], problems: Problems
) -> tuple[Motion | None, Datum | None]:
    """Return the motion of the body, if the log has poses, and where its origin is, if that is known.

    Args:
        folder: of the data set.
        log: layout.
        datum: latitude, longitude [deg] and altitude [m] of the origin; empty for the first position.
        problems: collects rows that are left out.

    Raises:
        BagError: the file can't be read.
    """
    if not (log.file and log.attitude and log.position):
        return None, None
    file = log.text_file(folder / log.file)
    columns = [*log.position, *log.attitude, *log.velocity]
    table = read_columns(file, log.clock, columns, problems, check=partial(_check_pose, log=log))
    position, rest = table.values[:, :3], table.values[:, 3:]
    attitude, velocity = rest[:, : len(log.attitude)], rest[:, len(log.attitude) :]
    R_enu_given = rotation_to_enu(log.world_axes)
    R_enu_body = R_enu_given @ _rotations(attitude, log) @ rotation_to_flu(log.body_axes).T
    origin = None
    if log.position_kind == "geodetic":
        latitude, longitude, altitude = datum or position[0].tolist()
        origin = Datum(latitude, float(within_180(longitude)), altitude)
        position_enu = from_geodetic(position[:, [1, 0, 2]], origin)
    else:
        position_enu = position @ R_enu_given.T
    motion = motion_of_poses(
        table.stamps_ns,
        position_enu,
        quaternion_wxyz_from_rotation(R_enu_body),
        source=file.path,
        velocities_world=velocity @ R_enu_given.T if log.velocity else None,
        gap_ns=NAVIGATION_GAP_NS,
    )
    return motion, origin


def _check_pose(row: list[float], *, log: LogSettings) -> None:
    """Refuse a row of position and attitude that is none.

    Raises:
        ValueError: it is one.
    """
    if log.position_kind == "geodetic":
        latitude, longitude = row[:2]
        if abs(latitude) > LATITUDE_DEG or abs(longitude) > LONGITUDE_DEG:
            raise ValueError(f"there is no latitude {latitude:g}, longitude {longitude:g}; check the order of position")
        if latitude == longitude == 0.0:
            raise ValueError("latitude and longitude are 0, as receivers write them without a fix")
    if len(log.attitude) == 4:
        require_unit(row[3:7])


def _rotations(attitude: Array, log: LogSettings) -> Array:
    """Return (N, 3, 3) R from the sensor's to the world's axes, both as the log has them."""
    if attitude.shape[1] == 4:
        return rotation_from_quaternion_wxyz(attitude if log.quaternion_order == "wxyz" else attitude[:, [3, 0, 1, 2]])
    return rotation_from_rpy(*(attitude.T if log.angle_unit == "rad" else np.deg2rad(attitude).T))


def contradictions(imu: Table, motion: Motion) -> list[str]:
    """Return in words where readings and attitude contradict each other, which shows a wrong unit, axis or sign.

    A flight is near the origin of its world. Over a whole one the mean specific force in the world is gravity's
    reaction, and the rotation over a second is the integral of the angular rate.
    """
    inside = imu.stamps_ns[(imu.stamps_ns >= motion.stamps_ns[0]) & (imu.stamps_ns <= motion.stamps_ns[-1])]
    if len(inside) < 2:
        return ["the log's readings and poses have no time in common; check time_columns, time_units, time_offset_s"]
    readings = imu.at(inside)
    R_world_body = rotation_from_quaternion_wxyz(motion.table.at(inside)[:, 3:7])
    found = []
    away_m = float(np.linalg.norm(motion.table.values[:, :3], axis=1).min())
    if away_m > FAR_M:
        found.append(f"the flight is {away_m / 1e3:.0f} km from the origin of the world; check datum and position")
    force = np.einsum("nij,nj->ni", R_world_body, readings[:, 3:]).mean(axis=0)
    if np.linalg.norm(force - [0.0, 0.0, GRAVITY]) > FORCE_OFF:
        east, north, up = force
        found.append(
            f"the mean specific force is {east:.1f} east, {north:.1f} north, {up:.1f} up, not (0, 0, 9.8) m/s^2; check "
            "accel_unit, body_axes, world_axes, angle_unit and the columns of accel and attitude"
        )
    if readings[:, 5].mean() < 0.0:
        found.append("the vehicle is upside down most of the time; check body_axes")
    missed = _missed_rotation(inside, readings[:, :3], R_world_body)
    if missed > RATE_OFF:
        found.append(
            f"the angular rate misses {missed:.0%} of the rotation that the attitude shows; check gyro_unit, "
            "body_axes, angle_unit and the columns of gyro and attitude"
        )
    return found


def _missed_rotation(stamps_ns: NDArray[np.int64], rates: Array, R_world_body: Array) -> float:
    """Return the root mean square difference of attitude and integrated rate, over that of the rotations; 0 at rest."""
    integral = np.vstack([np.zeros(3), np.cumsum(rates[:-1] * np.diff(stamps_ns)[:, None] / NS_PER_S, axis=0)])
    begins = np.searchsorted(stamps_ns, np.arange(stamps_ns[0], stamps_ns[-1], RATE_PERIOD_NS))
    turns = so3_log(np.swapaxes(R_world_body[begins[:-1]], -1, -2) @ R_world_body[begins[1:]])
    size = np.sqrt(np.mean(turns**2)) if len(turns) else 0.0
    if size < LEAST_TURN:
        return 0.0
    return float(np.sqrt(np.mean((integral[begins[1:]] - integral[begins[:-1]] - turns) ** 2)) / size)
