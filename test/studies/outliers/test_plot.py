# SPDX-License-Identifier: Apache-2.0
"""The plot of wrong matches shows each kind over its share."""

from uav_vslam.studies.outliers.plot import draw_outliers, outlier_plot


def wrong(kind, share, ratio):
    figures = {"end_ratio_to_clean": ratio, "nees_position": ratio, "runs": 40}
    return {"method": "robust", "kind": kind, "wrong_match_share": share, **figures}


OUTLIERS = [wrong("clean", 0.0, 1.0), wrong("swapped", 0.1, 1.1), wrong("lookalike", 0.1, 1.6)]


def test_what_there_is_becomes_readable_pictures(drawn):
    assert drawn(draw_outliers, {"rows": OUTLIERS}) == ["outliers.png"]
    assert drawn(draw_outliers, {"rows": []}) == []


def test_each_kind_of_wrong_match_starts_at_the_clean_flight():
    errors, _ = outlier_plot(OUTLIERS).axes
    curves = {line.get_label(): line.get_xydata().tolist() for line in errors.lines}
    assert curves["robust, swapped"] == [[0.0, 1.0], [10.0, 1.1]]
    assert curves["robust, lookalike"] == [[0.0, 1.0], [10.0, 1.6]]


def test_more_variants_than_colours_are_all_drawn():
    rows = [row | {"method": f"variant {number}"} for number in range(9) for row in OUTLIERS]
    names = {line.get_label() for line in outlier_plot(rows).axes[0].lines}
    assert {f"variant {number}, swapped" for number in range(9)} <= names
