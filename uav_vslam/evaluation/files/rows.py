# SPDX-License-Identifier: Apache-2.0
"""Rows of numbers of a text file; errors name file and line."""

from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation, Overflow
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import TrajectoryFileError
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

EPOCH_NS = 10**17  # from here on a stamp is ns since 1970: as seconds it would be the year 3 billion
LATEST_S = 10**11  # no clock counts so many seconds: the year 5138
LARGEST_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Rows:
    """Rows with the same number of cells.

    Attributes:
        path: of the file.
        lines: line number of each row, from 1.
        cells: the text of each row.
        header: cells of the last comment or title before the first row; empty without one.
        commas: whether commas separate the cells, not white space.
    """

    path: Path
    lines: list[int]
    cells: list[list[str]]
    header: list[str]
    commas: bool

    @property
    def columns(self) -> int:
        """Number of cells of each row."""
        return len(self.cells[0])

    def at(self, row: int) -> str:
        """Return file and line of a row, for an error."""
        return f"{self.path}:{self.lines[row]}"

    def numbers(self, first: int, last: int) -> Array:
        """Return the columns first to last - 1.

        Raises:
            TrajectoryFileError: a cell holds no finite number.
        """
        try:
            values = np.array([cells[first:last] for cells in self.cells], dtype=float)
        except ValueError:
            values = np.array([[_number(cell) for cell in cells[first:last]] for cells in self.cells])
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            row, column = bad[0]
            found = self.cells[row][first + column]
            raise TrajectoryFileError(
                f"{self.at(row)}: column {first + column + 1} holds {found!r}, not a finite number; correct or remove "
                "the line"
            )
        return values

    def stamps_ns(self, *, seconds: bool) -> NDArray[np.int64]:
        """Return the first column as stamps [ns]; ns since 1970 are recognised also where seconds are expected.

        Args:
            seconds: whether small numbers are seconds, not nanoseconds.

        Raises:
            TrajectoryFileError: a stamp is no number, is in no known unit, or does not increase.
        """
        stamps_ns = np.array([self._stamp(row, seconds=seconds) for row in range(len(self.cells))], np.int64)
        wrong = np.flatnonzero(np.diff(stamps_ns) <= 0)
        if len(wrong):
            row = int(wrong[0]) + 1
            raise TrajectoryFileError(
                f"{self.at(row)}: the stamp {self.cells[row][0]} is not after {self.cells[row - 1][0]} of line "
                f"{self.lines[row - 1]}; sort the lines by time and remove repeated stamps"
            )
        return stamps_ns

    def _stamp(self, row: int, *, seconds: bool) -> int:
        text = self.cells[row][0]
        try:
            value = +Decimal(text)  # a float would lose the last digits
        except (InvalidOperation, Overflow):
            value = Decimal("nan")
        if not value.is_finite():
            raise TrajectoryFileError(f"{self.at(row)}: the stamp {text!r} is not a number; correct or remove the line")
        stamp = round(value * NS_PER_S) if seconds and abs(value) < EPOCH_NS else round(value)
        if abs(stamp) > LARGEST_NS or (seconds and LATEST_S <= abs(value) < EPOCH_NS):
            raise TrajectoryFileError(
                f"{self.at(row)}: the stamp {text} is neither in seconds nor in nanoseconds since 1970; convert it"
            )
        return stamp


def read_rows(path: Path) -> Rows:
    """Read the rows of a file; `#` begins a comment, and a first row without a number is a title.

    Raises:
        TrajectoryFileError: the file is missing, is no text, holds no row, or rows differ in length.
    """
    header: list[str] = []
    lines: list[int] = []
    cells: list[list[str]] = []
    text = _text(path)
    commas = any("," in line for line in text.splitlines() if not line.lstrip().startswith("#"))
    for number, row, is_comment in _split(text, commas=commas):
        if not cells and (is_comment or (not np.isfinite(_number(row[0])) and not _like_number(row[0]))):
            header = row
        elif not is_comment:
            lines.append(number)
            cells.append(row)
            if len(row) != len(cells[0]):
                raise TrajectoryFileError(
                    f"{path}:{number}: {len(row)} columns, but line {lines[0]} has {len(cells[0])}; complete or remove "
                    "the line"
                )
    if not cells:
        raise TrajectoryFileError(f"{path} holds no poses; is it a trajectory, or was the run interrupted?")
    return Rows(path, lines, cells, header, commas)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise TrajectoryFileError(f"{path} is not a text file; expected a trajectory as TUM, KITTI or EuRoC") from None
    except OSError as error:
        remedy = "name a trajectory file of TUM, KITTI or EuRoC"
        raise TrajectoryFileError(f"{path} can't be read: {error.strerror}; {remedy}") from None


def _split(text: str, *, commas: bool) -> Iterator[tuple[int, list[str], bool]]:
    """Yield line number, cells, and whether the line is a comment; empty lines are left out."""
    for number, line in enumerate(text.splitlines(), 1):
        content = line.strip().lstrip("#").strip()
        if content:
            cells = [cell.strip() for cell in content.rstrip(",").split(",")] if commas else content.split()
            yield number, cells, line.lstrip().startswith("#")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _like_number(text: str) -> bool:
    """Tell whether a text without a finite number was meant as one: nan, inf, or a digit in front."""
    return text.lower().lstrip("+-")[:3] in {"nan", "inf"} or text.lstrip("+-")[:1].isdigit()
