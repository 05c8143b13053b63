# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.evaluation.consistency import chi_square_band
from uav_vslam.studies.perturbed.calibration import ALL, EXACT
from uav_vslam.studies.perturbed.plot import cost_plot, draw_perturbed

METHODS = ("fixed", "estimated")


@pytest.fixture
def tree():
    rows, series = [], []
    for level in ("landmark level", "rendered images"):
        for method in METHODS:
            for condition, ratio in ((EXACT, 1.0), (ALL, 4.0)):
                label = {"table": level, "method": method, "condition": condition, "runs": 20}
                figures = {"ratio_to_exact": ratio, "nees_position": 2 * ratio, "nees_rotation": None}
                rows.append({**label, **figures, "ratio_low": 0.9 * ratio, "ratio_high": 1.1 * ratio})
                curve = {"time_s": [0.0, 0.1], "nees_position": [1.0, ratio], "nees_rotation": [1.0, 1.0]}
                series.append({**label, **curve})
    return {"rows": rows, "series": series}


def test_each_condition_has_a_mark_of_each_method_and_its_interval(tree):
    ratio, nees, _ = cost_plot(tree["rows"]).axes[:3]
    for number, method in enumerate(METHODS):
        (marks,) = (line for line in ratio.lines if line.get_label() == method)
        np.testing.assert_allclose(marks.get_xdata(), [1.0, 4.0])
        np.testing.assert_allclose(marks.get_ydata(), np.array([0, 1]) + 0.16 * (number - 0.5))
    ends = {tuple(line.get_xdata()) for line in ratio.lines if len(line.get_xdata()) == 2}
    assert {(0.9, 1.1), (3.6, 4.4)} <= ends
    (band,) = nees.patches
    assert (band.get_x(), band.get_x() + band.get_width()) == pytest.approx(chi_square_band(20))
    assert [label.get_text() for label in ratio.get_yticklabels()] == [EXACT, ALL]


@pytest.mark.slow
def test_costs_and_a_picture_of_nees_over_time_of_each_level_are_drawn(tree, drawn):
    assert drawn(draw_perturbed, tree) == ["perturbed.png", "nees_landmark_level.png", "nees_rendered_images.png"]
