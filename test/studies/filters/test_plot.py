# SPDX-License-Identifier: Apache-2.0
"""The filters' plots show each method's own figures, and what is missing does not hinder the rest."""

import numpy as np

from uav_vslam.studies.filters.plot import consistency_plot, draw_filters, noise_plot

FAILED = {"end_rms_m": None, "ate_rms_m": None, "nees_position": None, "nees_position_end": None, "failures": 40}


def consistency(method, value, **other):
    figures = {"end_rms_m": 2 * value, "ate_rms_m": value, "nees_position": value, "nees_position_end": 2 * value}
    return {"method": method, **figures, "failures": 0, "runs": 40, "end_ratio_to_batch": 1.0, **other}


def noise(method, scale, rer):
    figures = {"rer": rer, "nees_position": rer and 10 * rer, "runs": 10, "failures": 0}
    return {"extractor": "SIFT", "method": method, "condition": scale, **figures}


CONSISTENCY = [consistency("ri15 eif", 1.0), consistency("euler9 thesis_uhf", 0.0, **FAILED)]
NOISE = [noise("ri15 eif", "w1", 0.1), noise("ri15 eif", "w2", 0.05)]
NOISE += [noise("euler9 thesis_uhf", "w1", None), noise("euler9 thesis_uhf", "w2", None)]


def test_what_there_is_becomes_readable_pictures(drawn):
    assert drawn(draw_filters, {"rows": CONSISTENCY + NOISE}) == ["consistency.png", "noise_scales_sift.png"]
    assert drawn(draw_filters, {"rows": NOISE}) == ["noise_scales_sift.png"]


def test_errors_and_nees_stand_in_the_row_of_their_method():
    errors, nees = consistency_plot(CONSISTENCY).axes
    assert [label.get_text() for label in errors.get_yticklabels()] == ["ri15 eif", "euler9 thesis_uhf"]
    ate, end = errors.lines
    np.testing.assert_array_equal(ate.get_xydata()[0], [1.0, 0])
    np.testing.assert_array_equal(end.get_xydata()[0], [2.0, 0])
    assert np.isnan(ate.get_xdata()[1])
    assert [text.get_text() for text in nees.texts] == ["40 of 40 failed"]


def test_noise_scales_run_along_the_axis_and_what_never_ended_is_named():
    figure = noise_plot(NOISE)
    rates, nees = figure.axes
    np.testing.assert_array_equal(rates.lines[0].get_ydata(), [0.1, 0.05])
    np.testing.assert_array_equal(nees.lines[0].get_ydata(), [1.0, 0.5])
    assert "euler9 thesis_uhf (fails)" in [text.get_text() for text in figure.legends[0].texts]
