# SPDX-License-Identifier: Apache-2.0
"""Tracks: one ground point in two or more pictures, by joining matches."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from uav_vslam.geometry.image_grid import spread
from uav_vslam.mapping.pictures.features import PictureFeatures
from uav_vslam.mapping.pictures.pairs import MatchedPair

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Tracks:
    """Observations of ground points, ordered by point.

    Attributes:
        picture, point: (M,) numbers of the picture and the point.
        pixels: (M, 2) [px].
        count: number of points.
    """

    picture: Rows
    point: Rows
    pixels: Array
    count: int

    def chosen(self, keep: NDArray[np.bool_]) -> "Tracks":
        """Return the observations kept, of points that keep two or more; points are numbered anew."""
        keep = self.shared(keep)
        kept, point = np.unique(self.point[keep], return_inverse=True)
        return Tracks(self.picture[keep], point.astype(np.intp), self.pixels[keep], len(kept))

    def shared(self, keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which (M,) observations are those of `chosen(keep)`, in order."""
        number = np.bincount(self.point[keep], minlength=self.count)
        return np.asarray(keep & (number[self.point] >= 2))

    def of(self, keep: NDArray[np.bool_]) -> Rows:
        """Return the present numbers of the points of `chosen(keep)`, in order."""
        return np.flatnonzero(np.bincount(self.point[keep], minlength=self.count) >= 2)


def join(features: Sequence[PictureFeatures], pairs: Sequence[MatchedPair]) -> Tracks:
    """Join matches into tracks; one that sees two points of a picture is false somewhere and dropped."""
    start = np.concatenate([[0], np.cumsum([len(each.pixels) for each in features])])
    first = np.concatenate([start[pair.first] + pair.rows[:, 0] for pair in pairs])
    second = np.concatenate([start[pair.second] + pair.rows[:, 1] for pair in pairs])
    total = int(start[-1])
    graph = csr_array((np.ones(len(first), bool), (first, second)), shape=(total, total))
    _, label = connected_components(graph, directed=False)
    picture = np.repeat(np.arange(len(features)), np.diff(start))
    seen, count = np.unique(label * len(features) + picture, return_counts=True)
    torn = np.zeros(total, bool)
    torn[seen[count > 1] // len(features)] = True
    good = (np.bincount(label, minlength=total)[label] >= 2) & ~torn[label]
    order = np.flatnonzero(good)[np.argsort(label[good], kind="stable")]
    kept, point = np.unique(label[order], return_inverse=True)
    pixels = np.concatenate([each.pixels for each in features])
    return Tracks(picture[order].astype(np.intp), point.astype(np.intp), pixels[order], len(kept))


def strongest(tracks: Tracks, pictures: int, per_picture: int, sizes: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Return which observations belong to a subset of points: in each picture the longest tracks, spread over it.

    Args:
        tracks: all of them.
        pictures: number of pictures.
        per_picture: points that each picture asks for.
        sizes: width and height of each picture [px].
    """
    length = np.bincount(tracks.point, minlength=tracks.count)
    wanted = np.zeros(tracks.count, bool)
    for picture in range(pictures):
        rows = np.flatnonzero(tracks.picture == picture)
        rows = rows[np.argsort(-length[tracks.point[rows]], kind="stable")]
        wanted[tracks.point[rows[spread(tracks.pixels[rows], per_picture, size=sizes[picture])]]] = True
    return np.asarray(wanted[tracks.point])
