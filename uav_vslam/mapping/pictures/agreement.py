# SPDX-License-Identifier: Apache-2.0
"""Which matched pairs a result brings together, and where it is torn."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.pictures.features import PictureFeatures
from uav_vslam.mapping.pictures.pairs import MatchedPair
from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.mapping.pictures.procedure import Adjusted, centred
from uav_vslam.mapping.pictures.tracks import Tracks
from uav_vslam.mapping.pictures.triangulation import rays

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

APART_SHARE = 0.15  # median distance of matched points / longest side, which relief does not make
STRONG = 0.5  # of the most matches that either picture has


def agreeing(
    adjusted: Adjusted, pairs: Sequence[MatchedPair], features: Sequence[PictureFeatures], pictures: Sequence[Picture]
) -> Mask:
    """Return which pairs' matched points meet, by way of the ground at the height that the first picture shows."""
    seen = [_observed(pairs, features, pictures, end) for end in (0, 1)]
    scene, used = adjusted.scene, np.isin(np.arange(len(pictures)), adjusted.used)
    shown, heights = adjusted.tracks.picture, adjusted.scene.points[adjusted.tracks.point, 2]
    ground = np.array([np.median(heights[shown == k]) if used[k] else np.nan for k in range(len(pictures))])
    towards, centres = rays(scene, seen[0]), scene.centres[seen[0].picture]
    down = (ground[seen[0].picture] - centres[:, 2]) / towards[:, 2]
    there = replace(scene, points=centres + down[:, None] * towards)
    error = np.linalg.norm(there.residuals(seen[1]), axis=1)
    error[there.in_camera(seen[1])[:, 2] <= 0.0] = np.inf
    by_pair = np.split(error, np.cumsum([len(pair.rows) for pair in pairs])[:-1])
    sides = [max(pictures[pair.second].width, pictures[pair.second].height) for pair in pairs]
    return np.array(
        [
            used[pair.first] and used[pair.second] and bool(np.median(apart) <= APART_SHARE * side)
            for pair, apart, side in zip(pairs, by_pair, sides, strict=True)
        ]
    )


def torn(pairs: Sequence[MatchedPair], agree: Mask, used: NDArray[np.intp]) -> list[MatchedPair]:
    """Return pairs of pictures used that hardly match any other one better, and do not agree."""
    most: dict[int, int] = {}
    for pair in pairs:
        for picture in (pair.first, pair.second):
            most[picture] = max(most.get(picture, 0), len(pair.rows))
    among = set(used.tolist())
    return [
        pair
        for pair, meets in zip(pairs, agree, strict=True)
        if not meets
        and {pair.first, pair.second} <= among
        and len(pair.rows) >= STRONG * max(most[pair.first], most[pair.second])
    ]


def _observed(
    pairs: Sequence[MatchedPair], features: Sequence[PictureFeatures], pictures: Sequence[Picture], end: int
) -> Tracks:
    """Return all pairs' matched points in their first or second pictures, each as a point of its own."""
    ends = [(pair.first, pair.second)[end] for pair in pairs]
    picture = np.repeat(np.array(ends, np.intp), [len(pair.rows) for pair in pairs])
    pixels = np.concatenate([features[k].pixels[pair.rows[:, end]] for k, pair in zip(ends, pairs, strict=True)])
    return centred(Tracks(picture, np.arange(len(picture)), pixels, len(picture)), pictures)
