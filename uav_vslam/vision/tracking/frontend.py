# SPDX-License-Identifier: Apache-2.0
"""The live front end: points are followed from left image to left image and found again in the right ones.

    last left image, joined by new points --flow--> left image --depth so far--> right image --gates--> features
                                                        |
                                  every few frames: a search for new points, in a second thread

What it hands on carries the descriptor of the place where the track began, so that loops can be closed and peers can
recognise it, and the track's number, by which the back end knows it again without looking.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NS_PER_S, StereoFeatures, StereoFrame
from uav_vslam.vision.features import Keypoints
from uav_vslam.vision.frontend_base import Frontend
from uav_vslam.vision.images import to_grey8
from uav_vslam.vision.tracking.flow import follow, shift_between, without_local_mean
from uav_vslam.vision.tracking.prediction import FlowModel, in_right_image
from uav_vslam.vision.tracking.refill import Refill, choose_new
from uav_vslam.vision.tracking.tracks import Tracks

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

MAX_GAP_S = 1.0  # after a longer time without an image, nothing is looked for where it was
DISPARITY_NOISE_PX = 0.3  # six sigma
FEW_SHARE = 0.5  # of the tracks; if fewer are found where the flow so far led, the image as a whole is looked for
TYPICAL_DEPTH_SHARE = 0.5  # of the largest depth: what is tried while no depth is known


class TrackingFrontend(Frontend):
    """Follows points; what it makes of a pair depends on the pairs before, and on nothing else."""

    def __init__(self, rig: StereoRig, config: FrontendConfig, rig_config: RigConfig | None = None) -> None:
        """Prepare as any front end; raises `ConfigError` where the extractor is not installed."""
        super().__init__(rig, config, rig_config, DISPARITY_NOISE_PX)
        self._refill = Refill(config)
        self._flow = FlowModel()
        self._tracks = Tracks.none()
        self._left: Grey | None = None  # of the previous pair, without local mean
        self._stamp_ns = 0
        self._since_search = 0  # frames
        self._next_id = 1

    def process(self, frame: StereoFrame) -> StereoFeatures:
        self._check_sizes(frame)
        grey_left, grey_right = to_grey8(frame.left), to_grey8(frame.right)
        left, right = without_local_mean(grey_left), without_local_mean(grey_right)
        believed = self._health.look(frame.stamp_ns, grey_left, grey_right)
        self._follow(frame.stamp_ns, left)
        self._left, self._stamp_ns = left, frame.stamp_ns
        if not believed:
            return StereoFeatures.empty(frame.stamp_ns)
        if len(self._tracks) == 0:
            self._refill.begin(frame.left)
            self._join(self._refill.result(), left.shape)
        features = self._features(frame.stamp_ns, left, right)
        self._search(frame.left)
        return features

    def _follow(self, stamp_ns: int, left: Grey) -> None:
        """Move the tracks on to the left image, after what the search found in the previous one has joined them."""
        found = self._refill.result()
        dt_s = (stamp_ns - self._stamp_ns) / NS_PER_S
        if self._left is None or not 0.0 < dt_s <= MAX_GAP_S:
            self._tracks = Tracks.none()
            return
        self._join(found, left.shape)
        before = self._tracks
        pixels, good = follow(self._left, left, before.pixels, self._flow.predict(before.pixels, dt_s))
        if good.sum() < FEW_SHARE * len(good):  # the flow has changed, or is not known yet, or many left the image
            shift = shift_between(self._left, left)
            pixels_shifted, good_shifted = follow(self._left, left, before.pixels, before.pixels + shift)
            if good_shifted.sum() > good.sum():
                pixels, good = pixels_shifted, good_shifted
        self._flow.learn(before.pixels[good], pixels[good], dt_s)
        self._tracks = dataclasses.replace(before, pixels=pixels).chosen(good)

    def _join(self, found: Keypoints | None, shape: tuple[int, ...]) -> None:
        """Begin to follow points where there is room."""
        if found is None:
            return
        room = self._config.max_tracks - len(self._tracks)
        rows = choose_new(found, self._tracks.pixels, room, shape)
        self._tracks = self._tracks.and_new(found.pixels[rows].astype(float), found.descriptors[rows], self._next_id)
        self._next_id += len(rows)

    def _features(self, stamp_ns: int, left: Grey, right: Grey) -> StereoFeatures:
        """Find the tracks in the right image; those that stereo geometry does not allow there are given up."""
        raw_right, seen = follow(left, right, self._tracks.pixels, self._right_guess(self._tracks))
        tracks = self._tracks.chosen(seen)
        pixels = np.hstack([self._rig.left.undistort(tracks.pixels), self._rig.right.undistort(raw_right[seen])])
        self._health.judge(pixels)
        depth, good = self._gate.judge(pixels)
        self._tracks = dataclasses.replace(tracks.chosen(good), depth_m=depth[good])
        return StereoFeatures(stamp_ns, pixels[good].astype(np.float32), self._tracks.descriptors, self._tracks.ids)

    def _right_guess(self, tracks: Tracks) -> Array:
        """Return (N, 2) raw right pixels where the tracks should be: at their own last depth or that of the others."""
        known = np.isfinite(tracks.depth_m)
        typical = np.median(tracks.depth_m[known]) if known.any() else TYPICAL_DEPTH_SHARE * self._config.max_depth_m
        return in_right_image(self._rig, tracks.pixels, np.where(known, tracks.depth_m, typical))

    def _search(self, image: NDArray[np.generic]) -> None:
        """Every few frames begin to look for new points; they join when the next pair comes."""
        self._since_search += 1
        if self._since_search >= self._config.search_every:
            self._refill.begin(image)
            self._since_search = 0
