# SPDX-License-Identifier: Apache-2.0
"""Fault detection for the cameras and their rig, for the diagnostics; faulty images are not used."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NS_PER_S
from uav_vslam.vision.image_watch import ImageWatch, RunningBaseline

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

MIN_POINTS = 20  # fewer are not enough to check the rig
EPIPOLAR_FRAMES = 20  # in the median: a rig changes slowly, a bad frame is short
EPIPOLAR_SHARE = 0.5  # of the gate: with the median there, many points are close to rejection
GAP_SHARE = 0.67  # of the usual rate: a gap of one and a half periods
COUNTED_PAIRS = 20  # window for counting missing pairs
SWAPPED_SHARE = 0.5  # of the points fit with swapped images, and less than half of that as received


class FrontendHealth:
    """Monitors both cameras and the geometry of their matches.

    Attributes:
        alarms: current faults, by subject; normally empty.
        epipolar_px: largest distance from the epipolar line at which points are matched [px]; may be set at any time.
        depth_range_m: smallest and largest depth at which they are [m]; likewise.
    """

    def __init__(
        self, rig: StereoRig, epipolar_px: float, depth_range_m: tuple[float, float] = (0.0, math.inf)
    ) -> None:
        """Start without data.

        Args:
            rig: calibration.
            epipolar_px, depth_range_m: see the attributes.
        """
        self._rig, self.epipolar_px, self.depth_range_m = rig, epipolar_px, depth_range_m
        self._cameras = {"left": ImageWatch(), "right": ImageWatch()}
        self._rate, self._stamp_ns = RunningBaseline(GAP_SHARE), 0
        self._missing: deque[int] = deque(maxlen=COUNTED_PAIRS)
        self._distances: deque[float] = deque(maxlen=EPIPOLAR_FRAMES)
        self._depths: deque[float] = deque(maxlen=EPIPOLAR_FRAMES)
        self.alarms: dict[str, str] = {}

    def check_images(self, stamp_ns: int, left: Grey, right: Grey) -> bool:
        """Check a pair of (H, W) images and return whether they are usable."""
        self._count_missing(stamp_ns)
        for (name, camera), image in zip(self._cameras.items(), (left, right), strict=True):
            found = camera.add(image)
            text = f"the {name} camera {' and '.join(found)}" if found else ""
            # Two subjects, for each is logged at its onset only: an image that is not used, and one that is poor.
            self._set(f"{name} camera", text if camera.blind else "")
            self._set(f"{name} image", "" if camera.blind else text)
        self._set("image order", "")
        return not any(camera.blind for camera in self._cameras.values())

    def _count_missing(self, stamp_ns: int) -> None:
        """Report pairs missing since the last one, relative to the usual rate."""
        before, self._stamp_ns = self._stamp_ns, stamp_ns
        if not 0 < before < stamp_ns:
            return
        share = self._rate.shortfall(NS_PER_S / (stamp_ns - before))
        self._missing.append(0 if share is None else round(1.0 / share) - 1)
        missing = sum(self._missing)
        self._set(
            "pairs", f"{missing} of the last {missing + len(self._missing)} image pairs are missing" if missing else ""
        )

    def check_points(self, pixels: Array, depth_m: Array) -> None:
        """Check (N, 4) undistorted stereo points matched by descriptor or flow, before any gate, and their (N,) depths.

        A depth is NaN where the rays don't meet.
        """
        finite = np.isfinite(pixels).all(axis=1)
        pixels, depth_m = pixels[finite], depth_m[finite]
        if len(pixels) < MIN_POINTS:
            return
        if seems_swapped(pixels, self._rig, self.epipolar_px):
            self._set("image order", "left and right images seem to be swapped, or both upside down")
            return
        self._distances.append(float(np.median(self._rig.epipolar_distance(pixels))))
        usual = float(np.median(self._distances))
        wrong = len(self._distances) == EPIPOLAR_FRAMES and usual > EPIPOLAR_SHARE * self.epipolar_px
        text = (
            f"points are {usual:.1f} px off their epipolar lines: the rig calibration is off, the frames of the "
            "cameras are not optical (z ahead, x right), or "
            f"frontend.epipolar_px, {self.epipolar_px:g} px, is too small"
        )
        self._set("rig", text if wrong else "")
        self._check_depths(depth_m[np.isfinite(depth_m)])

    def _check_depths(self, ahead: Array) -> None:
        """Report (N,) depths [m] of which most are out of range, so that hardly a point is used."""
        if len(ahead) < MIN_POINTS:
            return
        self._depths.append(float(np.median(ahead)))
        usual, (nearest, farthest) = float(np.median(self._depths)), self.depth_range_m
        wrong = len(self._depths) == EPIPOLAR_FRAMES and not nearest <= usual <= farthest
        text = (
            f"points are {usual:.3g} m away, at a baseline of {self._rig.baseline_m:.3g} m: check the places of the "
            f"cameras and their unit (m), or set frontend.min_depth_m ({nearest:g}) and max_depth_m ({farthest:g})"
        )
        self._set("depth", text if wrong else "")

    def _set(self, subject: str, text: str) -> None:
        if text:
            self.alarms[subject] = text
        else:
            self.alarms.pop(subject, None)


def seems_swapped(pixels: Array, rig: StereoRig, epipolar_px: float) -> bool:
    """Return whether (N, 4) undistorted stereo points fit the rig only with left and right exchanged."""
    if fitting_share(pixels, rig, epipolar_px) >= 0.5 * SWAPPED_SHARE:
        return False
    return fitting_share(pixels[:, [2, 3, 0, 1]], rig, epipolar_px) > SWAPPED_SHARE


def fitting_share(pixels: Array, rig: StereoRig, epipolar_px: float) -> float:
    """Return the share of (N, 4) undistorted stereo points on their epipolar lines and in front of both cameras."""
    ahead = np.isfinite(rig.triangulate(pixels, refinements=0)[:, 2])
    return float(np.mean(ahead & (rig.epipolar_distance(pixels) <= epipolar_px)))
