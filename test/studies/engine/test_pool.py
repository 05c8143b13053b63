# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest

from uav_vslam.studies.engine.pool import grouped, in_pool, mean, mean_interval, median, ratio, ratio_interval, rms


def test_one_worker_is_this_process_and_keeps_the_order():
    seen = []
    assert list(in_pool(lambda job: seen.append(job) or 2 * job, [3, 1, 2], 1)) == [6, 2, 4]
    assert seen == [3, 1, 2]


def test_several_workers_keep_the_order_though_the_first_job_takes_longest():
    longest, *others = in_pool(math.factorial, [400_000, 3, 1, 2], 2)
    assert longest > 1000
    assert others == [6, 1, 2]


def test_a_job_that_fails_ends_all_others_with_its_own_error_alone():
    with pytest.raises(ValueError, match="negative"):
        list(in_pool(math.factorial, [3, -1, *[200_000] * 20], 2))


def test_groups_and_what_is_in_them_keep_their_order():
    assert list(grouped([5, 2, 3, 8], lambda n: n % 2).items()) == [(1, [5, 3]), (0, [2, 8])]


def test_pooled_figures():
    assert rms([3.0, -4.0]) == pytest.approx(math.sqrt(12.5))
    assert mean([3.0, -4.0]) == -0.5
    assert median([5.0, 1.0, 2.0]) == 2.0
    assert ratio(3.0, 2.0) == 1.5


def test_nothing_pools_to_nothing():
    assert [pool([]) for pool in (rms, mean, median)] == [None, None, None]
    assert [ratio(None, 1.0), ratio(1.0, None), ratio(1.0, 0.0)] == [None, None, None]


def test_the_interval_holds_the_ratio_and_three_seeds_are_the_least():
    own = np.array([1.0, 4.0, 9.0, 2.0, 5.0])
    interval = ratio_interval(own, 0.25 * own * [0.5, 1.5, 1.0, 2.0, 0.8])
    assert interval["ratio_low"] < 0.5 < interval["ratio_high"]
    assert ratio_interval(own, 0.25 * own) == pytest.approx({"ratio_low": 0.5, "ratio_high": 0.5})
    assert ratio_interval(own[:2], own[:2]) == {}


def test_the_interval_of_a_mean_is_as_wide_as_theory_says():
    values = np.random.default_rng(3).normal(5.0, 2.0, 400)
    half = 1.96 * values.std() / np.sqrt(400)
    interval = mean_interval("x", values)
    assert interval == pytest.approx({"x_low": values.mean() - half, "x_high": values.mean() + half}, abs=0.03)
    assert mean_interval("x", np.array([1.0, np.nan, 2.0])) == mean_interval("x", values[:2]) == {}
