# SPDX-License-Identifier: Apache-2.0
"""Pairs that contradict stronger ones around a loop of pictures: look-alike ground, matched where nothing is shared.

Homographies of nearly flat ground can be composed, whatever the cameras' tilt and lenses. Around a few pictures a true
pair is met within some pixels; crop rows or tiles that repeat lead astray by a repetition [zach10].
"""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.pictures.pairs import MatchedPair

Array = NDArray[np.float64]
Strength = list[dict[int, float]]

MOST_STEPS = 4  # pairs of the way around: relief and noise add up
FALSE_SHARE = 0.1  # median error / longest side: 0.01 is seen of true pairs


def without_contradicted(pairs: Sequence[MatchedPair], pixels: Sequence[Array], sides_px: Array) -> list[MatchedPair]:
    """Return the pairs, in their order, but those that the best way around, over stronger ones, contradicts.

    Args:
        pairs: matched ones.
        pixels: per picture, (N, 2) points [px].
        sides_px: (N,) longest side of each picture.
    """
    maps: dict[tuple[int, int], Array] = {}
    costs: Strength = [{} for _ in pixels]
    kept = []
    for k in sorted(range(len(pairs)), key=lambda k: -len(pairs[k].rows)):
        pair = pairs[k]
        p, q = pixels[pair.first][pair.rows[:, 0]], pixels[pair.second][pair.rows[:, 1]]
        around = _way(costs, pair.first, pair.second)
        if (
            around
            and _median_error(p, q, [maps[step] for step in pairwise(around)]) > FALSE_SHARE * sides_px[pair.second]
        ):
            continue
        kept.append(k)
        H, _ = cv2.findHomography(p, q)
        if H is not None and abs(np.linalg.det(H)) > 0.0:
            maps[pair.first, pair.second], maps[pair.second, pair.first] = H, np.linalg.inv(H)
            costs[pair.first][pair.second] = costs[pair.second][pair.first] = 1.0 / len(pair.rows)
    return [pairs[k] for k in sorted(kept)]


def _way(costs: Strength, start: int, end: int) -> list[int]:
    """Return the pictures of the cheapest way of at most `MOST_STEPS` from one to another; empty if there is none."""
    cost, before, front = {start: 0.0}, {start: start}, [start]
    for _ in range(MOST_STEPS):
        reached: dict[int, None] = {}
        for here in front:
            for there, step in costs[here].items():
                if cost[here] + step < cost.get(there, np.inf):
                    cost[there], before[there] = cost[here] + step, here
                    reached[there] = None
        front = list(reached)
    if end not in cost:
        return []
    way = [end]
    while way[-1] != start:
        way.append(before[way[-1]])
    return way[::-1]


def _median_error(p: Array, q: Array, maps: Sequence[Array]) -> float:
    """Return the median distance of (N, 2) points q from p, mapped by one homography after the other [px]."""
    mapped = np.column_stack([p, np.ones(len(p))])
    for H in maps:
        mapped = mapped @ H.T
    return float(np.median(np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - q, axis=1)))
