# SPDX-License-Identifier: Apache-2.0
"""Single readings that are no motion, as a faulty transfer leaves them.

One of 5 rad/s turns the estimate by more than a degree in 5 ms, and no noise that is measured over many readings allows
for it. A motion, a shock too, moves the readings after it as well. An outlier is far from both its neighbours, which
agree with each other; it is left out, which is a gap of one reading. Vibration that begins looks like that too, most of
all near half the rate of the readings, where every other one agrees: what is far again soon after is used.
"""

import math
from collections import deque
from dataclasses import dataclass
from statistics import median

import numpy as np

from uav_vslam.types import NS_PER_S, ImuSample

WINDOW, EVERY = 32, 8  # readings whose differences give the usual one, at most, and how often
FAR = 20.0  # usual differences: white noise does not reach 7, and vibration is itself the usual one
LEAST = 0.2, 2.0  # [rad/s], [m/s^2] below which nothing is far, however still the vehicle
AGREE = 0.5  # of the distance of an outlier: the most that its neighbours are apart
OUTLIER = "imu_outlier"  # reason by which they are counted
APART = 4  # readings used after an outlier, without another one
SETTLED = WINDOW // 2 + EVERY  # readings after which a vibration that begins is the usual difference
NEIGHBOURS_S = 0.05  # readings farther apart say nothing about each other


@dataclass(frozen=True, slots=True)
class Judged:
    """What a reading has made clear.

    Attributes:
        readings: those to use, in order; a reading far from the one before is not among them until the next one.
        outlier: the one left out, if any.
    """

    readings: list[ImuSample]
    outlier: ImuSample | None = None

    @property
    def finding(self) -> str:
        """What is wrong with the outlier; empty without one."""
        if self.outlier is None:
            return ""
        rate, force = np.linalg.norm(self.outlier.gyro), np.linalg.norm(self.outlier.accel)
        return (
            f"IMU reading at {self.outlier.stamp_ns} ns, {rate:.2g} rad/s and {force:.3g} m/s^2, is far from both its "
            "neighbours"
        )


class OutlierFilter:
    """Judges a stream of readings; one that is far from the one before is held until the next."""

    def __init__(self) -> None:
        self._steps: tuple[deque[float], deque[float]] = deque(maxlen=WINDOW), deque(maxlen=WINDOW)
        self._until_next = EVERY
        self._far = math.inf, math.inf
        self._all_used = 0  # how many of the next readings are no outliers, whatever they are
        self._last: ImuSample | None = None
        self._held: ImuSample | None = None

    def add(self, sample: ImuSample) -> Judged:
        """Add a reading; one that is not finite or not later than those before is for the caller to refuse."""
        newest = self._held or self._last
        if not sample.is_finite or (newest is not None and sample.stamp_ns <= newest.stamp_ns):
            return Judged([sample])
        readings, outlier = [], None
        if self._held is not None:
            if self._is_outlier(self._held, sample):
                outlier, self._all_used = self._held, APART
            else:
                readings.append(self._taken(self._held))
                self._all_used = SETTLED
            self._held = None
        is_far = self._is_far(sample)
        if is_far and not self._all_used:
            self._held = sample
        else:
            readings.append(self._taken(sample))
            self._all_used = SETTLED if is_far else max(self._all_used - 1, 0)
        return Judged(readings, outlier)

    def rest(self) -> list[ImuSample]:
        """Return what is held, after which nothing comes."""
        held, self._held = self._held, None
        return [] if held is None else [held]

    def _taken(self, sample: ImuSample) -> ImuSample:
        """Return a reading, and let it count for what is usual."""
        if self._last is not None:
            for steps, distance in zip(self._steps, _distances(self._last, sample), strict=True):
                steps.append(distance)
            self._until_next -= 1
        self._last = sample
        if self._until_next == 0:
            self._until_next = EVERY
            rate, force = (max(FAR * median(steps), least) for steps, least in zip(self._steps, LEAST, strict=True))
            self._far = rate, force
        return sample

    def _is_far(self, sample: ImuSample) -> bool:
        if self._last is None or not _are_neighbours(self._last, sample):
            return False
        rate, force = _distances(self._last, sample)
        return rate > self._far[0] or force > self._far[1]

    def _is_outlier(self, held: ImuSample, after: ImuSample) -> bool:
        """Return whether a reading far from the one before is as far from the one after, and these two agree."""
        before = self._last
        if before is None or not _are_neighbours(held, after):
            return False
        of_two = zip(_distances(before, held), _distances(held, after), _distances(before, after), strict=True)
        return any(
            min(to_before, to_after) > far and apart < AGREE * min(to_before, to_after)
            for (to_before, to_after, apart), far in zip(of_two, self._far, strict=True)
        )


def _are_neighbours(before: ImuSample, after: ImuSample) -> bool:
    return after.stamp_ns - before.stamp_ns <= NEIGHBOURS_S * NS_PER_S


def _distances(one: ImuSample, other: ImuSample) -> tuple[float, float]:
    """Return how far the angular rates and the forces of two readings are apart [rad/s], [m/s^2]."""
    rate = math.dist(one.gyro.tolist(), other.gyro.tolist())
    return rate, math.dist(one.accel.tolist(), other.accel.tolist())
