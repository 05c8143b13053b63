# SPDX-License-Identifier: Apache-2.0
"""Text files whose columns are named by a header line or counted from 1, with stamps in any unit."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

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
from uav_vslam.errors import ConfigError

UNITS_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
DELIMITERS = {"space": None, "tab": "\t", "comma": ",", "semicolon": ";"}  # None: any white space
COMMENT_MARKS = "#%/"  # before the names of a header


@dataclass(frozen=True, slots=True)
class TextFile:
    """A file of rows.

    Attributes:
        path: the file.
        delimiter: name in DELIMITERS.
        header_line: number of the line with the names of the columns, from 1; 0 for none. What precedes it is skipped.
    """

    path: Path
    delimiter: str = "space"
    header_line: int = 0

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line number and fields of each row that is no comment.

        Raises:
            BagError: the file can't be read.
        """
        for line, text in numbered_lines(self.path):
            if line > self.header_line:
                yield line, self._fields(text)

    def indices(self, names: Sequence[str]) -> list[int]:
        """Return the positions, from 0, of columns given by name or by number from 1.

        Raises:
            ConfigError: there is no such column.
            BagError: the file can't be read.
        """
        header = self._header()
        found = []
        for name in names:
            if name in header:
                found.append(header.index(name))
            elif name.isdigit() and int(name) >= 1:
                found.append(int(name) - 1)
            else:
                there = ", ".join(header) if header else "no names: set header_line, or count columns from 1"
                raise ConfigError(f"{self.path}: no column {name!r}; it has {there}")
        return found

    def _header(self) -> list[str]:
        if not self.header_line:
            return []
        lines = read_text(self.path).splitlines()
        if self.header_line > len(lines):
            raise ConfigError(f"{self.path}: header_line {self.header_line} is beyond its {len(lines)} lines")
        return self._fields(lines[self.header_line - 1].lstrip(COMMENT_MARKS))

    def _fields(self, text: str) -> list[str]:
        return [field.strip() for field in text.split(DELIMITERS[self.delimiter])]


@dataclass(frozen=True, slots=True)
class Clock:
    """How stamps are written: the sum of columns, each in its unit, and an offset.

    Attributes:
        columns: names or numbers.
        units: of each column, "s", "ms", "us" or "ns".
        offset_ns: added [ns].
    """

    columns: tuple[str, ...]
    units: tuple[str, ...]
    offset_ns: int

    def stamp_ns(self, texts: Sequence[str]) -> int:
        """Return the stamp [ns] of the columns' texts, without loss of digits.

        Raises:
            ValueError: one is no number, or ROS can't hold the stamp.
        """
        try:
            parts = [Decimal(text) * UNITS_NS[unit] for text, unit in zip(texts, self.units, strict=True)]
            return in_range(round(sum(parts, Decimal(0))) + self.offset_ns)
        except ArithmeticError:  # of Decimal: neither a number nor of a size in use
            raise ValueError(f"{', '.join(texts)} is no time") from None


def read_columns(
    file: TextFile,
    clock: Clock,
    names: Sequence[str],
    problems: Problems,
    *,
    check: Callable[[list[float]], None] | None = None,
) -> Table:
    """Read stamps and some columns of numbers; rows that lack one, or fail a check by ValueError, are left out.

    Raises:
        BagError: the file can't be read, or has no valid row.
        ConfigError: a column does not exist.
    """
    time_at, value_at = file.indices(clock.columns), file.indices(names)
    rows: list[tuple[int, int, list[float]]] = []
    for line, fields in file.rows():
        try:
            stamp = clock.stamp_ns([fields[k] for k in time_at])
            values = numbers([fields[k] for k in value_at])
            if check is not None:
                check(values)
            rows.append((stamp, line, values))
        except (IndexError, ValueError) as error:
            wrong = f"only {len(fields)} columns" if isinstance(error, IndexError) else str(error)
            problems.add(UNREADABLE, file.path, wrong, line=line)
    return table_of(rows, len(names), file.path, problems)
