# SPDX-License-Identifier: Apache-2.0
import pytest

from uav_vslam.studies.euroc.plot import COLOURS, draw_starts, start_plot


def curve(method, condition, errors):
    return {
        "method": method,
        "condition": condition,
        "time_s": [float(k) for k in range(len(errors))],
        "error_m": errors,
    }


@pytest.fixture
def series():
    return [
        curve("eif", "recorded", [0.0, 0.1, 0.2]),
        curve("eif", "drawn 1", [0.02, 0.05, 0.04]),
        curve("ukf", "recorded", []),  # the filter diverged at once
        curve("ukf", "frame 25", [0.0, 0.3]),
    ]


def test_each_filter_has_a_panel_with_its_runs_in_the_colour_of_their_start(series):
    panels = start_plot(series).axes
    assert [axes.get_ylabel() for axes in panels] == ["eif: error [m]", "ukf: error [m]"]
    assert [line.get_color() for line in panels[0].lines] == [COLOURS["recorded"], COLOURS["drawn"]]
    assert [line.get_color() for line in panels[1].lines] == [COLOURS["recorded"], COLOURS["frame"]]
    assert panels[1].lines[1].get_ydata().tolist() == [0.0, 0.3]


def test_errors_are_drawn_from_zero_unless_a_run_flew_away(series):
    for axes in start_plot(series).axes:
        assert (axes.get_yscale(), axes.get_ylim()[0]) == ("linear", 0.0)
    for axes in start_plot([*series, curve("ukf", "frame 50", [0.1, 40.0])]).axes:
        assert axes.get_yscale() == "log"


def test_only_kinds_of_start_that_are_there_are_explained(series):
    (legend,) = start_plot(series[:1]).legends
    assert [text.get_text() for text in legend.get_texts()] == ["recorded start"]


def test_a_picture_is_written_where_there_is_something_to_draw(series, tmp_path):
    assert draw_starts({"rows": []}, tmp_path) == []
    (path,) = draw_starts({"series": series}, tmp_path)
    assert path == tmp_path / "errors.png"
    assert path.stat().st_size > 10_000
