# SPDX-License-Identifier: Apache-2.0
"""Measures the readout of a rolling shutter by tracked points, and warns if it is not the one that is configured.

From one frame to the next a point moves as the camera does, and by what its rows were late: q readout, with q the
velocity of its image times how far below the middle it is, there minus here. Least squares over the points of a pair of
frames finds that beside a correction of the camera's motion and one of the right focal length, whose error changes the
depth of the outer rows' points, and so their motion, if the baseline is along the columns. What gives the readout away
is that the image moves faster in the one frame than in the other: nothing else stretches it by so much, along the
motion and in step with the gyroscope.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import RigConfig
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.rotation import skew
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.slam.rolling_shutter import below_middle, velocities_left
from uav_vslam.types import ImuIncrement, NavState, StereoFeatures

Array = NDArray[np.float64]

FEWEST_POINTS, MOST_POINTS = 20, 100  # of a pair of frames
FEWEST_PAIRS = 10
KNOWN_S = 2e-4  # standard deviation of a readout that is judged
WARNED_S = 5e-4  # least error that is warned of: it moves the points of the outer rows by a tenth of a pixel
WARNED_SIGMAS = 6.0
COARSE_S, COARSE_SIGMAS = 5e-3, 10.0  # least error that is judged before it is known
ROUNDS = 3  # of least squares, each without the outliers of the one before
OUTLIER = 3.0  # times the median residual
FOCAL_LENGTH = 6  # number of the unknown
STEP = 0.01  # of a numerical derivative, in standard deviations
LEAST_PX = 0.01  # noise of tracked points
LEAST_INFORMATION = 1e2  # of a pair of frames that counts: 0.1 s [1/s^2]


@dataclass(frozen=True, slots=True)
class _Seen:
    """A frame: its points, the state of the vehicle and its angular rate (3,) in the map frame [rad/s]."""

    features: StereoFeatures
    nav: NavState
    rate_map: Array


@dataclass(slots=True)
class _Mean:
    """The mean of values, each with its information."""

    count: int = 0
    information: float = 0.0
    weighted: float = 0.0
    squared: float = 0.0

    def add(self, value: float, information: float) -> None:
        self.count += 1
        self.information += information
        self.weighted += information * value
        self.squared += information * value**2

    @property
    def mean(self) -> float:
        return self.weighted / self.information

    @property
    def sigma(self) -> float:
        """Standard deviation of the mean, not below that by the values' scatter; of two values or more."""
        scatter = (self.squared - self.information * self.mean**2) / (self.count - 1)
        return float((max(1.0, scatter) / self.information) ** 0.5)


class ShutterMonitor:
    """Watches pairs of frames until the readout is known, and judges it once.

    Attributes:
        watching: the readout is not known yet.
        contradicting_s: the readout, if it is known and not the one that is configured [s].
    """

    def __init__(self, config: RigConfig) -> None:
        self._config = config
        self._before: StereoFeatures | None = None
        self._found = _Mean()
        self.watching = True
        self.contradicting_s: float | None = None

    def begin(self, features: StereoFeatures) -> None:
        """Begin with a frame: the motion up to there is not known well."""
        self._before = features if self.watching else None

    def add(
        self, features: StereoFeatures, before: NavState, now: NavState, increment: ImuIncrement, rig: StereoRig
    ) -> str:
        """Add a frame and return a warning, normally empty, and empty after the first.

        Args:
            features: as the cameras showed them.
            before: estimate at the frame before.
            now: the same with the motion up to this frame: no image has changed it, and no recovery.
            increment: that motion.
            rig: calibration.
        """
        if not self.watching:
            return ""
        shown, self._before = self._before, features
        if shown is not None and shown.stamp_ns == increment.start_ns:
            here = _Seen(shown, before, Turning.at_start(increment, before).rate_map)
            there = _Seen(features, now, Turning.at_end(increment, now).rate_map)
            found = _readout(here, there, rig, self._config)
            if found is not None:
                self._found.add(*found)
        if self._found.count < FEWEST_PAIRS:
            return ""
        readout_s, sigma_s, configured_s = self._found.mean, self._found.sigma, self._config.readout_s
        is_far = abs(readout_s - configured_s) > max(COARSE_S, COARSE_SIGMAS * sigma_s)
        if sigma_s > KNOWN_S and not is_far:
            return ""
        self.watching, self._before = False, None
        if abs(readout_s - configured_s) < max(WARNED_S, WARNED_SIGMAS * sigma_s):
            return ""
        self.contradicting_s = readout_s
        return (
            f"the rows of an image are exposed one after another: the last one {1e3 * readout_s:.2f} ms "
            f"± {1e3 * sigma_s:.2f} ms after the first, which is not rig.readout_s, {1e3 * configured_s:g} ms: "
            f"set that to {readout_s:.5f}; what else is warned of may come of it"
        )


def _readout(here: _Seen, there: _Seen, rig: StereoRig, config: RigConfig) -> tuple[float, float] | None:
    """Return the readout [s] that two frames show, and its information [1/s^2].

    None if too few tracks join them, or the vehicle hardly moves.
    """
    tracks, rows_here, rows_there = np.intersect1d(here.features.tracks, there.features.tracks, return_indices=True)
    rows = np.flatnonzero(tracks > 0)[:: max(1, len(tracks) // MOST_POINTS)]
    pixels = here.features.pixels[rows_here[rows]].astype(float)
    points = rig.triangulate(pixels)
    good = np.isfinite(points[:, 2])
    if good.sum() < FEWEST_POINTS:
        return None
    seen = there.features.pixels[rows_there[rows[good]], :2].astype(float)
    T_there_here = rig.T_body_left.inverse() @ there.nav.T_map_body.inverse() @ here.nav.T_map_body @ rig.T_body_left
    points_there = T_there_here.apply(points[good])
    late = _lateness(there, points_there, seen, rig) - _lateness(here, points[good], pixels[good, :2], rig)
    J = rig.left.project_jacobian(points_there)
    deeper = T_there_here.R @ _by_focal_length(points[good], pixels[good], rig, config.focal_ratio_sigma)[..., None]
    # translation, rotation, focal length in standard deviations, readout
    A = np.concatenate([J, -J @ skew(points_there), J @ deeper, late[..., None]], axis=2)
    return _least_squares(A, seen - rig.left.project(points_there))


def _by_focal_length(points_left: Array, pixels: Array, rig: StereoRig, share: float) -> Array:
    """Return (N, 3) how points triangulated from pixels move where the right focal length is longer by a share."""
    return (rig.right_magnified(STEP * share).triangulate(pixels) - points_left) / STEP


def _lateness(at: _Seen, points_left: Array, pixels: Array, rig: StereoRig) -> Array:
    """Return (N, 2) how far points move in the left image by their rows' share of the readout [px/s]."""
    moving = velocities_left(points_left, at.nav, at.rate_map, rig)
    flow = np.einsum("nki,ni->nk", rig.left.project_jacobian(points_left), moving)
    return np.asarray(flow * below_middle(rig.left, pixels)[:, None])


def _least_squares(A: Array, residual: Array) -> tuple[float, float] | None:
    """Return the last unknown and its information, of (N, 2, 8) Jacobians and (N, 2) residuals with outliers.

    That of the focal length is N(0, 1) before.
    """
    keep = np.ones(len(A), bool)
    variance = LEAST_PX**2
    prior = np.eye(A.shape[2])[[FOCAL_LENGTH]]
    for _ in range(ROUNDS):
        rows = np.concatenate([A[keep].reshape(-1, A.shape[2]), variance**0.5 * prior])
        x = np.linalg.lstsq(rows, np.r_[residual[keep].ravel(), 0.0], rcond=None)[0]
        left = np.linalg.norm(residual - A @ x, axis=1)
        variance = LEAST_PX**2 + float(np.sum(left[keep] ** 2)) / max(1, len(rows) - len(x))
        keep = left < OUTLIER * np.median(left[keep])
    others, own = rows[:, :-1], rows[:, -1]
    alone = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
    information = float(alone @ alone) / variance
    return (float(x[-1]), information) if information > LEAST_INFORMATION else None
