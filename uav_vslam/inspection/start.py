# SPDX-License-Identifier: Apache-2.0
"""Start state and ground truth: present, at the time of the flight, plausible."""

import math
from heapq import merge

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig
from uav_vslam.datasets.truth import MAX_SPACING_S, spacing_s
from uav_vslam.datasets.truth_track import TruthTrack
from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.ins.alignment import MOST_SIGMAS, biased_rest, static_alignment
from uav_vslam.ins.imu_series import ImuSeries
from uav_vslam.ins.preintegration import MAX_GAP_S
from uav_vslam.ins.propagation import POSITION, ROTATION, VELOCITY
from uav_vslam.ins.startup_buffer import MAX_APART_S, first_rest
from uav_vslam.inspection import limits
from uav_vslam.inspection.finding import Finding, error, ok, warning
from uav_vslam.numerics import is_positive_definite
from uav_vslam.types import NS_PER_S, NavEstimate

Stamps = NDArray[np.int64]

_METHODS = {
    "in_flight": "start.method: in_flight (the vehicle moves at the first readings)",
    "static": "start.method: static (the vehicle rests at the first readings)",
}
METHODS = "start.method: static for a vehicle at rest, in_flight for one that flies already"


def check_start(
    initial: list[NavEstimate],
    images_ns: Stamps,
    readings: ImuSeries,
    config: VehicleConfig,
    truth: TruthTrack | None,
) -> list[Finding]:
    """Check that the configured start can work.

    Args:
        initial: start states recorded.
        images_ns: (N,) stamps of the left images [ns].
        readings: of the IMU in the body, in stamp order.
        config: of the vehicle.
        truth: true motion, if known, in any frame.
    """
    if config.start.searches:
        return [ok("start state", f"start.method {config.start.method}: estimated from images and IMU")]
    if config.start.method == "static":
        return _check_static(readings, images_ns, config)
    if not initial:
        seen, allowed = "start.method is given, but no start state was recorded", "one message on initial_state"
        method = _METHODS[method_for(readings, images_ns, config)] if readings else METHODS
        remedy = f"record one, or set {method}"
        return [error("start state", seen, allowed, remedy)]
    return _check_given(initial[0], images_ns, readings, truth)


def check_truth(truth: TruthTrack | None, images_ns: Stamps, *, recorded: bool) -> list[Finding]:
    """Check that ground truth is there during the flight, and plausible.

    Args:
        truth: true motion, or None.
        images_ns: (N,) stamps of the left images [ns].
        recorded: whether its topic is in the recording.
    """
    if truth is None or len(truth) == 0:
        if recorded:
            remedy = "record the topic again"
            return [warning("truth", "its topic holds nothing that can be read", "poses", remedy)]
        return [ok("truth", "none recorded: estimates can't be compared with it")]
    found = []
    covered = (images_ns >= truth.stamps_ns[0]) & (images_ns <= truth.stamps_ns[-1])
    if len(images_ns) and covered.mean() < limits.UNUSABLE_SHARE:
        later_s = (truth.stamps_ns[0] - images_ns.min()) / NS_PER_S
        seen = f"{covered.sum()} of {len(images_ns)} images are in its time; it begins {later_s:.2f} s after the first"
        remedy = "correct its stamps to the sensors' clock: nothing can be evaluated otherwise"
        found.append(warning("truth time", seen, "truth during the flight", remedy))
    if (apart_s := spacing_s(truth)) > MAX_SPACING_S:
        seen, remedy = f"poses {apart_s:.2g} s apart", "score with `uav-vslam evaluate RESULTS --max-gap S`"
        found.append(warning("truth rate", seen, f"at most {MAX_SPACING_S:g} s apart", remedy))
    speed = truth.speeds
    if len(speed) and speed.max() > limits.LARGEST_SPEED:
        fast = int((speed > limits.LARGEST_SPEED).sum())
        seen = f"{fast} steps are faster, the fastest {speed.max():.3g} m/s"
        remedy = "remove outliers and check the unit of its positions"
        found.append(warning("truth motion", seen, f"at most {limits.LARGEST_SPEED:g} m/s", remedy))
    length = float(np.linalg.norm(np.diff(truth.positions_world, axis=0), axis=1).sum())
    return found or [
        ok("truth", f"{len(truth)} poses, {length:.1f} m, during {covered.sum()} of {len(covered)} images")
    ]


def _check_given(start: NavEstimate, images_ns: Stamps, readings: ImuSeries, truth: TruthTrack | None) -> list[Finding]:
    found = []
    speed = float(np.linalg.norm(start.state.v_map))
    if not np.isfinite(start.covariance).all() or not is_positive_definite(start.covariance):
        remedy = "state how uncertain the start is: variances of zero can't be inverted"
        found.append(error("start covariance", "not positive definite", "a 15 x 15 covariance", remedy))
    if not np.isfinite(speed) or speed > limits.LARGEST_SPEED:
        seen = f"speed {speed:.3g} m/s"
        found.append(warning("start state", seen, f"{limits.LARGEST_SPEED:g} m/s", "check its velocity"))
    if truth is not None and not found:  # the comparison needs a covariance
        found += _check_against_truth(start, truth)
    found += _check_start_time(start.state.stamp_ns, images_ns, readings)
    return found or [ok("start state", f"given, speed {speed:.2f} m/s")]


def _check_start_time(stamp_ns: int, images_ns: Stamps, readings: ImuSeries) -> list[Finding]:
    if len(images_ns) == 0:
        return []
    into_s = (stamp_ns - images_ns.min()) / NS_PER_S
    unused = int((images_ns < stamp_ns).sum())
    remedy = "give the state at the first image, with the sensors' clock"
    if unused >= len(images_ns) or into_s < -MAX_APART_S:
        seen = f"stamped {into_s:.2f} s after the first image, which leaves {len(images_ns) - unused} images"
        return [error("start time", seen, f"within the flight, or {MAX_APART_S:g} s before it", remedy)]
    before_s = (readings.stamps_ns[0] - stamp_ns) / NS_PER_S if readings else 0.0
    if before_s > MAX_GAP_S:
        seen = f"{before_s:.2f} s before the first reading"
        return [warning("start time", seen, f"at most {MAX_GAP_S:g} s: the motion between is unknown", remedy)]
    if unused > 1:
        seen = f"{unused} of {len(images_ns)} images are before it"
        return [warning("start time", seen, "at the first image", "they are not used: give an earlier state")]
    return []


def _check_against_truth(start: NavEstimate, truth: TruthTrack) -> list[Finding]:
    nearest = int(np.argmin(np.abs(truth.stamps_ns - start.state.stamp_ns)))
    if abs(truth.stamps_ns[nearest] - start.state.stamp_ns) > MAX_GAP_S * NS_PER_S:
        return []
    return _check_start_motion(start, truth, nearest) or _check_truth_origin(start, truth, nearest)


def _check_start_motion(start: NavEstimate, truth: TruthTrack, at: int) -> list[Finding]:
    """Compare the velocities in the body, which do not depend on the frames that start and truth are given in."""
    given = start.state.T_map_body.R.T @ start.state.v_map
    true = truth.R_world_body[at].T @ truth.velocities_world[at]
    P, speed = start.covariance, float(np.linalg.norm(given))
    sigma = np.sqrt(np.trace(P[VELOCITY, VELOCITY]) + speed**2 * np.trace(P[ROTATION, ROTATION]))
    allowed = limits.START_SIGMAS * sigma + limits.START_VELOCITY
    off = float(np.linalg.norm(given - true))
    if off <= allowed:
        return []
    seen = f"in the body its velocity is {_vector(given)} m/s, the truth's {_vector(true)} m/s"
    remedy = "check velocity and orientation of both, and that they are of the same body frame"
    return [warning("start state", seen, f"at most {allowed:.2g} m/s apart", remedy)]


def _check_truth_origin(start: NavEstimate, truth: TruthTrack, at: int) -> list[Finding]:
    """Check that start and truth are given in one frame: errors are not aligned."""
    given, P = start.state.T_map_body, start.covariance
    away_m = float(np.linalg.norm(given.t - truth.positions_world[at]))
    turned_deg = math.degrees(np.linalg.norm(so3_log(given.R.T @ truth.R_world_body[at])))
    most_m = limits.START_SIGMAS * math.sqrt(np.trace(P[POSITION, POSITION])) + limits.START_DISTANCE
    most_deg = limits.START_SIGMAS * math.degrees(math.sqrt(np.trace(P[ROTATION, ROTATION]))) + limits.START_TURN_DEG
    if away_m <= most_m and turned_deg <= most_deg:
        return []
    seen = f"where the flight starts it is {away_m:.3g} m and {turned_deg:.0f} deg from the start state"
    remedy = "errors count in one frame: give both in one, or score with `uav-vslam evaluate RESULTS --alignment se3`"
    return [warning("truth origin", seen, f"at most {most_m:.2g} m and {most_deg:.2g} deg", remedy)]


def _vector(v: NDArray[np.float64]) -> str:
    return " ".join(f"{x:.2f}" for x in v)


def _check_static(readings: ImuSeries, images_ns: Stamps, config: VehicleConfig) -> list[Finding]:
    try:
        start = _static(readings, images_ns, config)
    except UavVslamError as refused:
        return [error("start state", str(refused), f"rest for {config.start.rest_s:g} s", METHODS)]
    if biased := biased_rest(start, config.imu):
        return [warning("start state", biased, f"at most {MOST_SIGMAS:g} sigmas", "see the text")]
    return [ok("start state", f"start.method static: at rest for {config.start.rest_s:g} s")]


def method_for(readings: ImuSeries, images_ns: Stamps, config: VehicleConfig) -> str:
    """Return the start.method that suits a recording without a start state."""
    try:
        _static(readings, images_ns, config)
    except UavVslamError:
        return "in_flight"
    return "static"


def _static(readings: ImuSeries, images_ns: Stamps, config: VehicleConfig) -> NavEstimate:
    items = merge(images_ns[:1].tolist(), readings, key=lambda item: getattr(item, "stamp_ns", item))
    samples = first_rest(items, config.start.rest_s)
    return static_alignment(samples, samples[-1].stamp_ns if samples else 0, config.imu)
