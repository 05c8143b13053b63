# SPDX-License-Identifier: Apache-2.0
"""Text files of numbers with a stamp in each row; a row that can't be read is reported and left out."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.errors import BagError
from uav_vslam.ins.gaps import FASTEST_HZ
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

UNREADABLE, REPEATED, SORTED_IN = "lines that can't be read", "lines that repeat a stamp", "lines out of order"
LATEST_S = 2**31 - 1  # seconds of a ROS stamp, which are signed and 32 bits
NORM_OFF = 0.01  # of a quaternion with two decimals; more is no rounding


@dataclass(frozen=True, slots=True)
class Table:
    """Rows in stamp order: (N,) stamps [ns] and (N, C) numbers."""

    stamps_ns: NDArray[np.int64]
    values: Array

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def at(self, stamps_ns: NDArray[np.int64]) -> Array:
        """Return the (M, C) rows at (M,) stamps [ns], linear between rows; beyond the ends the last one holds."""
        start_ns = self.stamps_ns[0]
        times = self.stamps_ns - start_ns
        return np.column_stack([np.interp(stamps_ns - start_ns, times, column) for column in self.values.T])


def read_text(path: Path) -> str:
    """Return the content of a text file.

    Raises:
        BagError: it can't be read.
    """
    try:
        return path.read_text(encoding="utf-8-sig", errors="replace")  # editors may write a byte order mark
    except OSError as error:
        raise BagError(f"{path}: can't be read ({error.strerror})") from None


def numbered_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield number and text of the lines that are neither empty nor comments (#).

    Raises:
        BagError: the file can't be read.
    """
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line


def numbers(fields: Sequence[str]) -> list[float]:
    """Return finite numbers.

    Raises:
        ValueError: one is none.
    """
    values = [float(text) for text in fields]
    if not all(map(math.isfinite, values)):
        raise ValueError(f"{', '.join(fields)} are not all finite")
    return values


def in_range(stamp_ns: int) -> int:
    """Return a stamp [ns] that ROS can hold.

    Raises:
        ValueError: it is another one.
    """
    if not 0 <= stamp_ns < (LATEST_S + 1) * NS_PER_S:
        raise ValueError("the stamp is not within 0 and 2^31 s, as ROS stamps are")
    return stamp_ns


def whole_ns(text: str) -> int:
    """Return a stamp [ns] that is written in digits alone: a float of seconds since 1970 has lost its nanoseconds.

    Raises:
        ValueError: it is none, or ROS can't hold it.
    """
    try:
        stamp_ns = int(text)
    except ValueError:
        raise ValueError(f"the stamp {text.strip()!r} is no whole number of nanoseconds") from None
    return in_range(stamp_ns)


def require_unit(quaternion: Sequence[float]) -> None:
    """Refuse a quaternion that rounding can't have made of one of unit length.

    Raises:
        ValueError: it is one.
    """
    norm = math.hypot(*quaternion)
    if abs(norm - 1.0) > NORM_OFF:
        raise ValueError(f"the quaternion's norm is {norm:g}, not 1")


def read_imu_table(path: Path, problems: Problems) -> Table:
    """Read a csv file of stamps [ns], angular rate [rad/s] and specific force [m/s^2], as EuRoC has it.

    Raises:
        BagError: the file can't be read or has no valid row, or the stamps are in another unit.
    """
    readings = read_table(path, 6, problems)
    require_rate_of_an_imu(readings, path)
    return readings


def read_table(
    path: Path, columns: int, problems: Problems, *, check: Callable[[list[float]], None] | None = None
) -> Table:
    """Read a csv file whose rows hold a stamp [ns] and numbers; more columns are ignored.

    Args:
        path: the file.
        columns: how many numbers are needed.
        problems: collects rows that are left out.
        check: raises ValueError for numbers that are not valid.

    Raises:
        BagError: the file can't be read or has no valid row.
    """
    rows: list[tuple[int, int, list[float]]] = []
    for line, text in numbered_lines(path):
        fields = text.split(",")
        try:
            stamp, values = whole_ns(fields[0]), numbers(fields[1 : 1 + columns])
            if len(values) < columns:
                raise ValueError(f"it has {len(values)}")
            if check is not None:
                check(values)
        except ValueError as error:
            problems.add(UNREADABLE, path, f"a row must hold a stamp and {columns} numbers ({error})", line=line)
            continue
        rows.append((stamp, line, values))
    return table_of(rows, columns, path, problems)


def require_rate_of_an_imu(readings: Table, path: Path) -> None:
    """Refuse readings that come faster than any IMU's: their stamps are in another unit.

    Raises:
        BagError: they do.
    """
    span_ns = max(1, int(readings.stamps_ns[-1] - readings.stamps_ns[0]))
    rate_hz = (len(readings) - 1) * NS_PER_S / span_ns
    if rate_hz > FASTEST_HZ:
        raise BagError(f"{path}: {rate_hz:.0f} readings a second, which no IMU gives; check the unit of the stamps")


def table_of(rows: Iterable[tuple[int, int, list[float]]], columns: int, path: Path, problems: Problems) -> Table:
    """Return rows of (stamp [ns], line, numbers) in stamp order; of equal stamps the first row counts.

    Raises:
        BagError: there are none.
    """
    kept: dict[int, list[float]] = {}
    newest: int | None = None
    for stamp, line, values in rows:
        if stamp in kept:
            problems.add(REPEATED, path, f"the stamp {stamp} ns is used twice; this row is left out", line=line)
            continue
        if newest is not None and stamp < newest:
            text = f"the stamp {stamp} ns is before the previous one; sorted in"
            problems.add(SORTED_IN, path, text, line=line, left_out=False)
        kept[stamp] = values
        newest = stamp if newest is None else max(newest, stamp)
    if not kept:
        raise BagError(f"{path}: no row holds a stamp and {columns} numbers")
    stamps = np.array(sorted(kept), np.int64)
    return Table(stamps, np.array([kept[stamp] for stamp in stamps.tolist()]).reshape(-1, columns))
