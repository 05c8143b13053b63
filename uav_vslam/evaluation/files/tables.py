# SPDX-License-Identifier: Apache-2.0
"""Reads the CSV tables of a results folder back, by column."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import TrajectoryFileError

Array = NDArray[np.float64]


class Columns(dict[str, list[str]]):
    """Cells of each column by its title; asking for one that the file lacks names the file."""

    def __init__(self, columns: Mapping[str, list[str]], path: Path) -> None:
        super().__init__(columns)
        self._path = path

    def __missing__(self, title: str) -> list[str]:
        raise TrajectoryFileError(f"{self._path} has no column {title}; restore or remove the file")

    def numbers(self, title: str) -> Array:
        """Return the (N,) numbers of a column, NaN for an empty cell.

        Raises:
            TrajectoryFileError: there is no such column, or a cell is no number.
        """
        try:
            return np.array([float(cell) if cell else np.nan for cell in self[title]], dtype=float)
        except ValueError as error:
            raise TrajectoryFileError(f"{self._path}: {error}; correct or remove the file") from None


def read_columns(path: Path) -> Columns:
    """Return the cells of each column by its title, all of equal length.

    Raises:
        TrajectoryFileError: the file is empty or no text, or a row has another number of cells than the title.
    """
    with path.open(encoding="utf-8", newline="") as file:
        try:
            rows = list(csv.reader(file))
        except (UnicodeDecodeError, csv.Error) as error:
            raise TrajectoryFileError(f"{path} is no table ({error}); restore or remove the file") from None
    if not rows:
        raise TrajectoryFileError(f"{path} is empty; was the run interrupted?")
    for number, row in enumerate(rows, 1):
        if len(row) != len(rows[0]):
            raise TrajectoryFileError(
                f"{path}:{number}: {len(row)} cells, but the title has {len(rows[0])}; was the run interrupted?"
            )
    return Columns({title: [row[k] for row in rows[1:]] for k, title in enumerate(rows[0])}, path)
