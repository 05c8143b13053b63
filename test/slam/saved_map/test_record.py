# SPDX-License-Identifier: Apache-2.0
"""A section's covariance bounds the exact one, and the hash names one map."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.geometry.coded_points import rigid_jacobian
from uav_vslam.slam.saved_map import MappedPlace, MapSection, SavedMap

ROUNDING = 1e-6  # relative to the largest eigenvalue


def drifted(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) points and a covariance with a rigid part, an independent one and a stretch."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-40.0, 40.0, (count, 3)) * [1.0, 1.0, 0.1]
    loading = np.hstack([rigid_jacobian(points) * [0.5, 0.5, 0.3, 2e-3, 2e-3, 8e-3], 0.004 * points.reshape(-1, 1)])
    return points, loading @ loading.T + np.diag(rng.uniform(0.05, 0.3, 3 * count) ** 2)


def place_of(points: np.ndarray, covariance: np.ndarray) -> MappedPlace:
    count = len(points)
    return MappedPlace.of(
        np.arange(count, dtype=np.uint32),
        points,
        covariance,
        descriptors=np.zeros((count, 128), np.uint8),
        observations=np.ones(count, np.uint32),
    )


def section_of(points: np.ndarray, covariance: np.ndarray) -> MapSection:
    return place_of(points, covariance).section()


def test_a_large_drift_does_not_hide_how_exact_landmarks_are_to_each_other() -> None:
    """The factor is kept in single precision, which a covariance of 100 m and 2 mm would not survive."""
    rng, own_m = np.random.default_rng(3), 0.002
    common = np.tile(100.0 * np.eye(3), (20, 1))
    place = place_of(rng.normal(size=(20, 3)), common @ common.T + own_m**2 * np.eye(60))
    apart = np.eye(57, 60) - np.eye(57, 60, 3)  # of each landmark from the next
    assert np.diag(apart @ place.covariance @ apart.T) == pytest.approx(2.0 * own_m**2, rel=0.05)


@pytest.mark.parametrize("count", [1, 2, 12])
def test_the_covariance_of_a_section_bounds_the_exact_one(count: int) -> None:
    points, P = drifted(count, count)
    excess = section_of(points, P).covariance - P
    assert np.linalg.eigvalsh(excess)[0] > -ROUNDING * np.linalg.eigvalsh(P)[-1]


def test_the_common_error_moves_rigidly_with_the_point_it_is_wanted_at() -> None:
    section, at = section_of(*drifted(5, 10)), np.array([120.0, -30.0, 70.0])
    draws = np.random.default_rng(1).normal(size=(20_000, 6)) @ section.common_factor.T
    moved = np.hstack([draws[:, :3] + np.cross(draws[:, 3:], at - section.anchor), draws[:, 3:]])
    exact = section.common_covariance(at)
    scale = np.sqrt(np.diag(exact))
    assert np.abs((np.cov(moved.T) - exact) / np.outer(scale, scale)).max() < 0.05


def changed(saved: SavedMap, **changes: object) -> SavedMap:
    return SavedMap(saved.origin, (dataclasses.replace(saved.sections[0], **changes), *saved.sections[1:]))


def test_whatever_changes_in_a_map_changes_its_hash(saved: SavedMap) -> None:
    first = saved.sections[0]
    others = [SavedMap(dataclasses.replace(saved.origin, session=9), saved.sections)]
    others += [SavedMap(dataclasses.replace(saved.origin, other_sources=()), saved.sections)]
    others += [SavedMap(saved.origin, saved.sections[:-1])]
    for name in ("anchor", "common_factor", "ids", "positions", "own_factors", "descriptors", "observations"):
        array = getattr(first, name).copy()
        array.flat[0] += 1
        others.append(changed(saved, **{name: array}))
    hashes = {one.hash for one in others}
    assert len(hashes) == len(others)
    assert saved.hash not in hashes
    assert saved.hash == SavedMap(saved.origin, saved.sections).hash
