# SPDX-License-Identifier: Apache-2.0
import dataclasses

import cv2
import numpy as np
import pytest

from uav_vslam.config import StartConfig, VehicleConfig, parameter_file
from uav_vslam.evaluation.result import FlightResult
from uav_vslam.report.error_plot import error_plot
from uav_vslam.report.plots import write_plots
from uav_vslam.report.style import STYLES, view_limits
from uav_vslam.report.views import plan_view


def lines(axes, name):
    return [line for line in axes.lines if line.get_color() == STYLES[name].colour]


@pytest.mark.slow
def test_every_plot_is_a_valid_image(pair, tmp_path):
    paths = write_plots(pair, tmp_path)
    assert [path.name for path in paths] == ["plan_view.png", "errors.png", "nees.png"]
    for path in paths:
        picture = cv2.imread(str(path))
        assert min(picture.shape[:2]) > 400
        assert picture.std() > 5


@pytest.mark.slow
def test_a_name_with_dollar_signs_is_drawn_as_it_is(pair, tmp_path):
    assert write_plots(dataclasses.replace(pair, name=r"a$\frac$b"), tmp_path)


@pytest.mark.slow
def test_the_same_flight_is_drawn_to_the_same_bytes(pair, tmp_path):
    first = [path.read_bytes() for path in write_plots(pair, tmp_path)]
    assert [path.read_bytes() for path in write_plots(pair, tmp_path)] == first


def test_without_ground_truth_there_is_no_error_plot(blind, tmp_path):
    assert error_plot(blind) is None
    assert {path.name for path in write_plots(blind, tmp_path)} == {"plan_view.png"}


def test_the_plan_view_shows_each_track_of_each_vehicle_in_its_colour(pair):
    axes = plan_view(pair).axes[0]
    assert {name: len(lines(axes, name)) for name in ("truth", "c_slam", "ins")} == {"truth": 2, "c_slam": 2, "ins": 2}
    assert axes.get_xlabel() == "East [m]"
    assert axes.get_ylabel() == "North [m]"


@pytest.mark.parametrize("method", ["static", "in_flight"])
def test_a_map_that_begins_where_the_vehicle_headed_has_no_north(pair, method):
    config = parameter_file({"/uav1/**": VehicleConfig(start=StartConfig(method=method)), "/uav2/**": VehicleConfig()})
    found = dataclasses.replace(pair, config=config)
    axes = plan_view(found).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")
    assert error_plot(found).axes[0].get_ylabel() == "x error [m]"


def test_the_plan_view_has_equal_scales(pair):
    axes = plan_view(pair).axes[0]
    assert axes.get_aspect() == 1.0
    np.testing.assert_allclose(lines(axes, "c_slam")[1].get_xydata(), pair.vehicles["uav2"].c_slam.positions[:, :2])


def test_a_runaway_ins_does_not_shrink_the_flight(single):
    low, high = view_limits(list(single.vehicles.values()))
    assert (high - low).max() < 2.0 * 198.0
    assert plan_view(single).axes[0].get_ylim() == (low[1], high[1])


def test_errors_are_those_of_the_tracks_inside_three_sigma(pair):
    axes = error_plot(pair).axes
    assert len(axes) == 6
    north = axes[2]  # first column, second row
    error = lines(north, "c_slam")[0].get_ydata()
    np.testing.assert_allclose(error, np.linspace(0, 1, 100), atol=1e-9)
    band = lines(north, "c_slam")[2].get_ydata()
    np.testing.assert_allclose(band, 1.5)
    assert "[m]" in axes[0].get_ylabel()
    assert axes[4].get_xlabel() == "Time [s]"


def test_a_flight_without_poses_is_drawn_empty(pair, tmp_path):
    empty = pair.vehicles["uav1"].s_slam.select(np.zeros(0, np.intp))
    vehicle = dataclasses.replace(pair.vehicles["uav1"], truth=None, ins=empty, s_slam=empty, c_slam=None)
    flight = FlightResult("empty", None, "none", 0.0, 0.0, {"uav1": vehicle})
    assert len(write_plots(flight, tmp_path)) == 1
