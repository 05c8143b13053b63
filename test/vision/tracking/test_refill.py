# SPDX-License-Identifier: Apache-2.0
"""Detection of new points to track."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.vision.tracking.refill import MIN_DISTANCE_PX, Refill

Grey = NDArray[np.uint8]
CONFIG = FrontendConfig(search_scale=0.5)
WANTED = 40


def searched(refill: Refill, image: Grey, tracked: NDArray[np.float64]) -> NDArray[np.float32]:
    refill.start(image, tracked, WANTED)
    found = refill.result()
    assert found is not None
    assert len(found.descriptors) == len(found) <= WANTED
    return found.pixels


def test_new_points_are_away_from_tracks_and_are_none_before_a_search(
    texture_image: Callable[[int, int], Grey],
) -> None:
    refill = Refill(CONFIG)
    assert refill.result() is None
    tracked = np.random.default_rng(1).uniform([0, 200], [500, 400], (120, 2))
    found = searched(refill, texture_image(400, 500), tracked)
    assert len(found) == WANTED
    assert np.linalg.norm(found[:, None] - tracked[None], axis=2).min() >= MIN_DISTANCE_PX
    assert np.mean(found[:, 1] < 200) > 0.8  # where there were none


def test_a_point_is_where_it_is_in_the_whole_image() -> None:
    """Blobs, searched in a part of the image that neither begins at its corner nor covers it."""
    image, blob = np.full((400, 640), 60, np.uint8), np.mgrid[-15:16, -15:16]
    centres = np.array([(u, v) for u in range(400, 600, 50) for v in range(60, 380, 50)])
    for u, v in centres:
        patch = 60 + 150 * np.exp(-(blob**2).sum(axis=0) / (2 * 4.0**2))
        image[v - 15 : v + 16, u - 15 : u + 16] = np.rint(patch)
    tracked = np.random.default_rng(2).uniform([0, 0], [380, 400], (200, 2))
    found = searched(Refill(CONFIG), image, tracked)
    distance = np.linalg.norm(found[:, None] - centres[None], axis=2).min(axis=0)
    searched_for = distance < 20.0
    assert searched_for.sum() >= 10
    assert distance[searched_for].max() < 0.1


def test_where_nothing_is_found_the_whole_image_is_searched_next(texture_image: Callable[[int, int], Grey]) -> None:
    image = texture_image(400, 500)
    image[:200] = 100  # water
    tracked = np.random.default_rng(1).uniform([0, 200], [500, 400], (60, 2))
    refill = Refill(CONFIG)
    assert len(searched(refill, image, tracked)) < WANTED
    assert len(searched(refill, image, tracked)) == WANTED
