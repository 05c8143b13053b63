# SPDX-License-Identifier: Apache-2.0
"""What the fusion study draws is where its rows say."""

from uav_vslam.evaluation.study import Row
from uav_vslam.studies.engine.fusion_plot import gain_plot


def test_failures_are_written_beside_the_gain_however_large_the_nees() -> None:
    row: Row = {
        "method": "overlay, feedback",
        **{"ratio_to_s_slam": 1.2, "ratio_low": 1.1, "ratio_high": 1.3},
        **{"nees_position": 300.0, "nees_position_low": 200.0, "nees_position_high": 400.0},
        "nees_position_worst_quarter": 500.0,
        "failures": 2,
        "runs": 8,
    }
    gain, _ = gain_plot("schemes", [row]).axes
    (text,) = gain.texts
    assert "2 of 8 failed" in text.get_text()
    assert text.get_position()[0] == 1.3
