# SPDX-License-Identifier: Apache-2.0
"""Readings of the IMU: units, gravity, stuck and saturated axes."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.ins.imu_series import ImuSeries
from uav_vslam.ins.outliers import Judged, OutlierFilter
from uav_vslam.inspection import limits
from uav_vslam.inspection.finding import Finding, error, ok, warning

Array = NDArray[np.float64]

GRAVITY_DIRECTION = "IMU gravity direction"
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
AVERAGED_S = 0.5  # over which vibration averages out, and manoeuvres do not
SENSORS = (("gyroscope", "rad/s"), ("accelerometer", "m/s^2"))


def check_finite(gyro: Array, accel: Array) -> list[Finding]:
    """Check that (N, 3) rates and (N, 3) specific forces are numbers; the graph drops a reading if one is not."""
    bad = [~np.isfinite(values).all(axis=1) for values in (gyro, accel)]
    dropped = int((bad[0] | bad[1]).sum())
    if not dropped:
        return []
    where = ", ".join(f"{rows.sum()} of the {sensor}" for rows, (sensor, _) in zip(bad, SENSORS, strict=True))
    judge = error if dropped > limits.UNUSABLE_SHARE * len(gyro) else warning
    seen = f"{dropped} of {len(gyro)} are NaN, infinite or marked as not measured: {where}"
    return [judge("IMU readings", seen, "finite numbers", "such readings are dropped: correct the driver")]


def check_united(united: int, unmatched: int) -> list[Finding]:
    """Check how many readings of the gyroscope had none of an accelerometer that has a topic of its own."""
    total = united + unmatched
    if unmatched <= limits.LOST_SHARE * total:
        return []
    judge = error if unmatched > limits.UNUSABLE_SHARE * total else warning
    seen = f"{unmatched} of {total} readings of the gyroscope have none of the accelerometer on both sides within 0.1 s"
    return [judge("accelerometer", seen, "one clock, no gaps", "they are left out: record both sensors throughout")]


def without_outliers(readings: ImuSeries) -> tuple[ImuSeries, list[Finding]]:
    """Return the readings, of those in stamp order, that the graph uses, and how many it leaves out."""
    outliers, used, left_out = OutlierFilter(), ImuSeries(), list[Judged]()
    for one in readings:
        judged = outliers.add(one)
        used.extend(judged.readings)
        if judged.outlier is not None:
            left_out.append(judged)
    used.extend(outliers.rest())
    if not left_out:
        return used, []
    seen = f"{len(left_out)} of {len(readings)} are no motion, the first: {left_out[0].finding}"
    return used, [warning("IMU outliers", seen, "none", "such readings are left out: look for faults of the transfer")]


def check_units(accel: Array, *, gravity: float, rate_hz: float) -> list[Finding]:
    """Check the size of (N, 3) specific forces, vibration averaged out; in steady flight it is near gravity [m/s^2]."""
    count = max(1, round(len(accel) / max(1.0, AVERAGED_S * rate_hz)))
    means = [part.mean(axis=0) for part in np.array_split(accel, count) if len(part)]
    if not means or not accel.any():  # `check_stuck` names it
        return []
    size = float(np.median(np.linalg.norm(means, axis=1)))
    share = size / gravity
    low, high = limits.GRAVITY_SHARE
    if low <= share <= high:
        return [ok("IMU gravity size", f"median specific force {size:.2f} m/s^2")]
    seen, allowed = f"median specific force {size:.3g}", f"near {gravity:.2f} m/s^2"
    steady = float(np.linalg.norm(np.mean(means, axis=0))) / size if size > 0 else 0.0  # gravity keeps its direction
    if share < limits.NO_GRAVITY_SHARE or (share < low and steady < limits.NO_GRAVITY_STEADY):
        remedy = "record raw readings: a driver's 'linear' or 'free' acceleration can't be used"
        return [error("IMU gravity size", f"{seen}: gravity was removed", allowed, remedy)]
    for unit, factor in limits.UNITS.items():
        if abs(share / factor - 1.0) <= limits.UNIT_SPREAD:
            return [
                error("IMU gravity size", f"{seen}: {unit}", allowed, f"multiply the readings by {1.0 / factor:.5g}")
            ]
    remedy = f"correct the scale: a factor of {1.0 / share:.3g} is missing, unless saturation falsifies the mean"
    return [error("IMU gravity size", seen, allowed, remedy)]


def check_gravity_direction(force: Array, up: Array | None, *, known_from: str, tilt_deg: float) -> list[Finding]:
    """Check the direction of the mean specific force against where up is.

    Args:
        force: (3,) mean specific force in the body's axes.
        up: (3,) unit vector up there; None if unknown, then the body is expected to be level (FLU).
        known_from: its source, in words.
        tilt_deg: largest angle between both [deg].
    """
    expected = np.array([0.0, 0.0, 1.0]) if up is None else up
    size = float(np.linalg.norm(force))
    if size < 1e-6:
        return []
    angle_deg = float(np.degrees(np.arccos(np.clip(force @ expected / size, -1.0, 1.0))))
    nearest = AXES[_nearest_axis(force)]
    seen = f"mean specific force ({', '.join(f'{one:.2f}' for one in force)}), up is along {nearest} of the body"
    if angle_deg <= tilt_deg:
        return [ok(GRAVITY_DIRECTION, f"{seen}, {angle_deg:.1f} deg from {known_from}")]
    seen += f", {angle_deg:.0f} deg from {known_from}"
    allowed = f"at most {tilt_deg:g} deg"
    if up is None:
        remedy = "if the body is FLU, give the IMU's mounting in /tf_static or input.calibration; else ignore this"
        return [warning(GRAVITY_DIRECTION, f"{seen}{_axes_text(angle_deg)}", allowed, remedy)]
    remedy = "give the IMU's mounting in /tf_static with its header.frame_id, or in input.calibration"
    return [error(GRAVITY_DIRECTION, f"{seen}{_axes_text(angle_deg)}", allowed, remedy)]


def check_stuck(readings: Array, sensor: str) -> list[Finding]:
    """Check that no axis of (N, 3) readings is constant."""
    if len(readings) < limits.EXTREME_LEVELS:
        return []
    stuck = [axis for k, axis in enumerate("xyz") if np.ptp(readings[:, k]) == 0.0]
    if not stuck:
        return []
    if len(stuck) == 3 and not readings.any():
        seen = "all readings are zero"
        remedy = "record a topic that holds both sensors (unite them in the driver), or set input.topics.accel"
    else:
        seen, remedy = f"constant on {', '.join(stuck)}", "repair or replace the sensor"
    return [error(sensor, seen, "readings that vary by noise at least", remedy)]


def check_saturation(readings: Array, sensor: str, unit: str) -> list[Finding]:
    """Check that no axis of (N, 3) readings repeats its largest or smallest value, as at the end of a range."""
    found = []
    for k, axis in enumerate("xyz"):
        for side, values in (("+", readings[:, k]), ("-", -readings[:, k])):
            clipped = clipped_count(values)
            if clipped:
                sign = 1.0 if side == "+" else -1.0
                found.append(f"{clipped} at {sign * values.max():.4g} {unit} on {axis}")
    if not found:
        return [ok(f"{sensor} range", "no saturation")] if len(readings) else []
    seen = f"{', '.join(found)}, of {len(readings)} readings"
    remedy = "choose a larger range, or isolate the IMU from vibration: clipped readings are a bias"
    return [warning(f"{sensor} saturation", seen, "extremes that do not repeat", remedy)]


def clipped_count(values: Array) -> int:
    """Return how many of (N,) values are clipped to the largest one; 0 if they are not.

    Values pile up at the end of the range: more are exactly there than at each of the next values below.
    """
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < limits.EXTREME_LEVELS or counts[-1] < limits.EXTREME_COUNT:
        return 0
    return int(counts[-1]) if counts[-1] > limits.EXTREME_RATIO * counts[-11:-1].max() else 0


def _nearest_axis(vector: Array) -> int:
    return int(np.argmax(np.stack([vector, -vector], axis=1).ravel()))


def _axes_text(angle_deg: float) -> str:
    if angle_deg > 180.0 - limits.TILT_DEG:
        return ": upside down, or NED (FRD) axes, or the sign of gravity"
    return ": the axes are not those of the body"
