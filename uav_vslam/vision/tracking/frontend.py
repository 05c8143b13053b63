# SPDX-License-Identifier: Apache-2.0
"""The live front end: feature tracks from left image to left image, each matched into the right image.

    last left image with new keypoints --homography--> left image --last depth--> right image --gates--> features
                                                           |
              every few frames, or every frame where many tracks end: keypoint detection, in a second thread

In both images, a point is tied to how it looked first (`anchors`), from where it is predicted; optical flow finds those
for which that fails, as near structure, or all if `frontend.anchored` is off.

A feature has the descriptor from the start of its track, for loop closing and association with peers' landmarks, and
the track id, by which the back end associates it without descriptors.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NS_PER_S, StereoFeatures, StereoFrame
from uav_vslam.vision.features import Keypoints
from uav_vslam.vision.frontend_base import Frontend
from uav_vslam.vision.images import to_grey8
from uav_vslam.vision.tracking.anchors import Anchors
from uav_vslam.vision.tracking.flow import Flow, FlowImage, shift_between
from uav_vslam.vision.tracking.prediction import FlowModel, by_homography, in_right_image
from uav_vslam.vision.tracking.refill import Refill
from uav_vslam.vision.tracking.tracks import Tracks

Array = NDArray[np.float64]

SEARCH_EVERY = 3  # frames from one detection of new keypoints to the next
LEFT_SHARE = 0.75  # of the tracks after a frame; with fewer, hardly a quarter were left by the next detection
FEW_TRACKS = 20  # with fewer, new ones are detected in the same image
MAX_GAP_S = 1.0  # after a longer gap, all tracks are dropped
DISPARITY_NOISE_PX = 0.3  # six sigma
TYPICAL_DEPTH_SHARE = 0.5  # of the largest depth: initial guess while no depth is known


def first_track_id(stamp_ns: int) -> int:
    """Return the first track id of a front end whose first image has this stamp.

    One that is restarted in flight must not repeat the ids that the back end knows: they grow by one a millisecond,
    faster than tracks are made.
    """
    return stamp_ns // 1_000_000 % 2**31 + 1


@dataclass(frozen=True, slots=True)
class _Matched:
    """N tracks found in the right image, with their depths; (N, 4) undistorted pixels, and which pass the stereo gate.

    Its length is the number of these.
    """

    tracks: Tracks
    pixels: Array
    good: NDArray[np.bool_]

    def __len__(self) -> int:
        return int(self.good.sum())


class TrackingFrontend(Frontend):
    """KLT front end; its output depends only on the images so far, not on timing."""

    def __init__(self, rig: StereoRig, config: FrontendConfig, rig_config: RigConfig | None = None) -> None:
        """As `Frontend`; raises `ConfigError` if the extractor is not installed."""
        super().__init__(rig, config, rig_config, DISPARITY_NOISE_PX)
        self._refill = Refill(config)
        self._flow = FlowModel()
        self._anchors = Anchors() if config.anchored else None
        self._tracks = Tracks.none()
        self._left: FlowImage | None = None  # of the previous pair
        self._stamp_ns = 0
        self._since_search = 0  # frames
        self._next_id = 0  # until the first image

    def process(self, frame: StereoFrame) -> StereoFeatures:
        self._check_sizes(frame)
        grey_left, grey_right = to_grey8(frame.left), to_grey8(frame.right)
        left, right = FlowImage(grey_left), FlowImage(grey_right)
        usable = self._health.check_images(frame.stamp_ns, grey_left, grey_right)
        self._next_id = self._next_id or first_track_id(frame.stamp_ns)
        before, first_new = len(self._tracks), self._next_id
        self._track(frame.stamp_ns, left)
        self._left, self._stamp_ns = left, frame.stamp_ns
        if not usable:
            return StereoFeatures.empty(frame.stamp_ns)
        if len(self._tracks) < FEW_TRACKS:
            self._start_search(frame.left)
            self._join(self._refill.result())
        features = self._features(frame.stamp_ns, left, right)
        left_over = int((self._tracks.ids < first_new).sum())
        self._search(frame.left, at_once=left_over < LEFT_SHARE * before)
        return features

    def _track(self, stamp_ns: int, left: FlowImage) -> None:
        """Track into the left image, including the new keypoints of the previous one."""
        found = self._refill.result()
        dt_s = (stamp_ns - self._stamp_ns) / NS_PER_S
        if self._left is None or not 0.0 < dt_s <= MAX_GAP_S:
            self._tracks = Tracks.none()
            return
        self._join(found)
        before = self._tracks
        if self._anchors is not None:
            self._anchors.start(before, self._left)
        flow = Flow(self._left, left, before.pixels, self._left_guess(self._left, left, dt_s))
        pixels, good = flow.tracked() if self._anchors is None else self._anchors.into_left(before.ids, flow)
        self._flow.fit(before.pixels[good], pixels[good], dt_s)
        self._tracks = dataclasses.replace(before, pixels=pixels).chosen(good)

    def _left_guess(self, before: FlowImage, left: FlowImage, dt_s: float) -> Array:
        """Return (N, 2) predicted pixels of the tracks.

        The last flow predicts them, or the image's global shift if the flow has changed or is unknown yet.
        """
        pixels = self._tracks.pixels
        predictions = (
            lambda: self._flow.predict(pixels, dt_s),
            lambda: pixels + shift_between(before, left),
        )
        for predict in predictions:
            better = by_homography(before, left, pixels, predict())
            if better is not None:
                return better
        # Near structure, or little texture: the points decide.
        tracked = (Flow(before, left, pixels, predict()).tracked() for predict in predictions)
        return max(tracked, key=lambda found: int(found[1].sum()))[0]

    def _join(self, found: Keypoints | None) -> None:
        """Start tracks at new keypoints."""
        if found is None:
            return
        self._tracks = self._tracks.with_new(found.pixels.astype(float), found.descriptors, self._next_id)
        self._next_id += len(found)

    def _features(self, stamp_ns: int, left: FlowImage, right: FlowImage) -> StereoFeatures:
        """Match the tracks into the right image; drop those that fail the stereo gate.

        Depths predict them. Where hardly one is there, as near the ground after the start, the images' shift does.
        """
        found = self._matched(left, right, self._right_guess(self._tracks))
        if len(found) < FEW_TRACKS <= len(self._tracks):
            shifted = self._matched(left, right, self._tracks.pixels + shift_between(left, right))
            # Without a match, what was seen at an impossible depth tells why.
            found = max(found, shifted, key=lambda one: (len(one), 0 if len(one) else len(one.pixels)))
        self._health.check_points(found.pixels, found.tracks.depth_m)
        pixels, self._tracks = found.pixels[found.good], found.tracks.chosen(found.good)
        return StereoFeatures(stamp_ns, pixels.astype(np.float32), self._tracks.descriptors, self._tracks.ids)

    def _matched(self, left: FlowImage, right: FlowImage, guess: Array) -> _Matched:
        """Look for the tracks in the right image, from (N, 2) predicted pixels on."""
        flow = Flow(left, right, self._tracks.pixels, guess)
        found, seen = flow.tracked() if self._anchors is None else self._anchors.into_right(self._tracks.ids, flow)
        tracks, raw_right = self._tracks.chosen(seen), found[seen]
        pixels = np.hstack([self._rig.left.undistort(tracks.pixels), self._rig.right.undistort(raw_right)])
        depth, good = self._gate.check(pixels)
        return _Matched(dataclasses.replace(tracks, depth_m=depth), pixels, good)

    def _right_guess(self, tracks: Tracks) -> Array:
        """Return (N, 2) predicted raw right pixels of the tracks, from their last depth or the median one."""
        known = np.isfinite(tracks.depth_m)
        typical = np.median(tracks.depth_m[known]) if known.any() else TYPICAL_DEPTH_SHARE * self._config.max_depth_m
        return in_right_image(self._rig, tracks.pixels, np.where(known, tracks.depth_m, typical))

    def _search(self, image: NDArray[np.generic], *, at_once: bool) -> None:
        """Every few frames, or at once, start detection of new keypoints; they join at the next pair."""
        self._since_search += 1
        if at_once or self._since_search >= SEARCH_EVERY:
            self._start_search(image)
            self._since_search = 0

    def _start_search(self, image: NDArray[np.generic]) -> None:
        room = self._config.max_tracks - len(self._tracks)
        if room > 0:
            self._refill.start(image, self._tracks.pixels, room)
