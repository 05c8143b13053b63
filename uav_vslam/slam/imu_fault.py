# SPDX-License-Identifier: Apache-2.0
"""Detects a faulty IMU, while no point of an image is where its readings lead to expect it.

A wrong start and a wrong rig make frames contradict the prediction as well. But only a wrong IMU measures a force that
is not the reaction to gravity, or another rotation than the images', which hardly depends on the baseline.
"""

from collections import deque
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from uav_vslam.ins.increments import lacks_readings
from uav_vslam.types import ImuIncrement

Array = NDArray[np.float64]

FAULTY_AFTER = 3  # consecutive frames that show nothing where it is expected,
FAULTY_AFTER_S = 0.4  # and at least this time: a moment may well exceed the limits below
HEALTHY_AFTER = 20  # consecutive frames, of readings that are plausible again
MOST_ACCEL = 5.0  # [m/s^2] of the mean: more is no flight in this attitude
MOST_RATE = 0.2  # [rad/s] of the median difference between IMU and images


@dataclass(frozen=True, slots=True)
class _Readings:
    """Those up to one frame: duration [s], velocity gained in the map [m/s], angle between IMU and images [rad]."""

    dt_s: float
    gained: Array
    apart_rad: float | None


class ImuFaultDetector:
    """Monitors the readings.

    Attributes:
        reason: what is wrong with them; empty without a fault.
        is_gyro_healthy: whether the angular rates agree with the images'.
    """

    def __init__(self, gravity: float) -> None:
        self._gravity = np.array([0.0, 0.0, gravity])
        self._recent: deque[_Readings] = deque()
        self._coasted = self._plausible = 0
        self.reason, self.is_gyro_healthy = "", True

    @property
    def is_suspected(self) -> bool:
        """Whether the motion that the images show is wanted, to judge the readings by."""
        return self._coasted > 0 or self.reason != ""

    def add(self, increment: ImuIncrement, R_map_body: Array, *, coasted: bool, apart_rad: float | None) -> bool:
        """Add the readings up to a frame and return whether they are faulty from now on.

        Args:
            increment: as the IMU has it.
            R_map_body: (3, 3) attitude at its start.
            coasted: the frame had points, but none of them where it was expected.
            apart_rad: angle between the rotations of the IMU and of the images [rad]; None if they show none.
        """
        self._coasted = self._coasted + 1 if coasted else 0
        if not self.is_suspected or lacks_readings(increment):  # which shows no more than that they are missing
            self._recent.clear()
            return False
        self._keep(_Readings(increment.dt_s, R_map_body @ increment.delta_v, apart_rad))
        finding = self._finding()
        if self.reason:
            self._plausible = 0 if finding or apart_rad is None else self._plausible + 1
            if self._plausible >= HEALTHY_AFTER:
                self.reason, self._plausible = "", 0
            return False
        self.reason = finding if self._coasted >= FAULTY_AFTER else ""
        return self.reason != ""

    def _keep(self, readings: _Readings) -> None:
        """Keep what the findings are about: the last frames."""
        self._recent.append(readings)
        while len(self._recent) > FAULTY_AFTER and self._lasted_s - self._recent[0].dt_s >= FAULTY_AFTER_S:
            self._recent.popleft()

    @property
    def _lasted_s(self) -> float:
        return sum(one.dt_s for one in self._recent)

    def _finding(self) -> str:
        """Return what is wrong with the readings of the last frames; empty if nothing is, or it can not be judged."""
        seen = [one for one in self._recent if one.apart_rad is not None]
        if not seen or self._lasted_s < FAULTY_AFTER_S:
            return ""
        rate = median((one.apart_rad or 0.0) / one.dt_s for one in seen)  # images of a lost filter err, now and then
        self.is_gyro_healthy = rate <= MOST_RATE
        if not self.is_gyro_healthy:
            return (
                f"the IMU's rotation differs from the images' by {rate:.1f} rad/s: check its unit, axes and stamps, "
                "and that the images are live and show more than the vehicle itself"
            )
        force = np.sum([one.gained for one in self._recent], axis=0) / self._lasted_s
        if np.linalg.norm(force - self._gravity) > MOST_ACCEL:
            measured = ", ".join(f"{x:.1f}" for x in force)
            return (
                f"the IMU measures ({measured}) m/s^2 in the map, where gravity is {self._gravity[2]:.1f} up: check "
                "unit, sign and axes of its accelerations, and the attitude at the start"
            )
        return ""
