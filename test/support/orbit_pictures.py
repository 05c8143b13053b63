# SPDX-License-Identifier: Apache-2.0
"""Matched points of pictures taken in a banked circle over the ground, without images."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from picture_folder import FOCAL_PX, HEIGHT_M, R_LEVEL, SIZE

from uav_vslam.geometry.plane import similarity_between
from uav_vslam.geometry.rotation import rotation_from_rpy
from uav_vslam.mapping.pictures.features import PictureFeatures
from uav_vslam.mapping.pictures.pairs import MatchedPair
from uav_vslam.mapping.pictures.picture import Picture

Array = NDArray[np.float64]

RADIUS_M, BANK_DEG, ROUND_DEG = 45.0, 25.0, 400.0
POINTS, RELIEF_M, NOISE_PX = 8000, 1.0, 0.1
FEWEST_SHARED = 60


@dataclass(frozen=True)
class Orbit:
    """What `reconstruct` takes, and the true camera centres (N, 3) [m]."""

    pictures: list[Picture]
    features: list[PictureFeatures]
    pairs: list[MatchedPair]
    centres: Array


def orbit(count: int = 40, *, seed: int = 2) -> Orbit:
    """Return a circle that closes: its last pictures show what the first ones do."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-130.0, 130.0, (POINTS, 2)), rng.normal(0.0, RELIEF_M, POINTS)])
    angles = np.deg2rad(np.linspace(0.0, ROUND_DEG, count))
    centres = np.column_stack([RADIUS_M * np.cos(angles), RADIUS_M * np.sin(angles), np.full(count, HEIGHT_M)])
    pictures, features, shown = [], [], []
    for k, angle in enumerate(angles.tolist()):
        R_map_cam = rotation_from_rpy(-np.deg2rad(BANK_DEG), 0.0, angle + 0.5 * np.pi) @ R_LEVEL
        inside = (points - centres[k]) @ R_map_cam
        pixels = FOCAL_PX * inside[:, :2] / inside[:, 2:] + 0.5 * (np.array(SIZE) - 1.0)
        seen = np.flatnonzero((inside[:, 2] > 0.0) & (pixels >= 0.0).all(axis=1) & (pixels < SIZE).all(axis=1))
        noisy = pixels[seen] + rng.normal(0.0, NOISE_PX, (len(seen), 2))
        features.append(PictureFeatures(noisy, np.zeros((len(seen), 128), np.uint8)))
        pictures.append(Picture(Path(f"{k:02d}.png"), *SIZE, False, "camera", None, None, None, None, False))
        shown.append(seen)
    pairs = [pair for i in range(count) for j in range(i + 1, count) if (pair := matched(features, shown, i, j))]
    return Orbit(pictures, features, pairs, centres)


def matched(features: list[PictureFeatures], shown: list[NDArray[np.intp]], i: int, j: int) -> MatchedPair | None:
    """Return a pair by the points that both pictures show; None if there are few."""
    _, first, second = np.intersect1d(shown[i], shown[j], return_indices=True)
    if len(first) < FEWEST_SHARED:
        return None
    turn = similarity_between(features[i].pixels[first], features[j].pixels[second])
    assert turn is not None
    return MatchedPair(i, j, np.column_stack([first, second]), turn)
