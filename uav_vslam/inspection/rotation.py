# SPDX-License-Identifier: Apache-2.0
"""Gyroscope against a reference rotation, of truth or cameras: scale and axes.

Mean rates over short intervals are compared, w = s A r + b: s is 1, or that of degrees; A is the identity, a turn by
multiples of 90 degrees, or a mirror; b is the gyroscope's bias. If the difference is small, or that does not explain
it, an offset between the clocks is looked for: a small one, and about that which the recorder's clock shows.
"""

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.rotation import so3_log
from uav_vslam.ins.preintegration import MAX_GAP_S
from uav_vslam.inspection import limits
from uav_vslam.inspection.finding import Finding, Severity, error, ok, warning
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

SCALES = {1.0: "", 180.0 / math.pi: "in degrees, not in radians", math.pi / 180.0: "in radians taken for degrees"}
CAMERAS, TRUTH = "the cameras", "the truth"
CORRECT_STAMPS = "correct the stamps"
SUBJECT, NOT_JUDGED = "gyroscope against", "not judged"
MIN_INTERVALS = 4
LATE_MS = range(-300, 301, 5)  # offsets of the clocks that are tried
LATE_SHARE = 0.5  # of the difference: an offset that leaves less explains it
LATE_RUINOUS_MS = 25  # of 10 and 20 ms a flight is as good as without, of 30 ms one of three goes astray
LATE_WARNED_MS = 10  # three sigma of `rig.time_offset_sigma_s`: the filter estimates smaller offsets
ALLOWED = f"at most {100 * limits.ROTATION_MISFIT:.0f} %"
COVERED_SHARE = 0.5  # of the intervals without an offset: one that leaves fewer is no match


@dataclass(frozen=True, slots=True)
class RatePairs:
    """Mean angular rates of the body over the same intervals [rad/s].

    Attributes:
        reference: (K, 3) of the reference.
        sigma: standard deviation of the reference, per axis.
        source: the reference, in words.
        gyro_if_late: returns the (K, 3) rates of the gyroscope [rad/s], NaN where not covered, if its stamps are late
            by so many ns.
        offset_ns: what is added to the stamps of the reference already [ns].
        recorded_late_ms: by how much the IMU's stamps are late by the recorder's clock; 0 if by little [ms].
    """

    reference: Array
    sigma: float
    source: str
    gyro_if_late: Callable[[int], Array]
    offset_ns: int = 0
    recorded_late_ms: int = 0


def mean_rates(stamps_ns: Stamps, gyro: Array, starts_ns: Stamps, ends_ns: Stamps) -> Array:
    """Return (K, 3) mean rates over K intervals, NaN where readings do not cover one, or have a gap in it.

    Args:
        stamps_ns: (N,) increasing [ns].
        gyro: (N, 3) readings.
        starts_ns, ends_ns: (K,) [ns].
    """
    if len(stamps_ns) < 2:
        return np.full((len(starts_ns), 3), np.nan)
    t = (stamps_ns - stamps_ns[0]) / NS_PER_S
    angle = np.vstack([np.zeros(3), np.cumsum(0.5 * (gyro[1:] + gyro[:-1]) * np.diff(t)[:, None], axis=0)])
    start, end = (np.asarray(one - stamps_ns[0], float) / NS_PER_S for one in (starts_ns, ends_ns))
    turned = np.column_stack([np.interp(end, t, angle[:, k]) - np.interp(start, t, angle[:, k]) for k in range(3)])
    gaps = np.concatenate([[0], np.cumsum(np.diff(t) > MAX_GAP_S)])
    inside = gaps[np.searchsorted(t, start, "right") - 1] == gaps[np.searchsorted(t, end).clip(max=len(t) - 1)]
    turned[(start < t[0]) | (end > t[-1]) | ~inside] = np.nan
    return np.asarray(turned / (end - start)[:, None])


def rates_of_rotations(R_reference_start: Array, R_reference_end: Array, seconds: Array) -> Array:
    """Return (K, 3) mean body rates of (K, 3, 3) attitudes at both ends of intervals (K,) [s]."""
    return np.asarray(so3_log(np.swapaxes(R_reference_start, -1, -2) @ R_reference_end) / seconds[:, None])


def check_rotation(pairs: RatePairs) -> list[Finding]:
    """Check scale and axes of the gyroscope."""
    gyro = pairs.gyro_if_late(0)
    good = _covered(gyro, pairs.reference)
    gyro, reference = (_centred(one[good]) for one in (gyro, pairs.reference))
    subject = f"{SUBJECT} {pairs.source}"
    turned = _rms(reference)
    if good.sum() < MIN_INTERVALS and pairs.recorded_late_ms:
        return _check_apart(pairs, subject)
    if good.sum() < MIN_INTERVALS or turned < limits.ROTATION_DETECTED * pairs.sigma:
        return [ok(subject, f"{NOT_JUDGED}: the vehicle turned too little, or too few intervals")]
    misfit = _misfit(gyro, reference, 1.0, np.eye(3))
    seen = f"rms difference {100 * misfit:.0f} % over {good.sum()} intervals of {math.degrees(turned):.1f} deg/s rms"
    if misfit <= limits.ROTATION_MISFIT:
        return [_late_but_alike(pairs, subject, seen, misfit) if misfit > _noise(pairs, turned) else ok(subject, seen)]
    scale, axes = min(
        itertools.product(SCALES, _axes()), key=lambda one: (round(_misfit(gyro, reference, *one), 2), _changes(*one))
    )
    best = _misfit(gyro, reference, scale, axes)
    if best > limits.ROTATION_MISFIT:
        late_ms, left = _lateness(pairs)
        if left <= min(limits.ROTATION_MISFIT, LATE_SHARE * misfit):
            return [_late(pairs, subject, seen, late_ms, left)]
        remedy = f"check the extrinsics of camera and IMU, and the clocks of the IMU and {pairs.source}"
        return [warning(subject, f"{seen}; no other unit or axes explain it", ALLOWED, remedy)]
    said = [SCALES[scale], _axes_text(axes)]
    seen += f"; {100 * best:.0f} % if it is {' and '.join(one for one in said if one)}"
    remedy = " and ".join(
        (["convert the readings to rad/s"] if SCALES[scale] else [])
        + (["give the IMU's mounting in /tf_static or input.calibration"] if _axes_text(axes) else [])
    )
    return [error(subject, seen, ALLOWED, remedy)]


def cameras_agree(findings: Iterable[Finding]) -> bool:
    """Return whether `check_rotation` has judged the gyroscope against the cameras, and found no fault."""
    judged = (one for one in findings if one.subject == f"{SUBJECT} {CAMERAS}" and not one.seen.startswith(NOT_JUDGED))
    return any(one.severity is Severity.OK for one in judged)


def _check_apart(pairs: RatePairs, subject: str) -> list[Finding]:
    """Judge rates of which hardly any are at the same time by the stamps, but some may be by the recorder's clock."""
    late_ms, left = _lateness(pairs)
    if left > limits.ROTATION_MISFIT:
        return [ok(subject, f"{NOT_JUDGED}: too few intervals at the same time")]
    return [_late(pairs, subject, "not at the same time", late_ms, left)]


def _late(pairs: RatePairs, subject: str, seen: str, late_ms: int, left: float) -> Finding:
    """Return the fault that an offset of the clocks explains; one of the truth's does not harm the flight."""
    judge = error if pairs.source == CAMERAS and abs(late_ms) > LATE_RUINOUS_MS else warning
    return judge(subject, seen + _late_text(late_ms, left), ALLOWED, _late_remedy(pairs, late_ms))


def _noise(pairs: RatePairs, turned: float) -> float:
    """Return the misfit that the noise of the reference alone leaves."""
    return math.sqrt(3.0) * pairs.sigma / turned


def _late_but_alike(pairs: RatePairs, subject: str, seen: str, misfit: float) -> Finding:
    """Judge rates that agree: in slow motion a ruinous offset of the clocks leaves little difference."""
    late_ms, left = _lateness(pairs)
    if abs(late_ms) < LATE_WARNED_MS or left > LATE_SHARE * misfit:
        return ok(subject, seen)
    allowed = f"less than {LATE_WARNED_MS} ms"
    return warning(subject, seen + _late_text(late_ms, left), allowed, _late_remedy(pairs, late_ms))


def _late_text(late_ms: int, left: float) -> str:
    size = f"{abs(late_ms)} ms" if abs(late_ms) < 1000 else f"{abs(late_ms) / 1000:.3f} s"
    return f"; {100 * left:.0f} % if the IMU's stamps are {size} {'late' if late_ms > 0 else 'early'}"


def _late_remedy(pairs: RatePairs, late_ms: int) -> str:
    """Return what to do; the images' offset is the one that is set already and the remainder measured here."""
    remedy = f"{CORRECT_STAMPS} of the IMU or of {pairs.source}"
    if pairs.source != CAMERAS:
        return remedy
    timeshift_s = round(pairs.offset_ns / NS_PER_S + late_ms / 1000, 4)
    return (
        f"{remedy}, or give a Kalibr camchain with timeshift_cam_imu: {timeshift_s:.15g} (to about {LATE_MS.step} ms) "
        "by input.calibration"
    )


def _lateness(pairs: RatePairs) -> tuple[int, float]:
    """Return the lateness that fits best [ms] and the misfit left; 0 and infinity if none can be judged."""
    enough = max(MIN_INTERVALS, COVERED_SHARE * int(_covered(pairs.gyro_if_late(0), pairs.reference).sum()))
    found = [
        (_misfit_of(pairs.gyro_if_late(late_ms * 1_000_000), pairs.reference, enough), abs(late_ms), late_ms)
        for late_ms in {*LATE_MS, *(pairs.recorded_late_ms + ms for ms in LATE_MS)}
    ]
    left, _, late_ms = min(found)
    return late_ms, left


def _misfit_of(gyro: Array, reference: Array, enough: float) -> float:
    """Return the misfit of (K, 3) rates; infinity if it is undefined, or if not enough intervals are covered."""
    good = _covered(gyro, reference)
    if good.sum() < enough or _rms(_centred(reference[good])) == 0.0:
        return math.inf
    return _misfit(_centred(gyro[good]), _centred(reference[good]), 1.0, np.eye(3))


def _covered(gyro: Array, reference: Array) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(gyro).all(axis=1) & np.isfinite(reference).all(axis=1))


def check_rate_size(gyro: Array) -> list[Finding]:
    """Check that (N, 3) rates are plausible without any reference [rad/s]."""
    if len(gyro) == 0:
        return []
    rms, largest = _rms(gyro), float(np.abs(gyro).max())
    seen = f"rms {rms:.3g}, largest {largest:.3g} rad/s"
    if rms <= limits.MEAN_RATE and largest <= limits.LARGEST_RATE:
        return [ok("gyroscope size", seen)]
    allowed = f"rms {limits.MEAN_RATE:.1f}, largest {limits.LARGEST_RATE:.0f} rad/s"
    return [error("gyroscope size", f"{seen}: probably degrees per second", allowed, "convert the readings to rad/s")]


def _centred(rates: Array) -> Array:
    return rates - rates.mean(axis=0) if len(rates) else rates


def _rms(rates: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(rates**2, axis=1)))) if len(rates) else 0.0


def _misfit(gyro: Array, reference: Array, scale: float, axes: Array) -> float:
    return _rms(gyro / scale - reference @ axes.T) / _rms(reference)


def _axes() -> list[Array]:
    """Return the 48 signed permutations of the axes."""
    signs = itertools.product((1.0, -1.0), repeat=3)
    orders = itertools.permutations(range(3))
    return [np.diag(sign) @ np.eye(3)[list(order)] for sign, order in itertools.product(signs, orders)]


def _changes(scale: float, axes: Array) -> tuple[bool, bool, int]:
    """Return how much an explanation assumes: of equally good ones, the least is taken."""
    return scale != 1.0, bool(np.linalg.det(axes) < 0), int((axes != np.eye(3)).sum())


def _axes_text(axes: Array) -> str:
    """Return which axis of the body each of the IMU's shows, in words; empty if they agree."""
    if np.array_equal(axes, np.eye(3)):
        return ""
    shown = [f"{'+' if row.sum() > 0 else '-'}{'xyz'[int(np.argmax(np.abs(row)))]}" for row in axes]
    text = f"in axes that are the body's ({', '.join(shown)})"
    if shown == ["+x", "-y", "-z"]:
        text += ", upside down or NED (FRD)"
    return text
