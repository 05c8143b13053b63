# SPDX-License-Identifier: Apache-2.0
import pytest

from uav_vslam.studies.features.front_end import MATCHER_NAMES, accepted_rows
from uav_vslam.studies.features.sets import rendered_set


@pytest.mark.slow
def test_nearly_all_matches_that_the_front_end_accepts_on_a_rendered_flight_are_right() -> None:
    rows = {row["method"]: row for row in accepted_rows([rendered_set(1, 640)], [1])}
    assert set(rows) == {*MATCHER_NAMES, "stereo front end"}
    for name in ("nn_mutual", "ransac_fundamental", "ransac_homography", "stereo front end"):
        assert rows[name]["matches"] > 1000
        assert rows[name]["precision"] > 0.98
