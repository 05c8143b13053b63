# SPDX-License-Identifier: Apache-2.0
"""IMU preintegration between two stamps after Forster et al. [forster17], vectorised in closed form.

Symbols: `dR[k]`, `dv[k]`, `dp[k]` are the increments from the start to sample k; `M[j]` maps a gyro error of interval j
to the rotation error, in the start frame, of all later samples; `G[j]` (9x6) maps the gyro and accelerometer errors
of interval j to the errors of the whole increment. Then the bias Jacobian is `-sum G` and the covariance
`sum G diag(sigma^2/dt) G^T`, without recursion over 9x9 matrices.
"""

import itertools
from collections import deque
from functools import partial

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.rotation import skew, so3_exp, so3_left_jacobian
from uav_vslam.types import NS_PER_S, ImuIncrement, ImuSample

Array = NDArray[np.float64]

MAX_GAP_S = 0.05  # after longer without a reading the motion is unknown
LEAP_S = 1.0  # after longer without a reading or an image it is unknown, too, how much time has passed
MAX_HELD_S = 120.0  # readings buffered while no image arrives: 12 MB at 200 Hz
UNKNOWN_RATE_SIGMA = 0.5  # [rad/s] of the rotation rate in a gap
UNKNOWN_ACCEL_SIGMA = 5.0  # [m/s^2] of the acceleration in a gap
UNKNOWN_SPEED_SIGMA = 15.0  # [m/s] per axis, over a leap: a clock that was set took the vehicle nowhere
MOST_ROTATION_SIGMA = np.pi / np.sqrt(3.0)  # [rad] of an angle of which nothing is known


def preintegrate(
    samples: list[ImuSample],
    start_ns: int,
    stamp_ns: int,
    *,
    gyro_bias: Array,
    accel_bias: Array,
    imu: ImuConfig,
) -> ImuIncrement:
    """Integrate readings over [start_ns, stamp_ns] by the midpoint rule.

    Readings at both ends are interpolated linearly, or held from the nearest one at the ends of the recording. Between
    readings more than MAX_GAP_S apart the motion is nearly unknown, also in a short interval within such a gap.

    Args:
        samples: readings in stamp order; those outside the interval are used to interpolate at its ends.
        start_ns, stamp_ns: the interval [ns].
        gyro_bias, accel_bias: (3,) linearisation point [rad/s], [m/s^2].
        imu: noise densities.

    Raises:
        ValueError: the interval is empty or runs backwards.
    """
    if stamp_ns <= start_ns:
        raise ValueError(f"increment from {start_ns} ns to {stamp_ns} ns is empty; stamps must increase")
    if not samples:
        return unknown_motion(start_ns, stamp_ns, gyro_bias=gyro_bias, accel_bias=accel_bias, imu=imu)
    if (leap := _leap(samples, start_ns, stamp_ns)) is not None:
        part = partial(preintegrate, samples, gyro_bias=gyro_bias, accel_bias=accel_bias, imu=imu)
        whole = unknown_motion(*leap, gyro_bias=gyro_bias, accel_bias=accel_bias, imu=imu)
        whole = whole if leap[0] == start_ns else compose(part(start_ns, leap[0]), whole)
        return whole if leap[1] == stamp_ns else compose(whole, part(leap[1], stamp_ns))
    t_s, gyro, accel = _readings_within(samples, start_ns, stamp_ns)
    dt = np.diff(t_s)
    omega = 0.5 * (gyro[1:] + gyro[:-1]) - gyro_bias
    dR = _chain(so3_exp(omega * dt[:, None]))
    accel_start = np.einsum("kij,kj->ki", dR, accel - accel_bias)
    accel_mid = 0.5 * (accel_start[1:] + accel_start[:-1])
    dv = np.vstack([np.zeros(3), np.cumsum(accel_mid * dt[:, None], axis=0)])
    dp_steps = dv[:-1] * dt[:, None] + 0.5 * accel_mid * dt[:, None] ** 2
    dp = np.vstack([np.zeros(3), np.cumsum(dp_steps, axis=0)])

    left = t_s[-1] - t_s[1:]  # time left after each interval
    M = dR[1:] @ so3_left_jacobian(-omega * dt[:, None]) * dt[:, None, None]
    turned = 0.5 * dt[:, None] * accel_start[1:]  # velocity gained within interval j after its own rotation
    G = np.zeros((len(dt), 9, 6))
    G[:, 0:3, 0:3] = dR[-1].T @ M
    G[:, 3:6, 0:3] = -skew(dv[-1] - dv[1:] + turned) @ M
    G[:, 6:9, 0:3] = -skew(dp[-1] - dp[1:] - dv[1:] * left[:, None] + turned * (left + 0.5 * dt)[:, None]) @ M
    R_mid_dt = 0.5 * (dR[1:] + dR[:-1]) * dt[:, None, None]
    G[:, 3:6, 3:6] = R_mid_dt
    G[:, 6:9, 3:6] = R_mid_dt * (left + 0.5 * dt)[:, None, None]
    variance = np.repeat([imu.gyro_noise**2, imu.accel_noise**2], 3)[None, :] / dt[:, None]
    # Unknown is one constant per gap: its parts in several increments are given the variance that adds up to the same.
    share = _gap_s(samples, start_ns, stamp_ns) / dt
    variance += share[:, None] * np.repeat([UNKNOWN_RATE_SIGMA**2, UNKNOWN_ACCEL_SIGMA**2], 3)
    covariance = np.einsum("jab,jb,jcb->ac", G, variance, G)
    return ImuIncrement(
        start_ns=start_ns,
        stamp_ns=stamp_ns,
        samples=sum(start_ns < sample.stamp_ns <= stamp_ns for sample in samples),
        delta_R=dR[-1],
        delta_v=dv[-1],
        delta_p=dp[-1],
        rate_start=gyro[0],
        rate_end=gyro[-1],
        gyro_bias=np.array(gyro_bias, dtype=float),
        accel_bias=np.array(accel_bias, dtype=float),
        bias_jacobian=-G.sum(axis=0),
        covariance=0.5 * (covariance + covariance.T),
    )


def compose(first: ImuIncrement, second: ImuIncrement) -> ImuIncrement:
    """Return the motion over two adjacent intervals, equal to one preintegration over both.

    dR = dR1 dR2, dv = dv1 + dR1 dv2, dp = dp1 + dv1 dt2 + dR1 dp2; Jacobian and covariance follow to first order.

    Raises:
        ValueError: the second does not start where the first ends, or they are linearised at different biases.
    """
    if second.start_ns != first.stamp_ns:
        raise ValueError(f"an increment from {second.start_ns} ns does not follow one to {first.stamp_ns} ns")
    before, after = (np.concatenate([one.gyro_bias, one.accel_bias]) for one in (first, second))
    if not np.array_equal(before, after):
        raise ValueError(f"adjacent increments at {first.stamp_ns} ns are linearised at different biases")
    A, B = error_transfer(first, second)
    return ImuIncrement(
        start_ns=first.start_ns,
        stamp_ns=second.stamp_ns,
        samples=first.samples + second.samples,
        delta_R=first.delta_R @ second.delta_R,
        delta_v=first.delta_v + first.delta_R @ second.delta_v,
        delta_p=first.delta_p + first.delta_v * second.dt_s + first.delta_R @ second.delta_p,
        rate_start=first.rate_start,
        rate_end=second.rate_end,
        gyro_bias=first.gyro_bias,
        accel_bias=first.accel_bias,
        bias_jacobian=A @ first.bias_jacobian + B @ second.bias_jacobian,
        covariance=A @ first.covariance @ A.T + B @ second.covariance @ B.T,
    )


def bridged(increment: ImuIncrement, start_ns: int, imu: ImuConfig) -> ImuIncrement:
    """Extend an increment back to an earlier stamp, if it does not start there; the motion in between is unknown.

    Args:
        increment: known part of the motion.
        start_ns: start of the result, not after the increment's [ns].
        imu: gravity; the unknown part is a hover.
    """
    if increment.start_ns == start_ns:
        return increment
    bias = {"gyro_bias": increment.gyro_bias, "accel_bias": increment.accel_bias}
    unknown = unknown_motion(start_ns, increment.start_ns, **bias, imu=imu)
    return compose(unknown, increment)


def error_transfer(first: ImuIncrement, second: ImuIncrement) -> tuple[Array, Array]:
    """Return A, B (9, 9): Jacobians of the composed error (rotation, velocity, position) by those of both parts."""
    R, dt = first.delta_R, second.dt_s
    A, B = np.eye(9), np.eye(9)
    A[0:3, 0:3] = second.delta_R.T
    A[3:6, 0:3] = -R @ skew(second.delta_v)
    A[6:9, 0:3] = -R @ skew(second.delta_p)
    A[6:9, 3:6] = dt * np.eye(3)
    B[3:6, 3:6] = B[6:9, 6:9] = R
    return A, B


def _chain(steps: Array) -> Array:
    """Return (K+1, 3, 3) products I, S0, S0 S1, ..."""
    out = np.empty((len(steps) + 1, 3, 3))
    out[0] = np.eye(3)
    for k, step in enumerate(steps):
        out[k + 1] = out[k] @ step
    return out


def _readings_within(samples: list[ImuSample], start_ns: int, stamp_ns: int) -> tuple[Array, Array, Array]:
    """Return times [s] from the start, gyro and accel (K, 3), with interpolated readings at both ends."""
    stamps = np.array([s.stamp_ns for s in samples], dtype=np.int64)
    inside = (stamps > start_ns) & (stamps < stamp_ns)
    t_all = (stamps - start_ns) / NS_PER_S
    t_s = np.concatenate([[0.0], t_all[inside], [(stamp_ns - start_ns) / NS_PER_S]])
    readings = np.array([np.concatenate([s.gyro, s.accel]) for s in samples])
    columns = np.column_stack([np.interp(t_s, t_all, readings[:, k]) for k in range(6)])
    return t_s, columns[:, :3], columns[:, 3:]


def has_gap(samples: list[ImuSample], start_ns: int, stamp_ns: int) -> bool:
    """Return whether an interval has a gap in the readings; arguments as for `preintegrate`."""
    return not samples or bool(_gap_s(samples, start_ns, stamp_ns).any())


def _gap_s(samples: list[ImuSample], start_ns: int, stamp_ns: int) -> Array:
    """Return for each of the K-1 intervals of `_readings_within` the length of the gap that it is in [s]; 0 for none.

    Gaps are between actual readings, inside the interval or not: an image within a gap does not shorten it.
    """
    stamps = np.array([s.stamp_ns for s in samples], dtype=np.int64)
    before, after = stamps[stamps <= start_ns][-1:], stamps[stamps >= stamp_ns][:1]
    inside = stamps[(stamps > start_ns) & (stamps < stamp_ns)]
    ends = (before if len(before) else [start_ns], after if len(after) else [stamp_ns])
    apart_s = np.diff(np.concatenate([ends[0], inside, ends[1]])) / NS_PER_S
    return np.where(apart_s > MAX_GAP_S, apart_s, 0.0)


def _leap(samples: list[ImuSample], start_ns: int, stamp_ns: int) -> tuple[int, int] | None:
    """Return the longest part of an interval without a reading, if it is longer than LEAP_S."""
    inside = [s.stamp_ns for s in samples if start_ns < s.stamp_ns < stamp_ns]
    parts = itertools.pairwise([start_ns, *inside, stamp_ns])
    longest = max(parts, key=lambda part: part[1] - part[0])
    return longest if longest[1] - longest[0] > LEAP_S * NS_PER_S else None


def unknown_motion(
    start_ns: int, stamp_ns: int, *, gyro_bias: Array, accel_bias: Array, imu: ImuConfig
) -> ImuIncrement:
    """Return a hover with a very large covariance, for a time without readings.

    Over more than LEAP_S its covariance also allows for a vehicle that has not moved at all: a jump of the clock looks
    the same as a silence.

    Args:
        start_ns, stamp_ns: the interval [ns].
        gyro_bias, accel_bias: (3,) linearisation point [rad/s], [m/s^2].
        imu: gravity.
    """
    dt = (stamp_ns - start_ns) / NS_PER_S
    hover = np.array([0.0, 0.0, imu.gravity])
    moved_m = np.hypot(0.5 * UNKNOWN_ACCEL_SIGMA * dt**2, UNKNOWN_SPEED_SIGMA * dt if dt > LEAP_S else 0.0)
    turned_rad = min(UNKNOWN_RATE_SIGMA * dt, MOST_ROTATION_SIGMA)
    sigma = np.repeat([turned_rad, UNKNOWN_ACCEL_SIGMA * dt, moved_m], 3)
    return ImuIncrement(
        start_ns=start_ns,
        stamp_ns=stamp_ns,
        samples=0,
        delta_R=np.eye(3),
        delta_v=hover * dt,
        delta_p=0.5 * hover * dt**2,
        rate_start=np.array(gyro_bias, dtype=float),
        rate_end=np.array(gyro_bias, dtype=float),
        gyro_bias=np.array(gyro_bias, dtype=float),
        accel_bias=np.array(accel_bias, dtype=float),
        bias_jacobian=np.zeros((9, 6)),
        covariance=np.diag(sigma**2),
    )


class ImuBuffer:
    """Buffer of the readings of the last MAX_HELD_S in arrival order; dropped readings are a gap.

    An interval is complete once a reading at or after its end has arrived: see `covers`.
    """

    def __init__(self) -> None:
        self._samples: deque[ImuSample] = deque()

    def append(self, sample: ImuSample) -> None:
        """Add a reading.

        Raises:
            InvalidMessage: its stamp is not later than the newest one, or a value is not finite.
        """
        if not (np.isfinite(sample.gyro).all() and np.isfinite(sample.accel).all()):
            raise InvalidMessage("not_finite", f"IMU reading at {sample.stamp_ns} ns is not finite")
        if self._samples and sample.stamp_ns <= self._samples[-1].stamp_ns:
            newest = self._samples[-1].stamp_ns
            raise InvalidMessage("stamp", f"IMU stamp {sample.stamp_ns} ns is not after {newest} ns")
        self._samples.append(sample)
        while self._samples[0].stamp_ns < sample.stamp_ns - MAX_HELD_S * NS_PER_S:
            self._samples.popleft()

    def covers(self, stamp_ns: int) -> bool:
        """Return whether a reading at or after the stamp has arrived."""
        return bool(self._samples) and self._samples[-1].stamp_ns >= stamp_ns

    def cut(self, start_ns: int, stamp_ns: int) -> list[ImuSample]:
        """Return the readings of an interval and one beyond each end if available; drop older ones."""
        while len(self._samples) > 1 and self._samples[1].stamp_ns <= start_ns:
            self._samples.popleft()
        chosen = []
        for sample in self._samples:
            chosen.append(sample)
            if sample.stamp_ns >= stamp_ns:
                break
        useful = chosen and chosen[-1].stamp_ns > start_ns and chosen[0].stamp_ns < stamp_ns
        return chosen if useful else []
