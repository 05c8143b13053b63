# SPDX-License-Identifier: Apache-2.0
"""When a filter is re-initialised."""

import numpy as np
import pytest

from uav_vslam.estimation.weighted_update import Innovation
from uav_vslam.slam.health import MAX_LOST, MAX_NIS_PER_DOF, WINDOW, FilterHealth

DOF = 160  # forty landmarks


def test_a_consistent_filter_is_never_reinitialised() -> None:
    health, rng = FilterHealth(), np.random.default_rng(1)
    for nis in rng.chisquare(DOF, 2000):
        assert health.check(Innovation(nis, DOF), features=100, known=60) == ""
    assert abs(health.nis_per_dof - 1.0) < 0.1


def test_large_innovations_over_a_window_are_a_reason_with_their_nis() -> None:
    health = FilterHealth()
    reasons = [health.check(Innovation(2 * MAX_NIS_PER_DOF * DOF, DOF), features=100, known=60) for _ in range(WINDOW)]
    assert reasons[:-1] == [""] * (WINDOW - 1)  # one bad frame is not a diverged filter
    assert f"{2 * MAX_NIS_PER_DOF:.1f} times its degrees of freedom" in reasons[-1]


@pytest.mark.parametrize("innovation", [None, Innovation(0.0, 0)])
def test_believing_nothing_for_long_is_a_reason(innovation: Innovation | None) -> None:
    """Without an update, or with one of which the gates have left nothing."""
    health = FilterHealth()
    reasons = [health.check(innovation, features=100, known=60) for _ in range(MAX_LOST)]
    assert reasons[:-1] == [""] * (MAX_LOST - 1)
    assert f"{MAX_LOST} frames" in reasons[-1]


def test_neither_missing_features_nor_an_empty_map_is_a_reason() -> None:
    health = FilterHealth()
    for _ in range(3 * MAX_LOST):
        assert health.check(None, features=0, known=60) == ""
        assert health.check(None, features=100, known=0) == ""


def test_one_associated_frame_resets_the_count_of_lost_ones() -> None:
    health = FilterHealth()
    for _ in range(3):
        for _ in range(MAX_LOST - 1):
            assert health.check(None, features=100, known=60) == ""
        assert health.check(Innovation(float(DOF), DOF), features=100, known=60) == ""
