# SPDX-License-Identifier: Apache-2.0
"""Table and plot of several runs."""

import io

import cv2
import numpy as np
import pytest
from rich.console import Console

from uav_vslam.evaluation.comparison import Run, compare, pair_run
from uav_vslam.report.comparison_plot import comparison_plot, write_comparison_plot
from uav_vslam.report.comparison_table import NOTES, print_comparison


@pytest.fixture
def runs(pair):
    """The S-SLAM and C-SLAM tracks of two vehicles as if from a results folder, and one as if from a file."""
    found = [
        Run("2026-01-31_120000_demo", f"{name} {track}", getattr(vehicle, track), vehicle.truth)
        for name, vehicle in pair.vehicles.items()
        for track in ("s_slam", "c_slam")
    ]
    other = pair.vehicles["uav1"]
    return [
        pair_run(run) for run in (*found, Run("a_file_with_a_name_that_is_far_too_long", "", other.ins, other.truth))
    ]


def printed(runs, **settings):
    stream = io.StringIO()
    print_comparison(compare(runs, name="test", git=None, **settings), Console(file=stream))
    return stream.getvalue()


@pytest.mark.parametrize("width", [40, 80])
def test_a_narrow_terminal_shows_each_figure_in_full_and_beside_its_run(runs, width):
    tree, stream, narrow = compare(runs, name="test", git=None), io.StringIO(), io.StringIO()
    print_comparison(tree, Console(file=stream))
    print_comparison(tree, Console(file=narrow, force_terminal=True, color_system=None, width=width))
    tables = narrow.getvalue().split(NOTES)[0]
    assert "…" not in tables
    assert max(map(len, tables.splitlines())) <= width
    for name in ("uav1 S-SLAM", "uav2 C-SLAM"):
        wide, parts = (
            [cell for line in text.splitlines() if line.startswith(f"   {name} ") for cell in line.split()[2:]]
            for text in (stream.getvalue(), tables)
        )
        assert [cell for cell in parts if cell != "%"] == [cell for cell in wide if cell != "%"]


def test_each_run_has_its_row_below_the_name_of_its_folder(runs):
    lines = printed(runs).splitlines()
    rows = [line.split() for line in lines]
    assert sum("2026-01-31_120000_demo" in line for line in lines) == 3  # once a table
    # a straight line that is 2 m off at its end, of 0.5 m sigma: a turn removes the error
    s_slam = next(row for row in rows if row[:2] == ["uav1", "s_slam"])
    assert s_slam[2:] == ["198", "1.158", "0.006", "0.006", "0.003", "0.003", "0.000", "2.000", "2.217", "0.000"]
    relative = [row for row in rows if row[:2] == ["uav1", "s_slam"]][1]
    # 2 m in 198 m across the track; the last segments are shorter
    assert relative[2:] == ["0.000", "0.141", "0.000", "0.000", "0.000", "1.005", "0.000", "0.000"]
    drift = next(row for row in rows if row[:2] == ["uav2", "s_slam"] and "%" in row)
    assert drift[2:4] == ["%", "1.010"]  # 2 m in 198 m


def test_the_tables_fit_120_columns_with_kittis_eight_lengths_and_long_names(runs):
    text = printed(runs, lengths_m=(100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0))
    assert max(map(len, text.splitlines())) <= 120
    assert "…" not in text
    for title in ("unaligned", "start yaw", "start pose", "yaw+pos", "SE3", "800 m", "°/100 m"):
        assert title in text


def test_plan_height_and_error_are_those_of_the_aligned_runs(runs):
    plan, height, error = comparison_plot(runs, alignment="none", title="test").axes
    line = plan.lines[-1]
    np.testing.assert_allclose(line.get_xydata(), runs[-1].estimate.positions[:, :2])
    np.testing.assert_allclose(height.lines[-1].get_ydata(), 70.0)
    np.testing.assert_allclose(error.lines[-1].get_ydata()[-1], 30.0)
    assert plan.get_aspect() == 1.0
    moved = comparison_plot(runs, alignment="se3", title="test").axes[2]
    assert moved.lines[-1].get_ydata()[-1] == pytest.approx(0.5 * (np.hypot(198.0, 30.0) - 198.0))  # it is longer


def test_runs_have_different_lines(runs):
    error = comparison_plot(runs * 3, alignment="none", title="test").axes[2]
    assert len({(line.get_color(), line.get_linestyle()) for line in error.lines}) == 15


def test_a_diverging_run_is_clipped_and_the_error_axis_becomes_logarithmic(runs, single):
    lost = single.vehicles["uav1"]
    both = [runs[1], pair_run(Run("lost", "", lost.ins, lost.truth))]
    plan, _, error = comparison_plot(both, alignment="none", title="test").axes
    assert plan.get_ylim()[1] < 300.0
    assert error.get_yscale() == "log"
    assert comparison_plot(runs[:2], alignment="none", title="test").axes[2].get_yscale() == "linear"


def test_the_figure_is_written(runs, tmp_path):
    picture = cv2.imread(str(write_comparison_plot(runs, tmp_path, alignment="start-yaw", title="test")))
    assert min(picture.shape[:2]) > 400
    assert picture.std() > 5
