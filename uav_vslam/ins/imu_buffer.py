# SPDX-License-Identifier: Apache-2.0
"""IMU readings buffered until the image that ends their interval."""

from collections import deque

from uav_vslam.config import ImuConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.ins.imu_statistics import ImuStatistics
from uav_vslam.types import NS_PER_S, ImuSample

MAX_HELD_S = 120.0  # readings buffered while no image arrives: 12 MB at 200 Hz


class ImuBuffer:
    """Buffer of the readings of the last MAX_HELD_S in arrival order; dropped readings are a gap.

    An interval is complete once a reading at or after its end has arrived: see `covers`.

    Attributes:
        statistics: as of the newest reading.
        period_s, imu: usual spacing and noise as of the newest reading of the last cut, so that they do not depend on
            when it is made.
    """

    def __init__(self, imu: ImuConfig) -> None:
        self._samples: deque[ImuSample] = deque()
        self._known: deque[tuple[float, ImuConfig]] = deque()  # usual spacing and noise as of each
        self.statistics = ImuStatistics(imu)
        self.period_s, self.imu = 0.0, imu

    def append(self, sample: ImuSample) -> None:
        """Add a reading.

        Raises:
            InvalidMessage: its stamp is not later than the newest one, or a value is not finite.
        """
        if not sample.is_finite:
            raise InvalidMessage("not_finite", f"IMU reading at {sample.stamp_ns} ns is not finite")
        if self._samples and sample.stamp_ns <= self._samples[-1].stamp_ns:
            newest = self._samples[-1].stamp_ns
            raise InvalidMessage("stamp", f"IMU stamp {sample.stamp_ns} ns is not after {newest} ns")
        self.statistics.add(sample)
        self._samples.append(sample)
        self._known.append((self.statistics.period_s, self.statistics.imu))
        while self._samples[0].stamp_ns < sample.stamp_ns - MAX_HELD_S * NS_PER_S:
            self._drop_oldest()

    def covers(self, stamp_ns: int) -> bool:
        """Return whether a reading at or after the stamp has arrived."""
        return bool(self._samples) and self._samples[-1].stamp_ns >= stamp_ns

    def cut(self, start_ns: int, stamp_ns: int) -> list[ImuSample]:
        """Return the readings of an interval and one beyond each end if available; drop older ones."""
        while len(self._samples) > 1 and self._samples[1].stamp_ns <= start_ns:
            self._drop_oldest()
        chosen = []
        for sample, known in zip(self._samples, self._known, strict=True):
            chosen.append(sample)
            self.period_s, self.imu = known
            if sample.stamp_ns >= stamp_ns:
                break
        useful = chosen and chosen[-1].stamp_ns > start_ns and chosen[0].stamp_ns < stamp_ns
        return chosen if useful else []

    def _drop_oldest(self) -> None:
        self._samples.popleft()
        self._known.popleft()
