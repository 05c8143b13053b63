# SPDX-License-Identifier: Apache-2.0
"""Readings that are missing: the usual spacing of a stream, and what its gaps hide.

Between two readings that are farther apart than usual the motion is interpolated. The noise of the two is not averaged
by the missing ones, and the motion may have been another one: for a rate that changes by s per second the mean over
a gap g errs by s g / sqrt(12), as a random walk that is pinned at both ends does, and by more where g is long enough
for the motion to reverse. s comes from the readings themselves. Beyond `BLIND_S` nothing is known of the motion.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.types import NS_PER_S, ImuSample

Array = NDArray[np.float64]

MISSING = 1.5  # usual spacings, from which on a reading is missing
REVERSAL_S = 0.1  # in which a motion may reverse
BLIND_S = 0.3  # after longer without a reading the motion is unknown
FASTEST_HZ = 20_000.0  # of any IMU; a higher mean rate shows stamps in another unit
SLOWEST_HZ = 50.0  # small aircraft turn to and fro at up to 10 Hz; the midpoint rule needs five readings a period
LEAP_S = 1.0  # after longer without a reading or an image it is unknown, too, how much time has passed
UNKNOWN_RATE_SIGMA = 0.5  # [rad/s] of an unknown rotation rate
UNKNOWN_ACCEL_SIGMA = 5.0  # [m/s^2] of an unknown acceleration
UNKNOWN_VARIANCE = np.repeat([UNKNOWN_RATE_SIGMA**2, UNKNOWN_ACCEL_SIGMA**2], 3)

WINDOW, EVERY = 1000, 20  # spacings that the usual one is taken from, and how often
ALIKE, FREQUENT = 0.1, 0.02  # spacings are alike within a share, and frequent from a share of all on
DENSEST = 40.0  # of the mean spacing, when all but one of so many are lost at random: what is closer is a burst
BURSTS = 3.0  # mean over median spacing from which readings come in bursts; losses at random give 1/ln 2 = 1.44
ENOUGH, A_FEW, ASSUMED_NS = 100, 5, 10_000_000  # with fewer that differ, or hardly any, the usual one is at most 10 ms


class UsualSpacing:
    """The spacing of a stream of readings when none is missing.

    It is the densest place of the distribution of spacings, which is one period even in a stream that loses
    nineteen of twenty readings at random.

    Attributes:
        period_s: as of the last reading added [s]; 0 before the second.
        bursts_hz: see `bursts_hz`, of the newest spacings; None if the readings don't come in bursts.
        slow_hz: usual rate, if readings come more seldom than at `SLOWEST_HZ`; else None.
    """

    def __init__(self) -> None:
        self._spacings_ns: deque[int] = deque(maxlen=WINDOW)
        self._last_ns: int | None = None
        self._until_next = 0
        self.period_s = 0.0
        self.bursts_hz: tuple[float, float] | None = None
        self.slow_hz: float | None = None

    def add(self, stamp_ns: int) -> None:
        """Add a reading's stamp, later than those before."""
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is None:
            return
        self._spacings_ns.append(stamp_ns - last_ns)
        self._until_next -= 1
        if self._until_next <= 0 or len(self._spacings_ns) < ENOUGH:
            self._until_next = EVERY
            spacings_ns = np.sort(self._spacings_ns)
            self.period_s = _usual_ns(spacings_ns) / NS_PER_S
            self.bursts_hz = bursts_hz(spacings_ns)
            is_slow = len(spacings_ns) >= ENOUGH and self.period_s * SLOWEST_HZ > 1.0 + ALIKE
            self.slow_hz = 1.0 / self.period_s if is_slow else None


def bursts_hz(spacings_ns: NDArray[np.int64]) -> tuple[float, float] | None:
    """Return the rates within bursts and on average of readings (N,) apart [ns]; None if they don't come in bursts.

    A gap counts as BLIND_S at most, so the average is that outside gaps. Bursts of two are never found: the median of
    spacings that alternate is about their mean.
    """
    median_ns, mean_ns = float(np.median(spacings_ns)), float(np.minimum(spacings_ns, BLIND_S * NS_PER_S).mean())
    if len(spacings_ns) < ENOUGH or mean_ns < BURSTS * median_ns:
        return None
    return NS_PER_S / median_ns, NS_PER_S / mean_ns


def _usual_ns(spacings_ns: NDArray[np.int64]) -> float:
    """Return the usual one of (N,) sorted spacings; readings that come in bursts, or twice, don't make it shorter."""
    mean_ns = np.minimum(spacings_ns, BLIND_S * NS_PER_S).mean()
    spacings_ns = spacings_ns[spacings_ns >= mean_ns / DENSEST]
    if len(spacings_ns) < ENOUGH:
        regular = len(spacings_ns) >= A_FEW and spacings_ns[-1] <= MISSING * spacings_ns[0]
        return float(spacings_ns[0] if regular else min(spacings_ns[0], ASSUMED_NS))
    low = np.searchsorted(spacings_ns, (1.0 - ALIKE) * spacings_ns)
    alike = np.searchsorted(spacings_ns, (1.0 + ALIKE) * spacings_ns, "right") - low
    density = np.where(alike >= FREQUENT * len(spacings_ns), alike / spacings_ns, 0.0)
    return float(spacings_ns[np.argmax(density)])


def hidden_variance(samples: list[ImuSample], apart_s: Array, *, period_s: float, imu: ImuConfig) -> Array | None:
    """Return (K, 6) variance of the mean rotation rate and acceleration over each spacing, beside that of the noise.

    Args:
        samples: readings from which the change of the motion is taken, in stamp order.
        apart_s: (K,) spacings of the readings that an increment is made of [s].
        period_s: the usual spacing; 0 if it is unknown, and then only that of more than BLIND_S is a gap [s].
        imu: noise densities.

    Returns:
        Zero where no reading is missing; None if none is missing at all.
    """
    blind = apart_s > BLIND_S
    gaps = blind | (apart_s > MISSING * period_s) if period_s else blind
    if not gaps.any():
        return None
    hidden = np.tile(UNKNOWN_VARIANCE, (len(apart_s), 1))
    if period_s and len(samples) > 1:
        noise = np.repeat([imu.gyro_noise**2, imu.accel_noise**2], 3) / period_s
        growth = apart_s**2 * (1.0 + (apart_s / REVERSAL_S) ** 2) / 12.0
        moving = np.minimum(noise + np.outer(growth, _squared_slope(samples, noise)), UNKNOWN_VARIANCE)
        hidden = np.where(blind[:, None], hidden, moving)
    return np.where(gaps[:, None], hidden, 0.0)


def _squared_slope(samples: list[ImuSample], noise: Array) -> Array:
    """Return (6,) mean squared change per second of rate and specific force, the same for the axes of each."""
    readings = np.array([np.concatenate([s.gyro, s.accel]) for s in samples])
    spacing_s = np.diff([s.stamp_ns for s in samples]) / NS_PER_S
    squares = np.mean((np.diff(readings, axis=0) ** 2 - 2.0 * noise) / spacing_s[:, None] ** 2, axis=0)
    return np.repeat(np.maximum(squares.reshape(2, 3).mean(axis=1), 0.0), 3)


def halved(t_s: Array, gyro: Array, accel: Array, hidden: Array, apart_s: Array) -> tuple[Array, Array, Array, Array]:
    """Divide each gap in two, whose errors are independent: one constant error would tie position to velocity.

    Those of more than LEAP_S are left as they are: images come in between, which make many parts of them.

    Args:
        t_s, gyro, accel: (K+1,), (K+1, 3), (K+1, 3) stamps and readings.
        hidden: (K, 6) variance of the mean over each interval; 0 where there is no gap.
        apart_s: (K,) spacings of the readings [s].

    Returns:
        The same with a reading in the middle of each gap, and twice the variance for each half.
    """
    gaps = (hidden > 0.0).any(axis=1) & (apart_s <= LEAP_S)
    at = np.flatnonzero(gaps) + 1
    t_s, gyro, accel = (np.insert(x, at, 0.5 * (x[at] + x[at - 1]), axis=0) for x in (t_s, gyro, accel))
    return t_s, gyro, accel, np.repeat(hidden * (1 + gaps)[:, None], 1 + gaps, axis=0)
