# SPDX-License-Identifier: Apache-2.0
"""Data association by track number."""

import numpy as np
import pytest

from uav_vslam.association import ASSOCIATORS, InView
from uav_vslam.association.descriptor_statistics import DescriptorStatistics
from uav_vslam.config import BackendConfig
from uav_vslam.slam.known_tracks import followed, tracks_first
from uav_vslam.types import StereoFeatures

CONFIG = BackendConfig()
RNG = np.random.default_rng(1)
EXPECTED = RNG.uniform(50, 900, (5, 4))
DESCRIPTORS = RNG.integers(0, 256, (5, 128), np.uint8)
PERMUTED = np.array([3, 0, 4, 1, 2])  # feature k observes landmark PERMUTED[k]


def landmarks() -> InView:
    statistics = DescriptorStatistics.of(DESCRIPTORS)
    return InView(np.arange(5) + 10, EXPECTED, np.tile(np.eye(4), (5, 1, 1)), DESCRIPTORS, statistics)


def features(tracks: list[int], *, offset_px: float = 0.0) -> StereoFeatures:
    pixels = (EXPECTED[PERMUTED] + offset_px).astype(np.float32)
    return StereoFeatures(1, pixels, DESCRIPTORS[PERMUTED], np.array(tracks, np.uint32))


def pairs_of(found: np.ndarray) -> set[tuple[int, int]]:
    return {(int(a), int(b)) for a, b in found}


def test_features_and_landmarks_of_one_track_are_pairs() -> None:
    tracks = np.array([21, 22, 23, 0, 25], np.uint32)
    found = followed(landmarks(), tracks, features([7, 21, 25, 22, 23]), probability=0.99)
    assert pairs_of(found) == {(0, 1), (4, 2), (1, 3), (2, 4)}


def test_track_zero_means_no_track() -> None:
    found = followed(landmarks(), np.zeros(5, np.uint32), features([0, 0, 0, 0, 0]), probability=0.99)
    assert found.shape == (0, 2)


def test_a_track_outside_its_landmarks_gate_is_not_paired() -> None:
    tracks = np.array([21, 22, 23, 24, 25], np.uint32)
    seen = features([24, 21, 25, 22, 23], offset_px=2.0)  # chi-square 16 with 4 degrees of freedom, the gate is 13.3
    assert len(followed(landmarks(), tracks, seen, probability=0.99)) == 0
    assert len(followed(landmarks(), tracks, seen, probability=0.999)) == 5


def test_features_without_track_go_to_the_associator() -> None:
    seen_by_it: list[tuple[list[int], int]] = []

    def watched(landmark_map: InView, seen: StereoFeatures, config: BackendConfig) -> np.ndarray:
        seen_by_it.append((landmark_map.rows.tolist(), len(seen)))
        return ASSOCIATORS["gated"](landmark_map, seen, config)

    tracks = np.array([21, 22, 0, 0, 0], np.uint32)
    found = tracks_first(watched, landmarks(), tracks, features([31, 21, 32, 22, 33]), CONFIG)
    assert pairs_of(found) == {(int(mark), k) for k, mark in enumerate(PERMUTED)}
    assert seen_by_it == [([12, 13, 14], 3)]


@pytest.mark.parametrize("count", [0, 5])
def test_nothing_to_match_gives_no_pairs(count: int) -> None:
    rows = np.arange(count)
    no_features = features([0] * 5).chosen(np.zeros(0, np.intp))
    found = tracks_first(
        ASSOCIATORS["gated"], landmarks().chosen(rows), np.zeros(count, np.uint32), no_features, CONFIG
    )
    assert found.shape == (0, 2)
