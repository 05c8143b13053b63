# SPDX-License-Identifier: Apache-2.0
"""The studies' plots show each method's own figures, and what is missing does not hinder the rest."""

import cv2
import numpy as np
import pytest

from uav_vslam.studies.filters.plot import consistency_plot, draw_filters, noise_plot
from uav_vslam.studies.long.plot import draw_long, long_plot, running_median
from uav_vslam.studies.outliers.plot import draw_outliers, outlier_plot
from uav_vslam.studies.revisit.plot import draw_revisit, revisit_plot

FAILED = {"end_rms_m": None, "ate_rms_m": None, "nees_position": None, "nees_position_end": None, "failures": 40}


def consistency(method, value, **other):
    figures = {"end_rms_m": 2 * value, "ate_rms_m": value, "nees_position": value, "nees_position_end": 2 * value}
    return {"method": method, **figures, "failures": 0, "runs": 40, "end_ratio_to_batch": 1.0, **other}


def noise(method, scale, rer):
    figures = {"rer": rer, "nees_position": rer and 10 * rer, "runs": 10, "failures": 0}
    return {"extractor": "SIFT", "method": method, "scale": scale, **figures}


def wrong(method, kind, share, ratio):
    return {
        "method": method,
        "kind": kind,
        "share": share,
        "end_to_clean": ratio,
        "nees_position": ratio,
        "runs": 40,
    }


CONSISTENCY = [consistency("ri15 eif", 1.0), consistency("euler9 thesis_uhf", 0.0, **FAILED)]
NOISE = [noise("ri15 eif", "w1", 0.1), noise("ri15 eif", "w2", 0.05)]
NOISE += [noise("euler9 thesis_uhf", "w1", None), noise("euler9 thesis_uhf", "w2", None)]
LONG = [
    {
        "method": name,
        "distance_m": [0.0, 3.0, 6.0],
        "error_m": [0.0, e, e],
        "ms": [9.0, 9.0, 9.0],
        "landmarks": [40.0] * 3,
    }
    for name, e in (("grid", 0.5), ("none", 1.5))
]
OUTLIERS = [wrong("robust", "clean", 0.0, 1.0), wrong("robust", "swapped", 0.1, 1.1)]
OUTLIERS += [wrong("robust", "lookalike", 0.1, 1.6)]
REVISIT = [
    {
        "level": level,
        "method": name,
        "distance_m": [0.0, 1000.0, 2000.0],
        "error_m": [0.0, 2.0, e],
        "seeds": seeds,
        "ends_m": [e + seed for seed in seeds],
    }
    for level in ("landmark", "rendered")
    for name, e, seeds in (("retained", 0.5, [1, 2]), ("nothing retained", 1.5, [2]))
]


@pytest.mark.parametrize(
    ("draw", "tree", "names"),
    [
        (draw_filters, {"rows": CONSISTENCY + NOISE}, ["consistency.png", "noise_scales_sift.png"]),
        (draw_filters, {"rows": NOISE}, ["noise_scales_sift.png"]),
        (draw_long, {"rows": [], "series": LONG}, ["long.png"]),
        (draw_long, {"rows": []}, []),
        (draw_outliers, {"rows": OUTLIERS}, ["outliers.png"]),
        (draw_outliers, {"rows": []}, []),
        (draw_revisit, {"rows": [], "series": REVISIT}, ["revisit.png"]),
        (draw_revisit, {"rows": []}, []),
    ],
)
def test_what_there_is_becomes_readable_pictures(draw, tree, names, tmp_path):
    paths = draw(tree, tmp_path)
    assert [path.name for path in paths] == names
    for path in paths:
        picture = cv2.imread(str(path))
        assert min(picture.shape[:2]) > 200
        assert picture.std() > 5


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


def test_the_long_flight_has_error_time_and_landmarks_over_distance():
    errors, times, landmarks = long_plot(LONG).axes
    np.testing.assert_array_equal(errors.lines[1].get_xydata(), [[0.0, 0.0], [3.0, 1.5], [6.0, 1.5]])
    assert [line.get_ydata()[0] for line in (*times.lines, *landmarks.lines)] == [9.0, 9.0, 40.0, 40.0]
    assert landmarks.get_xlabel() == "Distance flown [m]"


def test_a_single_slow_frame_is_not_seen_in_the_running_median():
    values = np.full(50, 8.0)
    values[[0, 20, 49]] = 100.0
    np.testing.assert_array_equal(running_median(values), np.full(50, 8.0))


def test_each_kind_of_wrong_match_starts_at_the_clean_flight():
    errors, _ = outlier_plot(OUTLIERS).axes
    curves = {line.get_label(): line.get_xydata().tolist() for line in errors.lines}
    assert curves["robust, swapped"] == [[0.0, 1.0], [10.0, 1.1]]
    assert curves["robust, lookalike"] == [[0.0, 1.0], [10.0, 1.6]]


def test_each_flights_end_stands_over_its_end_without_retention():
    errors, ends, *of_rendered = revisit_plot(REVISIT).axes
    np.testing.assert_array_equal(errors.lines[1].get_ydata(), [0.0, 2.0, 1.5])
    assert ends.lines[0].get_xydata().tolist() == [[3.5, 2.5]]  # seed 1 has no other end to stand over
    assert [line.get_ydata()[1] / line.get_xdata()[1] for line in ends.lines[1:]] == [1.0, 0.5]
    assert len(of_rendered) == 2
