# SPDX-License-Identifier: Apache-2.0
"""The plot of associations shows each figure in its own panel, and leaves out what is missing."""

from uav_vslam.studies.association.plot import MAP_PANELS, dot_plot, draw_association

ROWS = [
    {
        "condition": "clear",
        "method": "INS",
        "pairs_per_frame": None,
        "precision": None,
        "recall": None,
        "ate_rms_m": 4.0,
    },
    {
        "condition": "clear",
        "method": "nn",
        "pairs_per_frame": 50.0,
        "precision": 0.97,
        "recall": 0.8,
        "ate_rms_m": 0.3,
        "ms_association": 0.4,
    },
]


def test_each_panel_shows_its_own_figure_on_the_methods_line():
    axes = dot_plot(ROWS, MAP_PANELS).axes
    assert [a.get_xlabel() for a in axes] == list(MAP_PANELS.values())
    shown = [[tuple(map(float, point)) for point in a.lines[0].get_xydata()] for a in axes]
    assert shown == [[(0.97, 1.0)], [(0.8, 1.0)], [(4.0, 0.0), (0.3, 1.0)], [(0.4, 1.0)]]


def test_a_picture_is_drawn_for_each_table_that_there_is(tmp_path):
    assert [path.name for path in draw_association({"rows": ROWS}, tmp_path)] == ["association.png"]
    matched = {"condition": "clear", "method": "gtm", "precision": 1.0, "recall": 0.5, "ms_per_pair": 3.0}
    assert [path.name for path in draw_association({"rows": [matched]}, tmp_path)] == ["matching.png"]
    assert draw_association({"rows": []}, tmp_path) == []
