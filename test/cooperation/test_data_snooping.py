# SPDX-License-Identifier: Apache-2.0
"""Pairs that the others do not predict are rejected; the rest stays."""

import numpy as np
import pytest
from scipy.stats import chi2

from uav_vslam.cooperation.data_snooping import predicted_by_others

GATE = float(chi2.ppf(0.99, 3))
SIGMA_M, DRIFT_M = 0.3, 10.0


def information(count: int) -> np.ndarray:
    """Return that of (count, 3) residuals with independent errors and one that all share."""
    shared = np.tile(np.eye(3), (count, 1))
    return np.linalg.inv(SIGMA_M**2 * np.eye(3 * count) + DRIFT_M**2 * shared @ shared.T)


@pytest.mark.parametrize("seed", range(10))
def test_pairs_go_as_if_the_rest_were_weighed_afresh_each_time(seed: int) -> None:
    """The Schur complements against the dense prediction of each pair from the others that are left."""
    rng = np.random.default_rng(seed)
    residuals = rng.normal(0.0, SIGMA_M, (9, 3)) + rng.normal(0.0, DRIFT_M, 3)
    residuals[rng.choice(9, 3, replace=False)] += rng.normal(0.0, 2.0, (3, 3))
    S, rows = np.linalg.inv(information(9)), np.arange(9)
    while len(rows) > 1:
        distance2 = []
        for k in rows:
            one, others = 3 * k + np.arange(3), (3 * rows[rows != k, None] + np.arange(3)).ravel()
            gain = np.linalg.solve(S[np.ix_(others, others)], S[np.ix_(others, one)]).T
            apart = residuals.ravel()[one] - gain @ residuals.ravel()[others]
            distance2.append(apart @ np.linalg.solve(S[np.ix_(one, one)] - gain @ S[np.ix_(others, one)], apart))
        if max(distance2) <= GATE:
            break
        rows = np.delete(rows, np.argmax(distance2))
    np.testing.assert_array_equal(predicted_by_others(information(9), residuals, GATE, least=1), rows)
    assert len(rows) < 9


def test_an_error_that_all_share_rejects_none() -> None:
    residuals = np.tile([2.0 * DRIFT_M, 0.0, 0.0], (6, 1))
    assert len(predicted_by_others(information(6), residuals, GATE, least=1)) == 6


@pytest.mark.parametrize(("count", "least", "left"), [(0, 1, 0), (1, 1, 1), (2, 1, 1), (2, 2, 2), (3, 2, 2)])
def test_the_last_ones_are_not_judged(count: int, least: int, left: int) -> None:
    residuals = 5.0 * np.arange(count)[:, None] * np.array([1.0, 0.0, 0.0])
    assert len(predicted_by_others(information(count), residuals, GATE, least=least)) == left
