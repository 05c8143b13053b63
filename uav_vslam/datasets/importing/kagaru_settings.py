# SPDX-License-Identifier: Apache-2.0
"""How a folder of pictures, times and a log is laid out: what `config/import/kagaru.yaml` can say."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uav_vslam.config.files import read_yaml
from uav_vslam.config.settings import Settings, build, check_names, flattened, refuse, setting
from uav_vslam.datasets.importing.columns import DELIMITERS, UNITS_NS, Clock, TextFile
from uav_vslam.datasets.importing.tables import LATEST_S
from uav_vslam.errors import ConfigError
from uav_vslam.types import NS_PER_S

BAYER = ("none", "rggb", "bggr", "gbrg", "grbg")


@dataclass(frozen=True, slots=True)
class _TimedSettings(Settings):
    """A text file with stamps."""

    delimiter: str = setting("space", "between columns; space: any white space", choices=DELIMITERS)
    header_line: int = setting(0, "line with the names of the columns, from 1; 0: none", at_least=0)
    time_columns: tuple[str, ...] = setting(("1",), "columns that add up to the stamp, by name or number from 1")
    time_units: tuple[str, ...] = setting(("s",), f"unit of each of them: {', '.join(UNITS_NS)}")
    time_offset_s: float = setting(0.0, "added to the stamps", unit="s", at_least=-LATEST_S, at_most=LATEST_S)

    def _check_together(self) -> None:
        if len(self.time_units) != len(self.time_columns) or not set(self.time_units) <= set(UNITS_NS):
            refuse("time_units", list(self.time_units), f"one of {', '.join(UNITS_NS)} for each of time_columns")

    @property
    def clock(self) -> Clock:
        """How its stamps are written."""
        return Clock(self.time_columns, self.time_units, round(self.time_offset_s * NS_PER_S))

    def text_file(self, path: Path) -> TextFile:
        """Return one of these files."""
        return TextFile(path, self.delimiter, self.header_line)


@dataclass(frozen=True, slots=True)
class SideSettings(Settings):
    """Files of one camera, relative to the data set's folder."""

    images: str = setting("", "pattern of the pictures, e.g. front/*.pgm; img2 counts before img10")
    times: str = setting("", "file with a line for each picture; empty: the last number in a file's name is its stamp")


@dataclass(frozen=True, slots=True)
class CamerasSettings(_TimedSettings):
    """Pictures of both cameras."""

    name_column: str = setting("", "column of the picture's file name; empty: lines are in the order of the pictures")
    pair_tolerance_s: float = setting(0.005, "largest difference between the stamps of a pair", unit="s", at_least=0)
    bayer: str = setting("none", "colours of the first two pixels of the first two rows", choices=BAYER)
    left: SideSettings = field(default_factory=SideSettings)
    right: SideSettings = field(default_factory=SideSettings)


@dataclass(frozen=True, slots=True)
class LogSettings(_TimedSettings):
    """A log of an IMU or a navigation system; columns by name or number from 1."""

    file: str = setting("", "relative to the data set's folder")
    gyro: tuple[str, ...] = setting((), "columns of the angular rate x, y, z")
    gyro_unit: str = setting("rad/s", "of the angular rate", choices=("rad/s", "deg/s"))
    accel: tuple[str, ...] = setting((), "columns of the specific force x, y, z: at rest it points up")
    accel_unit: str = setting("m/s^2", "of the specific force", choices=("m/s^2", "g"))
    attitude: tuple[str, ...] = setting((), "columns of roll, pitch, yaw (R = Rz Ry Rx), or of a quaternion")
    angle_unit: str = setting("deg", "of roll, pitch and yaw", choices=("deg", "rad"))
    quaternion_order: str = setting("wxyz", "of a quaternion, which turns body to world", choices=("wxyz", "xyzw"))
    position: tuple[str, ...] = setting((), "columns of latitude, longitude [deg], altitude [m], or x, y, z [m]")
    position_kind: str = setting("geodetic", "which of both", choices=("geodetic", "local"))
    velocity: tuple[str, ...] = setting((), "columns of the velocity [m/s] along the world's axes; empty: differences")
    body_axes: str = setting("FLU", "x, y, z of the sensor: forward, back, left, right, up, down")
    world_axes: str = setting("ENU", "x, y, z of the world: north, south, east, west, up, down")

    def _check_together(self) -> None:
        super(LogSettings, self)._check_together()
        sizes = {"gyro": (0, 3), "accel": (0, 3), "attitude": (0, 3, 4), "position": (0, 3), "velocity": (0, 3)}
        for name, allowed in sizes.items():
            columns = getattr(self, name)
            if len(columns) not in allowed:
                refuse(name, list(columns), f"{' or '.join(map(str, allowed[1:]))} columns")


@dataclass(frozen=True, slots=True)
class LensSettings(Settings):
    """Intrinsics of one camera."""

    intrinsics: tuple[float, ...] = setting((), "fx, fy, cx, cy [px]")
    distortion: tuple[float, ...] = setting((), "coefficients of the model; trailing zeros may be missing")
    model: str = setting("plumb_bob", "distortion model: plumb_bob, rational_polynomial, equidistant")


@dataclass(frozen=True, slots=True)
class CalibrationSettings(Settings):
    """Files, or values; poses are in the axes of the log's sensor."""

    files: tuple[Path, ...] = setting((), "of Kalibr or EuRoC with the place of the IMU, relative to this file")
    size: tuple[float, ...] = setting((), "width and height of the pictures [px]")
    left: LensSettings = field(default_factory=LensSettings)
    right: LensSettings = field(default_factory=LensSettings)
    T_imu_left: tuple[float, ...] = setting((), "pose of the left camera at the sensor, 4x4 by rows")
    T_left_right: tuple[float, ...] = setting((), "pose of the right camera in the left one, 4x4 by rows")


@dataclass(frozen=True, slots=True)
class KagaruSettings(Settings):
    """The layout of a data set."""

    cameras: CamerasSettings = field(default_factory=CamerasSettings)
    log: LogSettings = field(default_factory=LogSettings)
    truth: LogSettings = field(default_factory=LogSettings)
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    datum: tuple[float, ...] = setting((), "of the origin: latitude, longitude [deg], altitude [m]; empty: first row")
    start_sigma: tuple[float, ...] = setting(
        (0.1, 0.1, 0.5, 1e-3, 5e-2), "of the start's position, velocity, attitude [deg], gyro and accelerometer bias"
    )
    base: str = setting("", "name of one of our configurations that suits the flight; empty: the defaults")

    def _check_together(self) -> None:
        if len(self.start_sigma) != 5 or min(self.start_sigma) <= 0.0:
            refuse("start_sigma", list(self.start_sigma), "5 numbers above 0")
        if len(self.datum) not in (0, 3):
            refuse("datum", list(self.datum), "latitude, longitude and altitude, or []")

    @property
    def navigation(self) -> LogSettings:
        """The log that holds the ground truth."""
        return self.truth if self.truth.file else self.log


def read_settings(path: Path) -> tuple[KagaruSettings, dict[str, Any]]:
    """Read a layout.

    Returns:
        The layout, and by dotted name the settings of the run that its section `run` holds.

    Raises:
        ConfigError: the file can't be read, or a key or value is wrong.
    """
    tree = read_yaml(path)
    run = tree.pop("run", None) or {}
    if not isinstance(run, Mapping):
        raise ConfigError(f"{path}: run must hold settings of a vehicle, such as imu: {{gyro_noise: 1e-3}}")
    values = {name: _as_columns(name, value) for name, value in flattened(tree)}
    check_names(values, KagaruSettings, beside=("run",), where=str(path))
    layout = build(KagaruSettings, values, where=str(path))
    return layout, dict(flattened(run))


def _as_columns(name: str, value: Any) -> Any:
    """Return a value with columns that are given by number as texts, which the settings of columns are."""
    key = name.rpartition(".")[2]
    if key == "name_column" and isinstance(value, int):
        return str(value)
    if key in {"time_columns", "gyro", "accel", "attitude", "position", "velocity"} and isinstance(value, list):
        return [str(one) for one in value]
    return value
