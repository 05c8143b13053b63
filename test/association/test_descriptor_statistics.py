# SPDX-License-Identifier: Apache-2.0
"""A landmark's descriptor statistics cover all its views, and are well defined after one."""

import numpy as np

from uav_vslam.association.descriptor_statistics import PRIOR_VIEWS, DescriptorStatistics


def views(count):
    return np.random.default_rng(1).integers(0, 256, (count, 3, 16)).astype(np.uint8)


def test_mean_and_scatter_cover_all_views_in_any_order():
    seen = views(7)
    statistics = DescriptorStatistics.of(seen[0])
    for view in seen[1:]:
        statistics.observe(np.array([2, 0]), view[[2, 0]])
    np.testing.assert_array_equal(statistics.count, [7, 1, 7])
    np.testing.assert_allclose(statistics.mean[[0, 2]], seen.mean(axis=0)[[0, 2]])
    np.testing.assert_allclose(statistics.scatter[[0, 2]], 7 * seen.var(axis=0)[[0, 2]])
    np.testing.assert_array_equal(statistics.mean[1], seen[0, 1])


def test_rows_follow_the_map():
    first, second = views(2)
    statistics = DescriptorStatistics.of(first[:0])
    statistics.append(first)
    statistics.append(second)
    assert statistics.count.tolist() == [1] * 6
    left = statistics.chosen(np.array([1, 5]))
    np.testing.assert_array_equal(left.mean, np.vstack([first[1], second[2]]))


def test_the_first_landmarks_set_the_descriptor_length():
    statistics = DescriptorStatistics.of(np.zeros((0, 128), np.uint8))
    statistics.append(np.zeros((2, 32), np.uint8))
    assert statistics.mean.shape == statistics.scatter.shape == (2, 32)


def test_the_variance_converges_from_the_common_to_the_landmarks_own():
    rng = np.random.default_rng(2)
    means = rng.integers(80, 180, (40, 16))
    sigma = np.where(np.arange(40) == 7, 20.0, 4.0)[:, None]
    statistics = DescriptorStatistics.of(np.rint(means).astype(np.uint8))
    before = statistics.variance()
    np.testing.assert_allclose(before, np.tile(before[:1], (40, 1)))
    for _ in range(200):
        statistics.observe(
            np.arange(40), np.clip(np.rint(means + sigma * rng.normal(size=means.shape)), 0, 255).astype(np.uint8)
        )
    estimated = statistics.variance().mean(axis=1)
    assert 300 < estimated[7] < 440  # of 400, with a standard deviation of 10 %/4 and shrinkage by PRIOR_VIEWS of 200
    assert 14 < np.delete(estimated, 7).mean() < 18
    assert PRIOR_VIEWS < 10


def test_a_variance_is_never_zero():
    alike = np.zeros((3, 8), np.uint8)
    statistics = DescriptorStatistics.of(alike)
    statistics.observe(np.arange(3), alike)
    assert (statistics.variance() > 0).all()
    assert DescriptorStatistics.of(alike[:0]).variance().shape == (0, 8)
