# SPDX-License-Identifier: Apache-2.0
"""Motion by truth and by cameras, for comparison with the IMU and with each other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.truth import unit_of
from uav_vslam.datasets.truth_track import TruthTrack
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.imu_series import ImuSeries
from uav_vslam.inspection import limits
from uav_vslam.inspection.finding import Finding, ok, warning
from uav_vslam.inspection.rotation import CAMERAS, TRUTH, RatePairs, mean_rates, rates_of_rotations
from uav_vslam.inspection.views import Step
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

INTERVAL_S = 0.2  # of truth: long enough for its noise, short enough for one axis of rotation


@dataclass(frozen=True, slots=True)
class Scale:
    """How far cameras fly by stereo, against the truth.

    Attributes:
        factor: over the distance of the truth, in the median.
        steps: number of couples of pairs.
        sound: whether the baseline is that of a usual rig.
    """

    factor: float
    steps: int
    sound: bool

    @property
    def unit(self) -> str:
        """Unit of the truth; empty if it is metres, or none fits."""
        return unit_of(self.factor) if self.sound else ""


def rotations_by_truth(truth: TruthTrack, stamps_ns: Stamps, gyro: Array) -> RatePairs:
    """Return mean rates of truth and gyroscope over intervals of `INTERVAL_S`.

    Args:
        truth: three samples or more.
        stamps_ns: (N,) increasing [ns].
        gyro: (N, 3) readings in the body [rad/s].
    """
    interval_ns, period_ns = INTERVAL_S * NS_PER_S, float(np.median(np.diff(truth.stamps_ns)))
    step = max(1, round(interval_ns / period_ns))
    rows = np.arange(0, len(truth), step)
    starts, ends = truth.stamps_ns[rows[:-1]], truth.stamps_ns[rows[1:]]
    near = (ends - starts) <= 2.0 * max(interval_ns, period_ns)
    starts, ends, rows_start, rows_end = (one[near] for one in (starts, ends, rows[:-1], rows[1:]))
    seconds = (ends - starts) / NS_PER_S
    rates = rates_of_rotations(truth.R_world_body[rows_start], truth.R_world_body[rows_end], seconds)
    return RatePairs(rates, _sigma(seconds), TRUTH, lambda late_ns: mean_rates(stamps_ns - late_ns, gyro, starts, ends))


def rotations_by_cameras(steps: list[Step], rig: StereoRig, stamps_ns: Stamps, gyro: Array) -> RatePairs:
    """Return mean rates of cameras and gyroscope within couples of pairs.

    Args:
        steps: motion within the couples.
        rig: calibration.
        stamps_ns, gyro: as above.
    """
    starts, ends = (np.array([getattr(one, name) for one in steps], np.int64) for name in ("start_ns", "end_ns"))
    seconds = (ends - starts) / NS_PER_S
    R_left_start_end = np.array([one.motion.T_start_end.R for one in steps])
    R_body_left = rig.T_body_left.R
    R_body_start_end = R_body_left @ R_left_start_end @ R_body_left.T
    rates = rates_of_rotations(np.broadcast_to(np.eye(3), R_body_start_end.shape), R_body_start_end, seconds)
    sigma = float(np.median([one.motion.sigma_rotation for one in steps] / seconds))
    return RatePairs(rates, sigma, CAMERAS, lambda late_ns: mean_rates(stamps_ns - late_ns, gyro, starts, ends))


def up_of_truth(truth: TruthTrack, stamps_ns: Stamps, gravity: float) -> Array:
    """Return the (3,) direction of the truth's mean specific force R^T (a + g), in the body, over stamps within it."""
    t = (truth.stamps_ns - truth.stamps_ns[0]) / NS_PER_S
    accel_world = np.gradient(truth.velocities_world, t, axis=0) + np.array([0.0, 0.0, gravity])
    force = np.einsum("nji,nj->ni", truth.R_world_body, accel_world)
    at = (stamps_ns - truth.stamps_ns[0]) / NS_PER_S
    mean = np.array([np.interp(at, t, force[:, k]).mean() for k in range(3)])
    return np.asarray(mean / np.linalg.norm(mean))


def scale_of_truth(steps: list[Step], truth: TruthTrack, rig: StereoRig) -> Scale | None:
    """Return the distance flown between couples of pairs by stereo over that by truth; None with too few of them."""
    low, high = limits.BASELINE_M  # of a rig with another baseline, the scale is its own
    by_truth, by_cameras = [], []  # scales of the steps that one of both knows well
    for step in steps:
        if truth.stamps_ns[0] <= step.start_ns and step.end_ns <= truth.stamps_ns[-1]:
            true = float(np.linalg.norm(_position(truth, step.end_ns) - _position(truth, step.start_ns)))
            T_body = rig.T_body_left @ step.motion.T_start_end @ rig.T_body_left.inverse()
            seen, least = float(np.linalg.norm(T_body.t)), step.motion.sigma_position / limits.STEP_SIGMA_SHARE
            by_truth += [seen / true] if true > least else []
            by_cameras += [seen / true] if seen > least and true > 0.0 else []
    for factors in (by_truth, by_cameras):
        if len(factors) >= limits.MIN_STEPS:
            scale = Scale(float(np.median(factors)), len(factors), sound=low <= rig.baseline_m <= high)
            return scale if factors is by_truth or scale.unit else None  # a hover's steps are noise
    return None


def check_scale(scale: Scale | None) -> list[Finding]:
    """Check the distance by stereo against that by truth: the baseline's scale, and the unit of the truth."""
    if scale is None:
        return []
    low, high = limits.SCALE
    factor = f"{scale.factor:.2f}" if scale.factor > 0.1 else f"{scale.factor:.2g}"
    seen = f"cameras fly {factor} times the distance of the truth, median of {scale.steps} steps"
    if low <= scale.factor <= high:
        return [ok("scale", seen)]
    if scale.unit:
        remedy = "give its positions in metres: it judges nothing until then"
        return [warning("scale", f"{seen}: the truth is in {scale.unit}", f"{low} to {high}", remedy)]
    remedy = "check baseline and focal length, and that truth is in metres and at the right time"
    return [warning("scale", seen, f"{low} to {high}", remedy)]


def check_attitude(truth: TruthTrack | None, readings: ImuSeries) -> list[Finding]:
    """Check that truth turns if the gyroscope does.

    Args:
        truth: true motion, or None.
        readings: of the IMU, in stamp order.
    """
    if truth is None or len(truth) < 3 or truth.turns:
        return []
    within = (readings.stamps_ns >= truth.stamps_ns[0]) & (readings.stamps_ns <= truth.stamps_ns[-1])
    stamps_ns, gyro = readings.stamps_ns[within], readings.gyro[within]
    if len(stamps_ns) < 2:
        return []
    parts = max(1, round((stamps_ns[-1] - stamps_ns[0]) / (INTERVAL_S * NS_PER_S)))
    means = [part.mean(axis=0) for part in np.array_split(gyro, parts) if len(part)]
    rate = float(np.linalg.norm(means, axis=1).max())
    if rate <= limits.TURNS:
        return []
    seen = f"the same in all {len(truth)} poses, while the gyroscope turns at up to {np.degrees(rate):.1f} deg/s"
    remedy = "record the body's orientation: without, only positions are compared, and no axes"
    return [warning("truth attitude", seen, "the orientation of the body", remedy)]


def is_absurd(truth: TruthTrack | None, scale: Scale | None) -> bool:
    """Return whether truth moves as no vehicle does, or in another unit: it judges nothing then."""
    if truth is None or len(truth) < 2:
        return False
    return bool(scale and scale.unit) or float(np.median(truth.speeds)) > limits.LARGEST_SPEED


def _position(truth: TruthTrack, stamp_ns: int) -> Array:
    t = (truth.stamps_ns - truth.stamps_ns[0]) / NS_PER_S
    at = (stamp_ns - truth.stamps_ns[0]) / NS_PER_S
    return np.array([np.interp(at, t, truth.positions_world[:, k]) for k in range(3)])


def _sigma(seconds: Array) -> float:
    """Return the standard deviation of a reference rate per axis [rad/s]: both attitudes have noise."""
    return float(np.radians(limits.REFERENCE_SIGMA_DEG) * np.sqrt(2.0) / np.median(seconds)) if len(seconds) else np.inf
