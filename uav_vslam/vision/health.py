# SPDX-License-Identifier: Apache-2.0
"""What is wrong with the cameras and their rig, for the diagnostics; images that can't be believed are not used."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NS_PER_S
from uav_vslam.vision.image_watch import ImageWatch, RunningBaseline

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

MIN_POINTS = 20  # fewer say nothing of the rig
EPIPOLAR_FRAMES = 20  # whose median distance counts: a rig changes slowly, a bad frame is soon over
EPIPOLAR_SHARE = 0.5  # of the gate: half the points that far off would soon be most of them lost
GAP_SHARE = 0.67  # of the usual rate: from the pair before to one that comes after half a period too many
COUNTED_PAIRS = 20  # among which the missing ones are counted
SWAPPED_SHARE = 0.5  # of the points fit when the images change places, and fewer than half of that as they are


class FrontendHealth:
    """Watches both cameras and how their points lie to one another.

    Attributes:
        alarms: what is wrong at present, by subject; empty as a rule.
    """

    def __init__(self, rig: StereoRig, epipolar_px: float) -> None:
        """Begin.

        Args:
            rig: calibration.
            epipolar_px: largest distance from the epipolar line at which points are matched [px].
        """
        self._rig, self._epipolar_px = rig, epipolar_px
        self._cameras = {"left": ImageWatch(), "right": ImageWatch()}
        self._rate, self._stamp_ns = RunningBaseline(GAP_SHARE), 0
        self._missing: deque[int] = deque(maxlen=COUNTED_PAIRS)
        self._distances: deque[float] = deque(maxlen=EPIPOLAR_FRAMES)
        self.alarms: dict[str, str] = {}

    def look(self, stamp_ns: int, left: Grey, right: Grey) -> bool:
        """Take note of a pair of (H, W) images and tell whether they may be used."""
        self._count_missing(stamp_ns)
        for (name, camera), image in zip(self._cameras.items(), (left, right), strict=True):
            found = camera.add(image)
            self._set(f"{name} camera", f"the {name} camera {' and '.join(found)}" if found else "")
        self._set("image order", "")
        return not any(camera.blind for camera in self._cameras.values())

    def _count_missing(self, stamp_ns: int) -> None:
        """Tell of pairs that should have come since the last one, as far as pairs come at a usual rate."""
        before, self._stamp_ns = self._stamp_ns, stamp_ns
        if not 0 < before < stamp_ns:
            return
        share = self._rate.shortfall(NS_PER_S / (stamp_ns - before))
        self._missing.append(0 if share is None else round(1.0 / share) - 1)
        missing = sum(self._missing)
        self._set(
            "pairs", f"{missing} of the last {missing + len(self._missing)} image pairs are missing" if missing else ""
        )

    def judge(self, pixels: Array) -> None:
        """Take note of (N, 4) undistorted stereo points that were matched by their looks, before any gate."""
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        if len(pixels) < MIN_POINTS:
            return
        if self._fit(pixels) < 0.5 * SWAPPED_SHARE and self._fit(pixels[:, [2, 3, 0, 1]]) > SWAPPED_SHARE:
            self._set("image order", "left and right images look as if they had changed places")
            return
        self._distances.append(float(np.median(self._rig.epipolar_distance(pixels))))
        usual = float(np.median(self._distances))
        wrong = len(self._distances) == EPIPOLAR_FRAMES and usual > EPIPOLAR_SHARE * self._epipolar_px
        self._set(
            "rig",
            f"points lie {usual:.1f} px off their epipolar lines: the rig is not as it was calibrated" if wrong else "",
        )

    def _fit(self, pixels: Array) -> float:
        """Return the share of stereo points that lie on their epipolar lines and before both cameras."""
        ahead = np.isfinite(self._rig.triangulate(pixels, refinements=0)[:, 2])
        return float(np.mean(ahead & (self._rig.epipolar_distance(pixels) <= self._epipolar_px)))

    def _set(self, subject: str, text: str) -> None:
        if text:
            self.alarms[subject] = text
        else:
            self.alarms.pop(subject, None)
