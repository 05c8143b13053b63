# SPDX-License-Identifier: Apache-2.0
"""From a few pictures to all: each is placed by points that those before it show, as in [snavely06].

Laying all pictures out flat would do where all look straight down. Along a turn with a bank of 25 deg, the turns of
similarities add up to a tenth less than the vehicle's, and strips before and after it contradict each other.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.pictures.bundle import Bundle, Priors, Scene
from uav_vslam.mapping.pictures.layout import largest_part
from uav_vslam.mapping.pictures.pairs import MatchedPair
from uav_vslam.mapping.pictures.resection import FEWEST_POINTS, explained, resected
from uav_vslam.mapping.pictures.robust_fits import ground_plane
from uav_vslam.mapping.pictures.tracks import Tracks
from uav_vslam.mapping.pictures.triangulation import rays, triangulated

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SEED_PICTURES = 12
AGAIN = 1.25  # growth of the number of pictures after which all are adjusted
WELL_HELD = 0.5  # of the points that hold the best one: such pictures are placed at the same time
HUBER_SHARE = 4e-3  # Huber's bound / side
GROUND_SHARE = 1e-2  # PnP's bound / side for points that are placed on the ground: relief


def seed_of(count: int, pairs: Sequence[MatchedPair]) -> list[int]:
    """Return the ascending numbers of pictures to begin with: the best matched one, and those best matched to these."""
    matches = np.zeros((count, count))
    for pair in pairs:
        matches[pair.first, pair.second] = matches[pair.second, pair.first] = len(pair.rows)
    part = largest_part(count, pairs)
    chosen = [int(part[np.argmax(matches[part].sum(axis=1))])]
    while len(chosen) < min(SEED_PICTURES, len(part)):
        shared = matches[chosen].sum(axis=0)
        shared[chosen] = -1.0
        chosen.append(int(np.argmax(shared)))
    return sorted(chosen)


def grown(
    scene: Scene,
    tracks: Tracks,
    placed: NDArray[np.intp],
    priors: Priors,
    sizes: Sequence[tuple[int, int]],
) -> tuple[Scene, Tracks]:
    """Return the scene of all pictures that can be placed, and their observations without false ones.

    Args:
        scene: the poses of the pictures to begin with; its points are not used.
        tracks: of all pictures, in pixels from the images' centres.
        placed: numbers of the pictures to begin with.
        priors: of the lenses.
        sizes: width and height of each picture [px].
    """
    growth = _Growth(scene, tracks, np.isin(np.arange(len(sizes)), placed), priors, sizes)
    adjusted = len(placed)
    while growth.place_next():
        if growth.count >= AGAIN * adjusted:
            growth.adjust()
            adjusted = growth.count
    growth.adjust()
    return growth.seen()


class _Growth:
    """Pictures placed so far, and the observations of all that are not known to be false."""

    def __init__(
        self, scene: Scene, tracks: Tracks, placed: Mask, priors: Priors, sizes: Sequence[tuple[int, int]]
    ) -> None:
        self._scene, self._tracks, self._placed, self._priors, self._sizes = scene, tracks, placed, priors, sizes
        self._huber_px = HUBER_SHARE * float(np.median([max(size) for size in sizes]))
        self._true = np.ones(len(tracks.pixels), bool)

    @property
    def count(self) -> int:
        """Number of pictures placed."""
        return int(self._placed.sum())

    def seen(self) -> tuple[Scene, Tracks]:
        """Return the scene with points triangulated by the pictures placed, and their observations."""
        tracks = self._tracks.chosen(self._of_placed())
        return replace(self._scene, points=triangulated(self._scene, tracks)[0]), tracks

    def _of_placed(self) -> Mask:
        return np.asarray(self._true & self._placed[self._tracks.picture])

    def adjust(self) -> None:
        """Adjust all that is placed, and drop observations that it does not explain."""
        scene, tracks = self.seen()
        self._scene = Bundle(tracks, self._priors, huber_px=self._huber_px).adjust(scene)
        self._true[self._tracks.shared(self._of_placed())] = explained(self._scene, tracks, self._huber_px)

    def place_next(self) -> bool:
        """Place the pictures that are held best by points; return whether there were any."""
        points = np.full((self._tracks.count, 3), np.nan)
        scene, _ = self.seen()
        points[self._tracks.of(self._of_placed())] = scene.points
        return self._place_by(points) or self._place_by(self._on_ground(points), share=GROUND_SHARE)

    def _place_by(self, points: Array, **bound: float) -> bool:
        """Place pictures by (P, 3) points, NaN for unknown ones."""
        known = np.isfinite(points[self._tracks.point, 0]) & ~self._placed[self._tracks.picture]
        number = np.bincount(self._tracks.picture[known], minlength=len(self._sizes))
        scene, least, before = replace(self._scene, points=points), FEWEST_POINTS, self.count
        waiting = replace(self._tracks, picture=np.where(known, self._tracks.picture, -1))
        for picture in np.argsort(-number, kind="stable").tolist():
            if number[picture] < least:
                break
            found = resected(scene, waiting, picture, self._sizes[picture], **bound)
            if found is not None:
                scene, least = found, max(least, round(WELL_HELD * number[picture]))
                self._placed[picture] = True
        self._scene = scene
        return self.count > before

    def _on_ground(self, points: Array) -> Array:
        """Return points with those that one picture alone shows, where its rays meet the ground of its other points."""
        points = points.copy()
        known = np.isfinite(points[:, 0])
        for picture in np.flatnonzero(self._placed).tolist():
            own = self._of_placed() & (self._tracks.picture == picture)
            others = points[self._tracks.point[own & known[self._tracks.point]]]
            own &= ~known[self._tracks.point]
            if len(others) < FEWEST_POINTS or not own.any():
                continue
            normal, middle = ground_plane(others)
            centre = self._scene.centres[picture]
            seen = Tracks(self._tracks.picture[own], self._tracks.point[own], self._tracks.pixels[own], 0)
            towards = rays(self._scene, seen)
            points[seen.point] = centre + towards * ((middle - centre) @ normal / (towards @ normal))[:, None]
        return points
