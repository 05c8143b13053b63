# SPDX-License-Identifier: Apache-2.0
"""The checks of the IMU, with the other sources about its axes: start state, truth, cameras."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig
from uav_vslam.datasets.survey import Survey
from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.imu_series import ImuSeries
from uav_vslam.ins.mounting import ImuMounting
from uav_vslam.inspection import imu_readings, limits
from uav_vslam.inspection.finding import Finding, Severity, count, warning
from uav_vslam.inspection.imu_noise import NoiseLevels, at_rest, check_noise, noise_level, noise_levels
from uav_vslam.inspection.imu_readings import GRAVITY_DIRECTION
from uav_vslam.inspection.motion import rotations_by_cameras, rotations_by_truth, up_of_truth
from uav_vslam.inspection.rotation import (
    CORRECT_STAMPS,
    SUBJECT,
    TRUTH,
    cameras_agree,
    check_rate_size,
    check_rotation,
)
from uav_vslam.inspection.timing import recorded_late_ms
from uav_vslam.inspection.views import Views
from uav_vslam.search import nearest
from uav_vslam.types import NS_PER_S, ImuSample

Array = NDArray[np.float64]

START_WINDOW_S = 1.0  # before and after the start state, over which specific force is averaged


def readings_in_body(survey: Survey) -> ImuSeries:
    """Return the readings that the graph takes, in the body; in their own axes where the mounting is unknown."""
    try:
        mounting = ImuMounting(survey.setup.T_body_imu())
    except CalibrationError:
        return ImuSeries(_increasing(survey.imu))
    return ImuSeries(map(mounting.to_body, _increasing(survey.imu)))


def check_imu(
    survey: Survey,
    readings: ImuSeries,
    rig: StereoRig | None,
    looked: Views,
    config: VehicleConfig,
) -> tuple[list[Finding], dict[str, NoiseLevels]]:
    """Judge values, units, axes, range and noise of the IMU.

    Args:
        survey: what was recorded.
        readings: in the body, in stamp order.
        rig: calibration, or None.
        looked: motion by the cameras.
        config: of the vehicle.

    Returns:
        The findings, and the noise by sensor; empty where it can't be measured.
    """
    raw = survey.imu.gyro, survey.imu.accel
    found = imu_readings.check_finite(*raw) + imu_readings.check_united(len(survey.imu), survey.unmatched)
    if not readings:
        return found, {}
    readings, left_out = imu_readings.without_outliers(readings)
    found += left_out
    finite = np.isfinite(np.hstack(raw)).all(axis=1)
    for (sensor, unit), values in zip(imu_readings.SENSORS, raw, strict=True):
        found += imu_readings.check_stuck(values[finite], sensor)
        found += imu_readings.check_saturation(values[finite], sensor, unit)
    stamps, gyro, accel, measured = readings.stamps_ns, readings.gyro, readings.accel, readings.accel_at_imu
    rate_hz = NS_PER_S / survey.streams["imu"].period_ns
    units = imu_readings.check_units(accel, gravity=config.imu.gravity, rate_hz=rate_hz)
    rates = check_rate_size(gyro)
    if not survey.setup.missing_imu_transforms():  # of unknown axes nothing more can be said
        found += _check_gravity(survey, stamps, accel, config)
        rates += _check_rates(survey, stamps, gyro, rig, looked)
    found += [*units, *rates]
    if count([*units, *rates], Severity.ERROR):  # noise in other units would mislead
        return found, {}
    resting = at_rest(stamps, gyro, measured)
    noise = noise_levels(stamps, gyro, measured, config.imu, resting)
    if survey.forces:  # what is between them is smooth
        own = ImuSeries(_increasing(survey.forces))
        near = resting[nearest(own.stamps_ns, stamps)]
        noise["accelerometer"] = noise_level(own.stamps_ns, own.accel, config.imu.accel_noise, near)
    return [*found, *check_noise(noise)], noise


def _check_gravity(survey: Survey, stamps: NDArray[np.int64], accel: Array, config: VehicleConfig) -> list[Finding]:
    """Check gravity's direction against the start state, the truth, or else a level body."""
    found = []
    if survey.initial and config.start.method == "given":
        state = survey.initial[0].state
        near = np.abs(stamps - state.stamp_ns) <= START_WINDOW_S * NS_PER_S
        if near.any():
            found += imu_readings.check_gravity_direction(
                accel[near].mean(axis=0), state.T_map_body.R[2], known_from="the start state", tilt_deg=limits.TILT_DEG
            )
    truth = survey.truth
    if truth is not None and count(found, Severity.ERROR) == 0:
        covered = (stamps >= truth.stamps_ns[0]) & (stamps <= truth.stamps_ns[-1])
        if covered.any() and len(truth) > 2:
            up = up_of_truth(truth, stamps[covered], config.imu.gravity)
            found += imu_readings.check_gravity_direction(
                accel[covered].mean(axis=0), up, known_from=TRUTH, tilt_deg=limits.MEAN_TILT_DEG
            )
    return found or imu_readings.check_gravity_direction(
        accel.mean(axis=0), None, known_from="the z axis", tilt_deg=limits.TILT_DEG
    )


def _check_rates(
    survey: Survey, stamps: NDArray[np.int64], gyro: Array, rig: StereoRig | None, looked: Views
) -> list[Finding]:
    """Check the gyroscope against truth and cameras."""
    found: list[Finding] = []
    offset_ns = survey.setup.time_offset_ns
    late_ms = recorded_late_ms(survey.streams, offset_ns)
    if not gyro.any():  # `check_stuck` names it
        return found
    if survey.truth is not None and len(survey.truth) > 2:
        found += check_rotation(replace(rotations_by_truth(survey.truth, stamps, gyro), recorded_late_ms=late_ms))
    if rig is not None and looked.steps:
        pairs = rotations_by_cameras(looked.steps, rig, stamps, gyro)
        found += check_rotation(replace(pairs, offset_ns=offset_ns, recorded_late_ms=late_ms))
    return found


def check_axes_of_truth(findings: Sequence[Finding]) -> list[Finding]:
    """Return that the truth is of other axes than the body, if it contradicts an IMU with which the cameras agree.

    Args:
        findings: of `check_imu`.
    """
    by_truth = (f"{SUBJECT} {TRUTH}", GRAVITY_DIRECTION)
    faults = [one for one in findings if one.severity is not Severity.OK and one.subject in by_truth]
    faults = [one for one in faults if TRUTH in one.subject + one.seen and not one.remedy.startswith(CORRECT_STAMPS)]
    if not faults or not cameras_agree(findings):
        return []
    seen = "; ".join(f"{one.subject}: {one.seen}" for one in faults)
    remedy = "give the truth of the body's frame: its positions can be compared, errors of attitude and heading can't"
    return [warning("truth axes", f"{seen}; the cameras agree with the gyroscope", "those of the body", remedy)]


def _increasing(readings: ImuSeries) -> Iterator[ImuSample]:
    """Yield the finite readings whose stamps increase."""
    newest_ns: int | None = None
    for one in readings:
        if one.is_finite and (newest_ns is None or one.stamp_ns > newest_ns):
            newest_ns = one.stamp_ns
            yield one
