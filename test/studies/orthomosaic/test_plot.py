# SPDX-License-Identifier: Apache-2.0
from uav_vslam.studies.orthomosaic.plot import draw_orthomosaic, error_plot

CURVES = [
    {"method": name, "condition": "one vehicle", "seed": seed, "distance_m": [0.0, 50.0], "error_m": [0.0, error]}
    for name, error in (("orthomosaic", 0.1), ("homography chain", 9.0))
    for seed in (1, 2)
]


def test_what_there_is_becomes_a_readable_picture(drawn):
    assert drawn(draw_orthomosaic, {"rows": [], "series": CURVES}) == ["orthomosaic.png"]
    assert drawn(draw_orthomosaic, {"rows": []}) == []


def test_each_method_has_one_entry_in_the_legend_and_all_seeds_their_points():
    figure = error_plot(CURVES)
    lines = figure.axes[0].lines
    assert [line.get_ydata()[1] for line in lines] == [0.1, 0.1, 9.0, 9.0]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["orthomosaic", "homography chain"]
