# SPDX-License-Identifier: Apache-2.0
"""The stereo front end: an image pair in, matched undistorted points with descriptors out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.image_grid import spread
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import StereoFeatures, StereoFrame
from uav_vslam.vision.disparity_filter import supported_disparities
from uav_vslam.vision.features import Keypoints, make_extractor
from uav_vslam.vision.images import shrink, to_full_resolution, to_grey8
from uav_vslam.vision.matching import match_gated
from uav_vslam.vision.stereo_gate import epipolar_gate, stereo_candidates

Array = NDArray[np.float64]

DISPARITY_NOISE_PX = 0.5  # four sigma of the disparity, in pixels of the shrunk image


@dataclass(frozen=True, slots=True)
class DetectedPair:
    """What both images of a pair hold, not matched yet.

    Attributes:
        stamp_ns: exposure time [ns].
        left, right: keypoints.
        pixels_left, pixels_right: (Nl, 2), (Nr, 2) where they are, in undistorted full-resolution pixels.
    """

    stamp_ns: int
    left: Keypoints
    right: Keypoints
    pixels_left: Array
    pixels_right: Array


class StereoFrontend:
    """Extracts and matches stereo points; holds no state between pairs, so the result depends on the pair only."""

    def __init__(self, rig: StereoRig, config: FrontendConfig, rig_config: RigConfig | None = None) -> None:
        """Prepare for one rig.

        Args:
            rig: calibration.
            config: of the front end.
            rig_config: how far the calibration is trusted; a rig that does not flex unless given.

        Raises:
            ConfigError: the extractor is not known.
        """
        self._rig = rig
        self._config = config
        self._epipolar_px = epipolar_gate(rig, config.epipolar_px, rig_config or RigConfig())
        self._extractor = make_extractor(config)

    def process(self, frame: StereoFrame) -> StereoFeatures:
        """Return the matched points of a pair; none where the images hold no texture.

        Raises:
            InvalidMessage: an image has another size than the calibration, or a type that can't be used.
        """
        return self.match(self.detect(frame))

    def detect(self, frame: StereoFrame) -> DetectedPair:
        """Return the keypoints of both images; raises as `process` does."""
        left, pixels_left = self._detect(frame.left, self._rig.left, "left")
        right, pixels_right = self._detect(frame.right, self._rig.right, "right")
        return DetectedPair(frame.stamp_ns, left, right, pixels_left, pixels_right)

    def match(self, detected: DetectedPair) -> StereoFeatures:
        """Return the points found in both images."""
        pairs = self._match(detected)
        pixels = np.hstack([detected.pixels_left[pairs[:, 0]], detected.pixels_right[pairs[:, 1]]])
        keep = self._supported(pixels)
        pairs, pixels = pairs[keep], pixels[keep]
        size = (self._rig.left.width, self._rig.left.height)
        chosen = spread(pixels[:, :2], self._config.max_matches, size=size)  # they come strongest first
        descriptors = detected.left.descriptors[pairs[chosen, 0]]
        return StereoFeatures(detected.stamp_ns, pixels[chosen].astype(np.float32), descriptors)

    def _detect(self, image: NDArray[np.generic], camera: PinholeCamera, name: str) -> tuple[Keypoints, Array]:
        """Return one camera's keypoints and their (N, 2) undistorted full-resolution pixels."""
        if image.shape[:2] != (camera.height, camera.width):
            met, wanted = image.shape[1::-1], (camera.width, camera.height)
            raise InvalidMessage("image_size", f"{name} image is {met} px but its calibration is for {wanted} px")
        small = shrink(to_grey8(image), self._config.scale)
        keypoints = self._extractor.detect(small)
        raw = to_full_resolution(keypoints.pixels, small.shape, image.shape)
        return keypoints, camera.undistort(raw)

    def _match(self, detected: DetectedPair) -> NDArray[np.intp]:
        """Return (M, 2) indices of matches that stereo geometry allows, each point used once."""
        allowed = stereo_candidates(
            detected.pixels_left,
            detected.pixels_right,
            self._rig,
            epipolar_px=self._epipolar_px,
            depth_range_m=(self._config.min_depth_m, self._config.max_depth_m),
        )
        pairs = match_gated(detected.left.descriptors, detected.right.descriptors, allowed, self._config.ratio)
        return _without_twins(pairs, detected.pixels_left, detected.pixels_right)

    def _supported(self, pixels: Array) -> NDArray[np.bool_]:
        """Return which of the (N, 4) stereo pixels have a disparity that their neighbours support."""
        depth = self._rig.triangulate(pixels)[:, 2]
        disparity = self._rig.left.fx * self._rig.baseline_m / depth
        return supported_disparities(pixels[:, :2], disparity, noise_px=DISPARITY_NOISE_PX / self._config.scale)


def _without_twins(pairs: NDArray[np.intp], pixels_left: Array, pixels_right: Array) -> NDArray[np.intp]:
    """Keep one match a place: a point with two dominant orientations is two keypoints at the same pixel."""
    for column, pixels in enumerate((pixels_left, pixels_right)):
        _, first = np.unique(pixels[pairs[:, column]], axis=0, return_index=True)
        pairs = pairs[np.sort(first)]
    return pairs
