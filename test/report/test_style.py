# SPDX-License-Identifier: Apache-2.0
"""Logarithmic axes can be read, whatever their range."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from uav_vslam.report.style import plain_log, save


@pytest.mark.parametrize(("low", "high"), [(0.7, 1.3), (0.98, 1.3), (1.6, 1.9), (2.1, 4.8), (3.0, 30.0), (1e-4, 1e4)])
def test_a_logarithmic_axis_has_labels_enough_to_read_it(low, high):
    axes = Figure().subplots()
    axes.plot([0, 1], [low, high])
    plain_log(axes, "y")
    bottom, top = axes.get_ylim()
    inside = [label.get_text() for label, at in zip(axes.get_yticklabels(), axes.get_yticks(), strict=True)]
    inside = [text for text in inside if bottom <= float(text) <= top]
    assert 3 <= len(inside) == len(set(inside)) <= 12


def test_an_axis_of_values_that_are_not_known_is_drawn_linear(tmp_path):
    figure = Figure()
    axes = figure.subplots()
    axes.plot([np.nan, np.nan], [1.0, 2.0])
    assert axes.get_xlim()[0] < 0.0
    plain_log(axes, "x")
    assert axes.get_xscale() == "linear"
    assert save(figure, tmp_path / "empty.png").exists()
