# SPDX-License-Identifier: Apache-2.0
"""Ties tracked points to how they looked earlier, so that they slide less over the ground.

From image to image, the small errors of optical flow add up: each one moves the patch that the next image is searched
for, the template update problem of [matthews04]. Against one earlier image, the anchor, errors don't add up.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.tracking.flow import FlowImage, track_turning
from uav_vslam.vision.tracking.tracks import Tracks

EVERY = 4  # frames from one anchor image to the next
KEPT = 16  # frames that one serves; later, the ground looks different
MOST_PX = 1.0  # of a correction: more is not the same point


@dataclass(frozen=True, slots=True)
class _Anchor:
    """An image, and (N,) tracks with their (N, 2) pixels in it."""

    frame: int
    image: FlowImage
    ids: NDArray[np.uint32]
    pixels: NDArray[np.float64]


class Anchors:
    """The anchors of a stream of left images; each track has one at most."""

    def __init__(self) -> None:
        self._anchors: list[_Anchor] = []
        self._frame = 0

    def refined(self, tracks: Tracks, left: FlowImage) -> Tracks:
        """Return the tracks of the next left image, those that have an anchor as tracked from it."""
        self._frame += 1
        pixels, tied, kept = tracks.pixels.copy(), np.zeros(len(tracks), bool), []
        for anchor in self._anchors:
            _, rows, own = np.intersect1d(tracks.ids, anchor.ids, return_indices=True)
            if self._frame - anchor.frame >= KEPT or len(rows) == 0:
                continue
            there, good = track_turning(anchor.image, left, anchor.pixels[own], pixels[rows])
            good &= np.linalg.norm(there - pixels[rows], axis=1) <= MOST_PX
            pixels[rows[good]], tied[rows[good]] = there[good], True
            kept.append(dataclasses.replace(anchor, ids=anchor.ids[own[good]], pixels=anchor.pixels[own[good]]))
        if self._frame % EVERY == 0:
            kept.append(_Anchor(self._frame, left, tracks.ids[~tied], pixels[~tied]))
        self._anchors = kept
        return dataclasses.replace(tracks, pixels=pixels)
