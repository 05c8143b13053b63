# SPDX-License-Identifier: Apache-2.0
"""Classification uses each landmark's own descriptor statistics."""

import dataclasses

import numpy as np

from uav_vslam.association.classification import classify, squared_mahalanobis
from uav_vslam.association.descriptor_statistics import DescriptorStatistics
from uav_vslam.association.nearest import nn
from uav_vslam.config import BackendConfig

CONFIG = BackendConfig()


def test_the_distance_is_the_mahalanobis_formula():
    rng = np.random.default_rng(1)
    statistics = DescriptorStatistics.of(rng.integers(0, 256, (5, 16)).astype(np.uint8))
    statistics.observe(np.arange(5), rng.integers(0, 256, (5, 16)).astype(np.uint8))
    d = rng.integers(0, 256, (7, 16)).astype(np.uint8)
    expected = [
        [(x - mean) @ np.linalg.inv(np.diag(v)) @ (x - mean) for x in d.astype(float)]
        for mean, v in zip(statistics.mean, statistics.variance(), strict=True)
    ]
    np.testing.assert_allclose(squared_mahalanobis(statistics, d), expected, rtol=1e-5)
    assert squared_mahalanobis(statistics, d[:0]).shape == (5, 0)
    assert squared_mahalanobis(DescriptorStatistics.of(d[:0]), d).shape == (0, 7)


def test_one_outlying_view_does_not_replace_the_statistics(scene):
    """The newest descriptor of a landmark was corrupted; the mean of five good ones still matches."""
    in_view, seen = scene(40)
    rng = np.random.default_rng(3)
    good = in_view.descriptors
    for _ in range(4):
        in_view.statistics.observe(np.arange(40), np.clip(good + rng.normal(0, 6, good.shape), 0, 255).astype(np.uint8))
    corrupted = good.copy()
    corrupted[0] = rng.integers(40, 216, 128)
    in_view.statistics.observe(np.arange(40), corrupted)
    in_view = dataclasses.replace(in_view, descriptors=corrupted)
    assert 0 in classify(in_view, seen, CONFIG)[:, 0]
    assert 0 not in nn(in_view, seen, CONFIG)[:, 0]


def test_components_that_vary_between_views_have_little_weight():
    """Half of the descriptor is noise between views; there the true landmark is farther than a wrong one."""
    rng = np.random.default_rng(4)
    stable, noisy = rng.integers(100, 156, (30, 32)), 128
    statistics = DescriptorStatistics.of(np.hstack([stable, np.full((30, 32), noisy)]).astype(np.uint8))
    for _ in range(10):
        view = np.hstack([stable + rng.normal(0, 2, (30, 32)), noisy + rng.normal(0, 40, (30, 32))])
        statistics.observe(np.arange(30), np.clip(np.rint(view), 0, 255).astype(np.uint8))
    view = np.hstack([stable[0] + 2, np.clip(noisy + rng.normal(0, 40, 32), 0, 255)]).astype(np.uint8)
    distance2 = squared_mahalanobis(statistics, view[None])[:, 0]
    assert np.argmin(distance2) == 0
    assert distance2[0] < 0.7 * np.sort(distance2)[1]
