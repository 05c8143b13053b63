# SPDX-License-Identifier: Apache-2.0
"""The IMU readings of a whole recording in arrays: 80 bytes each, where records take a kilobyte."""

from array import array
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from uav_vslam.types import ImuSample

Array = NDArray[np.float64]

GYRO, ACCEL, MEASURED = slice(0, 3), slice(3, 6), slice(6, 9)
NUMBERS = 9  # of a reading


class ImuSeries:
    """Readings in the order in which they were added; iterating makes the records again."""

    def __init__(self, readings: Iterable[ImuSample] = ()) -> None:
        self._stamps, self._numbers = array("q"), array("d")
        self.extend(readings)

    def extend(self, readings: Iterable[ImuSample]) -> None:
        """Append readings; not while an array of the series is in use."""
        for one in readings:
            self._stamps.append(one.stamp_ns)
            for vector in (one.gyro, one.accel, one.accel_at_imu):
                self._numbers.extend(vector.tolist())

    def __len__(self) -> int:
        return len(self._stamps)

    def __iter__(self) -> Iterator[ImuSample]:
        for stamp_ns, row in zip(self._stamps, self._rows, strict=True):
            yield ImuSample(stamp_ns, row[GYRO], row[ACCEL], row[MEASURED])

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(N,) times of the readings [ns]."""
        return np.asarray(self._stamps, np.int64)

    @property
    def gyro(self) -> Array:
        """(N, 3) angular rates [rad/s]."""
        return self._rows[:, GYRO]

    @property
    def accel(self) -> Array:
        """(N, 3) specific forces [m/s^2]."""
        return self._rows[:, ACCEL]

    @property
    def accel_at_imu(self) -> Array:
        """(N, 3) specific forces where the IMU is, in the same axes [m/s^2]; see `ImuSample`."""
        return self._rows[:, MEASURED]

    @property
    def _rows(self) -> Array:
        return np.asarray(self._numbers, float).reshape(-1, NUMBERS)
