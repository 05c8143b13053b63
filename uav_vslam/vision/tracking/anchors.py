# SPDX-License-Identifier: Apache-2.0
"""Ties tracked points to how they looked first, so that they slide far less over the ground.

From image to image, the small errors of optical flow add up: each one moves the patch that the next image is searched
for, the template update problem of [matthews04]. Against the first image, the anchor, errors don't add up, but by then
the patch looks different: so it is aligned affinely. Where that fails, the point's present look is its new anchor.
The right image is tied to the same anchors, so that errors of the anchor cancel in the disparity.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.tracking.affine import Patches, fits, undeformed
from uav_vslam.vision.tracking.flow import FlowImage
from uav_vslam.vision.tracking.tracks import Tracks

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Rows = NDArray[np.intp]

MOST_PX = 1.5  # of a correction: more is not the same point


class Anchors:
    """The anchors of a stream of left images: a patch of each track, and how it is deformed now."""

    def __init__(self) -> None:
        self._ids = np.zeros(0, np.uint32)
        self._patches = Patches.none()
        self._shapes = undeformed(0)

    def start(self, tracks: Tracks, left: FlowImage) -> None:
        """Give an anchor to each track that has none, in the left image that its pixel is of."""
        new = np.flatnonzero(~np.isin(tracks.ids, self._ids) & fits(left.grey, tracks.pixels))
        if len(new) == 0:
            return
        patches = Patches.cut(left.grey.astype(np.float32), tracks.pixels[new])
        self._patches = self._patches.joined(patches)
        self._ids = np.concatenate([self._ids, tracks.ids[new]])
        self._shapes = np.concatenate([self._shapes, undeformed(len(new))])

    def refined(self, tracks: Tracks, left: FlowImage) -> Tracks:
        """Return the tracks of the next left image, tied to their anchors; where that fails, the track has none."""
        pixels, own, shapes = self._aligned(tracks.ids, tracks.pixels, left)
        self._ids, self._patches, self._shapes = self._ids[own], self._patches.chosen(own), shapes
        return dataclasses.replace(tracks, pixels=pixels)

    def across(self, tracks: Tracks, pixels: Array, right: FlowImage) -> Array:
        """Return the tracks' (N, 2) pixels in the right image, tied to the anchors, too, where that succeeds."""
        return self._aligned(tracks.ids, pixels, right)[0]

    def _aligned(self, ids: NDArray[np.uint32], pixels: Array, image: FlowImage) -> tuple[Array, Rows, Floats]:
        """Align the (N, 2) pixels of tracks with their anchors.

        Returns:
            (N, 2) pixels, as they were where it fails.
            (K,) anchors with which it succeeds.
            (K, 2, 2) how those are deformed in the image.
        """
        _, rows, own = np.intersect1d(ids, self._ids, return_indices=True)
        patches = self._patches.chosen(own)
        found, shapes, good = patches.found(image.grey.astype(np.float32), pixels[rows], self._shapes[own])
        good &= np.linalg.norm(found - pixels[rows], axis=1) <= MOST_PX
        aligned = pixels.copy()
        aligned[rows[good]] = found[good]
        return aligned, own[good], shapes[good]
