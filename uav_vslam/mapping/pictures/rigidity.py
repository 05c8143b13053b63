# SPDX-License-Identifier: Apache-2.0
"""Pictures whose place and size relative to the others nothing tells.

Two pictures leave the length between them open; a point in three pictures ties the lengths between them. A chain of
pictures without such points may be of any size, unless it joins the others at another place as well.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet

from uav_vslam.mapping.pictures.tracks import Tracks

Sets = list[tuple[int, ...]]

FEWEST_SHARED = 12  # points that tie lengths, or join two pictures
SMALLEST_GROUP = 3  # loose pictures next to each other: fewer at a border do no harm


def loose_pictures(tracks: Tracks) -> NDArray[np.intp]:
    """Return the ascending numbers of pictures that are not tied to most, in groups of three and more."""
    pairs = _sharing(tracks, 2)
    groups = _rigid_groups(pairs, _sharing(tracks, 3))
    tied, waiting = groups[0] if groups else set[int](), groups[1:]
    while ready := [group for group in waiting if _joins(group, tied, pairs)]:
        tied = tied.union(*ready)
        waiting = [group for group in waiting if group not in ready]
    loose = set(tracks.picture.tolist()) - tied
    parts: DisjointSet = DisjointSet(loose)
    for a, b in pairs:
        if a in loose and b in loose:
            parts.merge(a, b)
    return np.array(sorted(k for part in parts.subsets() if len(part) >= SMALLEST_GROUP for k in part), np.intp)


def _rigid_groups(pairs: Sets, triples: Sets) -> list[set[int]]:
    """Return the pictures between which all lengths are tied, largest groups first; two pictures are one, too."""
    lengths: DisjointSet = DisjointSet(pairs)
    for a, b, c in triples:
        for length in ((a, b), (b, c), (a, c)):
            lengths.add(length)
            lengths.merge((a, b), length)
    groups = [{picture for length in tied for picture in length} for tied in lengths.subsets()]
    return sorted(groups, key=len, reverse=True)


def _joins(group: set[int], tied: set[int], pairs: Sets) -> bool:
    """Return whether two or more pictures of a group are, or share points with, two or more of those tied."""
    joints = [(k, k) for k in group & tied]
    joints += [(a, b) for pair in pairs for a, b in (pair, pair[::-1]) if a in group and b in tied - group]
    return len({inner for inner, _ in joints}) >= 2 and len({outer for _, outer in joints}) >= 2


def _sharing(tracks: Tracks, count: int) -> Sets:
    """Return the ascending sets of `count` pictures, next to each other in tracks, that share enough points."""
    order = np.lexsort([tracks.picture, tracks.point])
    picture, point = tracks.picture[order], tracks.point[order]
    ends = len(picture) - count + 1
    rows = np.stack([picture[k : ends + k] for k in range(count)], axis=1)
    sets, points = np.unique(rows[point[count - 1 :] == point[:ends]], axis=0, return_counts=True)
    return [tuple(row) for row in sets[points >= FEWEST_SHARED].tolist()]
