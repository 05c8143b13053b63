# SPDX-License-Identifier: Apache-2.0
"""The stereo front end: an image pair in, matched undistorted keypoints with descriptors out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.image_grid import spread
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import StereoFeatures, StereoFrame
from uav_vslam.vision.features import Keypoints, make_extractor
from uav_vslam.vision.frontend_base import Frontend
from uav_vslam.vision.images import shrink, to_full_resolution, to_grey8
from uav_vslam.vision.matching import MATCHERS, match_descriptors, match_gated
from uav_vslam.vision.stereo_gate import stereo_candidates

Array = NDArray[np.float64]

RIG_CHECK_POINTS = 300  # strongest keypoints of each image, matched without a gate to check the rig
GATED = "gated"  # the matcher that is no entry of MATCHERS: it needs the rig
DISPARITY_NOISE_PX = 0.5  # four sigma of the disparity, in pixels of the downscaled image


@dataclass(frozen=True, slots=True)
class DetectedPair:
    """Keypoints of both images of a pair, before matching.

    Attributes:
        stamp_ns: exposure time [ns].
        left, right: keypoints.
        pixels_left, pixels_right: (Nl, 2), (Nr, 2) undistorted full-resolution pixels.
    """

    stamp_ns: int
    left: Keypoints
    right: Keypoints
    pixels_left: Array
    pixels_right: Array


class StereoFrontend(Frontend):
    """Extracts and matches keypoints of each pair independently; only fault detection uses earlier pairs."""

    def __init__(self, rig: StereoRig, config: FrontendConfig, rig_config: RigConfig | None = None) -> None:
        """As `Frontend`; raises `ConfigError` if the extractor is not installed."""
        super().__init__(rig, config, rig_config, DISPARITY_NOISE_PX / config.scale)
        self._extractor = make_extractor(config)

    def process(self, frame: StereoFrame) -> StereoFeatures:
        self._check_sizes(frame)
        if not self._health.check_images(frame.stamp_ns, to_grey8(frame.left), to_grey8(frame.right)):
            return StereoFeatures.empty(frame.stamp_ns)
        detected = self.detect(frame)
        pixels = self._matched_by_descriptor(detected)
        self._health.check_points(pixels, self._rig.triangulate(pixels, refinements=0)[:, 2])
        return self.match(detected)

    def detect(self, frame: StereoFrame) -> DetectedPair:
        """Return the keypoints of both images; raises as `process` does."""
        self._check_sizes(frame)
        left, pixels_left = self._detect(frame.left, self._rig.left)
        right, pixels_right = self._detect(frame.right, self._rig.right)
        return DetectedPair(frame.stamp_ns, left, right, pixels_left, pixels_right)

    def match(self, detected: DetectedPair) -> StereoFeatures:
        """Match the keypoints and apply the stereo gate."""
        pairs = self._match(detected)
        pixels = np.hstack([detected.pixels_left[pairs[:, 0]], detected.pixels_right[pairs[:, 1]]])
        _, keep = self._gate.check(pixels)
        pairs, pixels = pairs[keep], pixels[keep]
        size = self._rig.left.size
        chosen = spread(pixels[:, :2], self._config.max_matches, size=size)  # strongest first
        descriptors = detected.left.descriptors[pairs[chosen, 0]]
        return StereoFeatures(detected.stamp_ns, pixels[chosen].astype(np.float32), descriptors)

    def _detect(self, image: NDArray[np.generic], camera: PinholeCamera) -> tuple[Keypoints, Array]:
        """Return one camera's keypoints and their (N, 2) undistorted full-resolution pixels."""
        small = shrink(image, self._config.scale)  # an extractor may use colours
        keypoints = self._extractor.detect(small)
        raw = to_full_resolution(keypoints.pixels, small.shape, image.shape)
        return keypoints, camera.undistort(raw)

    def _match(self, detected: DetectedPair) -> NDArray[np.intp]:
        """Return (M, 2) indices of matches by the configured matcher, each point used at most once."""
        matcher, ratio = self._config.matcher, self._config.ratio
        if matcher == GATED:
            pairs = match_gated(detected.left.descriptors, detected.right.descriptors, self._allowed(detected), ratio)
        else:
            pairs = MATCHERS[matcher](detected.left, detected.right, ratio)
        return _without_duplicates(pairs, detected.pixels_left, detected.pixels_right)

    def _allowed(self, detected: DetectedPair) -> NDArray[np.bool_]:
        """Return the (Nl, Nr) pairs that stereo geometry allows."""
        return stereo_candidates(
            detected.pixels_left,
            detected.pixels_right,
            self._rig,
            epipolar_px=self._gate.epipolar_px,
            depth_range_m=(self._config.min_depth_m, self._config.max_depth_m),
        )

    def _matched_by_descriptor(self, detected: DetectedPair) -> Array:
        """Return (M, 4) pixels of the strongest keypoints, matched by descriptors alone, to check the rig."""
        left, right = (keypoints.descriptors[:RIG_CHECK_POINTS] for keypoints in (detected.left, detected.right))
        pairs = match_descriptors(left, right, self._config.ratio)
        return np.hstack([detected.pixels_left[pairs[:, 0]], detected.pixels_right[pairs[:, 1]]])


def _without_duplicates(pairs: NDArray[np.intp], pixels_left: Array, pixels_right: Array) -> NDArray[np.intp]:
    """Keep one match per pixel: a point with two dominant orientations is two keypoints."""
    for column, pixels in enumerate((pixels_left, pixels_right)):
        _, first = np.unique(pixels[pairs[:, column]], axis=0, return_index=True)
        pairs = pairs[np.sort(first)]
    return pairs
