# SPDX-License-Identifier: Apache-2.0
"""Ties tracked points to how they looked first, so that they slide far less over the ground.

From image to image, the small errors of optical flow add up: each one moves the patch that the next image is searched
for, the template update problem of [matthews04]. Against the first image, the anchor, errors don't add up, but by then
the patch looks different: so it is aligned affinely. Where that fails, the point's present look is its new anchor.
The right image is tied to the same anchors, so that errors of the anchor cancel in the disparity.

Most points are aligned straight from their predictions, for a part of the time that flow and its check take.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.tracking.affine import Patches, fits, undeformed
from uav_vslam.vision.tracking.flow import Flow, FlowImage
from uav_vslam.vision.tracking.tracks import Tracks

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]
Ids = NDArray[np.uint32]

MOST_PX = 0.7  # of a correction: more is not the same point; with 1.5, points at edges of near things are worse

# Largest last step of an alignment that has settled: from a guess that all points share, and from where flow has found
# that point alone. On faint images, alignment comes nearer by a part of the distance only; left off by errors of the
# guess that are the same for all, points tell of a wrong motion.
SETTLED_PX, SETTLED_FROM_FLOW_PX = 0.02, 0.1


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
        patches = Patches.cut(left.smooth, tracks.pixels[new])
        self._patches = self._patches.joined(patches)
        self._ids = np.concatenate([self._ids, tracks.ids[new]])
        self._shapes = np.concatenate([self._shapes, undeformed(len(new))])

    def into_left(self, ids: Ids, flow: Flow) -> tuple[Array, Mask]:
        """Find tracks in the next left image; those that can't be tied lose their anchors.

        Args:
            ids: (N,) of the tracks, ascending.
            flow: of the tracks into the image.

        Returns:
            (N, 2) pixels and the (N,) mask of those found.
        """
        pixels, seen, own, shapes = self._found(ids, flow)
        self._ids, self._patches, self._shapes = self._ids[own], self._patches.chosen(own), shapes
        return pixels, seen

    def into_right(self, ids: Ids, flow: Flow) -> tuple[Array, Mask]:
        """Find tracks in the right image of the last left one; arguments and result as `into_left`."""
        return self._found(ids, flow)[:2]

    def _found(self, ids: Ids, flow: Flow) -> tuple[Array, Mask, Rows, Floats]:
        """Find tracks: tied where they are guessed, or where coarse flow takes them; failing that, by fine flow.

        Returns:
            (N, 2) pixels and the (N,) mask of those found.
            (K,) rows of the anchors that succeeded, and (K, 2, 2) how those are deformed in the image.
        """
        own = np.flatnonzero(np.isin(self._ids, ids))
        rows = np.searchsorted(ids, self._ids[own])
        shapes = self._shapes[own] if flow.turn is None else flow.turn.astype(np.float32) @ self._shapes[own]
        pixels, seen, tied = flow.guess.copy(), np.ones(len(ids), bool), np.zeros(len(own), bool)

        def tie(settled_px: float) -> Rows:
            """Align what is not tied yet, from where it may be seen; return the rows that still are not."""
            some = np.flatnonzero(~tied & seen[rows])
            patches = self._patches if len(some) == len(self._patches) else self._patches.chosen(own[some])
            start = pixels[rows[some]]
            found, deformed, good = patches.found(flow.second.smooth, start, shapes[some], settled_px=settled_px)
            good &= np.linalg.norm(found - start, axis=1) <= MOST_PX
            some = some[good]
            pixels[rows[some]], shapes[some], tied[some] = found[good], deformed[good], True
            rest = seen.copy()
            rest[rows[tied]] = False
            return np.flatnonzero(rest)

        rest = tie(SETTLED_PX)
        pixels[rest] = flow.coarse(rest)
        seen[rest] = fits(flow.second.grey, pixels[rest])
        rest = tie(SETTLED_PX)
        pixels[rest], seen[rest] = flow.fine(rest, pixels[rest])
        tie(SETTLED_FROM_FLOW_PX)
        return pixels, seen, own[tied], shapes[tied]
