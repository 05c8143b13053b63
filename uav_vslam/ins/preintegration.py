# SPDX-License-Identifier: Apache-2.0
"""IMU preintegration between two stamps after Forster et al. [forster17], vectorised in closed form.

Symbols: `dR[k]`, `dv[k]`, `dp[k]` are the increments from the start to sample k; `M[j]` maps a gyro error of interval j
to the rotation error, in the start frame, of all later samples; `G[j]` (9x6) maps the gyro and accelerometer errors
of interval j to the errors of the whole increment. Then the bias Jacobian is `-sum G` and the covariance
`sum G diag(sigma^2/dt) G^T`, without recursion over 9x9 matrices.
"""

import itertools
from bisect import bisect_left, bisect_right
from functools import partial

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.rotation import skew, so3_exp_and_right_jacobian
from uav_vslam.ins.gaps import LEAP_S, halved, hidden_variance
from uav_vslam.ins.increments import compose, unknown_motion
from uav_vslam.types import NS_PER_S, ImuIncrement, ImuSample

Array = NDArray[np.float64]

MAX_GAP_S = 0.05  # longer gaps are reported
RATE_FIT_S = 0.0201  # readings so near to an end of the interval show the rate there, and how it changes


def preintegrate(
    samples: list[ImuSample],
    start_ns: int,
    stamp_ns: int,
    *,
    gyro_bias: Array,
    accel_bias: Array,
    imu: ImuConfig,
    period_s: float = 0.0,
) -> ImuIncrement:
    """Integrate readings over [start_ns, stamp_ns] by the midpoint rule.

    Readings at both ends are interpolated linearly, or held from the nearest one at the ends of the recording. Where
    readings are missing the motion is less certain (`ins.gaps`), also in a short interval within a gap.

    Args:
        samples: readings in stamp order; those outside the interval are used to interpolate at its ends.
        start_ns, stamp_ns: the interval [ns].
        gyro_bias, accel_bias: (3,) linearisation point [rad/s], [m/s^2].
        imu: noise densities.
        period_s: usual spacing of the readings, 0 if unknown [s].

    Raises:
        ValueError: the interval is empty or runs backwards.
    """
    if stamp_ns <= start_ns:
        raise ValueError(f"increment from {start_ns} ns to {stamp_ns} ns is empty; stamps must increase")
    if not samples:
        return unknown_motion(start_ns, stamp_ns, gyro_bias=gyro_bias, accel_bias=accel_bias, imu=imu)
    stamps_ns = [sample.stamp_ns for sample in samples]
    if (leap := _leap(stamps_ns, start_ns, stamp_ns)) is not None:
        part = partial(preintegrate, samples, gyro_bias=gyro_bias, accel_bias=accel_bias, imu=imu, period_s=period_s)
        whole = unknown_motion(*leap, gyro_bias=gyro_bias, accel_bias=accel_bias, imu=imu)
        whole = whole if leap[0] == start_ns else compose(part(start_ns, leap[0]), whole)
        return whole if leap[1] == stamp_ns else compose(whole, part(leap[1], stamp_ns))
    t_s, gyro, accel, variance = _noisy_readings(samples, stamps_ns, start_ns, stamp_ns, imu=imu, period_s=period_s)
    step_s = np.diff(t_s)[:, None]
    turns, jacobians = so3_exp_and_right_jacobian((0.5 * (gyro[1:] + gyro[:-1]) - gyro_bias) * step_s)
    dR = _chain(turns)
    accel_start = (dR @ (accel - accel_bias)[:, :, None])[:, :, 0]
    accel_mid = 0.5 * (accel_start[1:] + accel_start[:-1])
    dv = _sums(accel_mid * step_s)
    dp = _sums(dv[:-1] * step_s + 0.5 * accel_mid * step_s**2)
    G = _error_jacobians(t_s, dR, dv, dp, turn_jacobians=jacobians, accel_start=accel_start)
    by_all = G.transpose(1, 0, 2).reshape(9, -1)  # Jacobian by the errors of all intervals
    covariance = (by_all * variance.ravel()) @ by_all.T
    near_start, near_end = t_s <= max(t_s[0] + RATE_FIT_S, t_s[1]), t_s >= min(t_s[-1] - RATE_FIT_S, t_s[-2])
    rate_start, slope_start = _line(t_s[near_start] - t_s[0], gyro[near_start])
    rate_end, slope_end = _line(t_s[near_end] - t_s[-1], gyro[near_end])
    return ImuIncrement(
        start_ns=start_ns,
        stamp_ns=stamp_ns,
        samples=bisect_right(stamps_ns, stamp_ns) - bisect_right(stamps_ns, start_ns),
        delta_R=dR[-1],
        delta_v=dv[-1],
        delta_p=dp[-1],
        rate_start=rate_start,
        rate_end=rate_end,
        rate_slope_start=slope_start,
        rate_slope_end=slope_end,
        gyro_bias=np.array(gyro_bias, dtype=float),
        accel_bias=np.array(accel_bias, dtype=float),
        bias_jacobian=-G.sum(axis=0),
        covariance=0.5 * (covariance + covariance.T),
        gyro_noise=imu.gyro_noise,
        accel_noise=imu.accel_noise,
    )


def _line(t_s: Array, gyro: Array) -> tuple[Array, Array]:
    """Return the value at 0 and the slope of the line through K >= 2 readings (K, 3) at times (K,); least squares."""
    from_mean = t_s - t_s.mean()
    slope = from_mean @ gyro / (from_mean @ from_mean)
    return gyro.mean(axis=0) - t_s.mean() * slope, slope


def has_gap(samples: list[ImuSample], start_ns: int, stamp_ns: int) -> bool:
    """Return whether an interval has a gap in the readings; arguments as for `preintegrate`."""
    return not samples or bool((_apart_s([s.stamp_ns for s in samples], start_ns, stamp_ns) > MAX_GAP_S).any())


def _noisy_readings(
    samples: list[ImuSample], stamps_ns: list[int], start_ns: int, stamp_ns: int, *, imu: ImuConfig, period_s: float
) -> tuple[Array, Array, Array, Array]:
    """Return `_readings_within`, gaps halved, and the variance (K-1, 6) of the mean reading over each interval."""
    t_s, gyro, accel = _readings_within(samples, stamps_ns, start_ns, stamp_ns)
    apart_s = _apart_s(stamps_ns, start_ns, stamp_ns)
    hidden = hidden_variance(samples, apart_s, period_s=period_s, imu=imu)
    if hidden is not None:
        # One constant per gap: its parts in several increments are given the variance that adds up to the same.
        hidden *= (apart_s / np.diff(t_s))[:, None]
        t_s, gyro, accel, hidden = halved(t_s, gyro, accel, hidden, apart_s)
    variance = np.repeat([imu.gyro_noise**2, imu.accel_noise**2], 3)[None, :] / np.diff(t_s)[:, None]
    return t_s, gyro, accel, variance if hidden is None else variance + hidden


def _error_jacobians(
    t_s: Array, dR: Array, dv: Array, dp: Array, *, turn_jacobians: Array, accel_start: Array
) -> Array:
    """Return G (K-1, 9, 6).

    Args:
        t_s: (K,) times of the readings [s].
        dR, dv, dp: (K, ...) increments up to each reading.
        turn_jacobians: (K-1, 3, 3) right Jacobians of the rotation over each interval.
        accel_start: (K, 3) specific forces in the start frame [m/s^2].
    """
    step_s, left_s = np.diff(t_s)[:, None], (t_s[-1] - t_s[1:])[:, None]  # each interval, and the time left after it
    M = dR[1:] @ turn_jacobians * step_s[:, None]
    turned = 0.5 * step_s * accel_start[1:]  # velocity gained within interval j after its own rotation
    G = np.zeros((len(step_s), 9, 6))
    G[:, 0:3, 0:3] = dR[-1].T @ M
    G[:, 3:6, 0:3] = -skew(dv[-1] - dv[1:] + turned) @ M
    G[:, 6:9, 0:3] = -skew(dp[-1] - dp[1:] - dv[1:] * left_s + turned * (left_s + 0.5 * step_s)) @ M
    R_mid_dt = 0.5 * (dR[1:] + dR[:-1]) * step_s[:, None]
    G[:, 3:6, 3:6] = R_mid_dt
    G[:, 6:9, 3:6] = R_mid_dt * (left_s + 0.5 * step_s)[:, None]
    return G


def _chain(steps: Array) -> Array:
    """Return (K+1, 3, 3) products I, S0, S0 S1, ..."""
    out = np.empty((len(steps) + 1, 3, 3))
    out[0] = np.eye(3)
    for k, step in enumerate(steps):
        out[k + 1] = out[k] @ step
    return out


def _sums(steps: Array) -> Array:
    """Return (K+1, 3) sums 0, s0, s0 + s1, ..."""
    out = np.zeros((len(steps) + 1, 3))
    np.cumsum(steps, axis=0, out=out[1:])
    return out


def _readings_within(
    samples: list[ImuSample], stamps_ns: list[int], start_ns: int, stamp_ns: int
) -> tuple[Array, Array, Array]:
    """Return times [s] from the start, gyro and accel (K, 3), with interpolated readings at both ends."""
    first, last = max(bisect_left(stamps_ns, start_ns) - 1, 0), bisect_left(stamps_ns, stamp_ns)
    near_ns = stamps_ns[first : last + 1]  # a reading on either side is enough to interpolate
    readings = np.array([[*s.gyro.tolist(), *s.accel.tolist()] for s in samples[first : last + 1]])
    inside = _inside(near_ns, start_ns, stamp_ns)
    stamps = np.array([start_ns, *near_ns[inside], stamp_ns])
    start, end = (_interpolated(readings, near_ns, at_ns) for at_ns in (start_ns, stamp_ns))
    columns = np.vstack([start, readings[inside], end])
    return (stamps - start_ns) / NS_PER_S, columns[:, :3], columns[:, 3:]


def _inside(stamps_ns: list[int], start_ns: int, stamp_ns: int) -> slice:
    """Return which stamps are between the ends of an interval."""
    return slice(bisect_right(stamps_ns, start_ns), bisect_left(stamps_ns, stamp_ns))


def _interpolated(readings: Array, stamps_ns: list[int], at_ns: int) -> Array:
    """Return the reading (6,) at a stamp, held from the nearest one at the ends of the recording."""
    after = bisect_left(stamps_ns, at_ns)
    if after == 0 or after == len(stamps_ns) or stamps_ns[after] == at_ns:
        return np.asarray(readings[min(after, len(stamps_ns) - 1)])
    share = (at_ns - stamps_ns[after - 1]) / (stamps_ns[after] - stamps_ns[after - 1])
    return np.asarray(readings[after - 1] + share * (readings[after] - readings[after - 1]))


def _apart_s(stamps_ns: list[int], start_ns: int, stamp_ns: int) -> Array:
    """Return for each of the K-1 intervals of `_readings_within` how far the readings around it are apart [s].

    They are actual readings, inside the interval or not: an image within a gap does not shorten it.
    """
    inside = _inside(stamps_ns, start_ns, stamp_ns)
    before = stamps_ns[inside.start - 1] if inside.start else start_ns
    after = stamps_ns[inside.stop] if inside.stop < len(stamps_ns) else stamp_ns
    return np.asarray(np.diff([before, *stamps_ns[inside], after]) / NS_PER_S)


def _leap(stamps_ns: list[int], start_ns: int, stamp_ns: int) -> tuple[int, int] | None:
    """Return the longest part of an interval without a reading, if it is longer than LEAP_S."""
    if stamp_ns - start_ns <= LEAP_S * NS_PER_S:
        return None
    parts = itertools.pairwise([start_ns, *stamps_ns[_inside(stamps_ns, start_ns, stamp_ns)], stamp_ns])
    longest = max(parts, key=lambda part: part[1] - part[0])
    return longest if longest[1] - longest[0] > LEAP_S * NS_PER_S else None
