# SPDX-License-Identifier: Apache-2.0
"""NEES over time: what is drawn is what is scored, inside the band that it claims."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from uav_vslam.evaluation.consistency import nees
from uav_vslam.report.nees_plot import nees_plot
from uav_vslam.report.style import STYLES


def test_position_and_attitude_of_each_track_are_drawn_over_time(pair):
    figure = nees_plot(pair)
    assert [axes.get_ylabel() for axes in figure.axes if axes.get_ylabel()] == [
        "Position NEES / 3",
        "Attitude NEES / 3",
    ]
    assert figure.axes[-1].get_xlabel() == "Time [s]"
    vehicle = pair.vehicles["uav2"]
    for row, part in enumerate(("position", "rotation")):
        axes = figure.axes[2 * row + 1]
        for name in ("s_slam", "c_slam"):
            (line,) = (
                line for line in axes.lines if line.get_color() == STYLES[name].colour and len(line.get_xdata()) > 2
            )
            np.testing.assert_allclose(line.get_xdata(), 0.1 * np.arange(100))
            np.testing.assert_allclose(line.get_ydata(), getattr(nees(getattr(vehicle, name), vehicle.truth), part))


def test_the_band_holds_95_percent_of_a_consistent_filter_s_values(pair):
    for axes in nees_plot(pair).axes:
        (band,) = axes.patches
        low, high = band.get_y(), band.get_y() + band.get_height()
        assert chi2.cdf(3 * high, 3) - chi2.cdf(3 * low, 3) == pytest.approx(0.95)
        assert axes.get_ylim()[0] < low < high < axes.get_ylim()[1]


def test_the_legend_has_a_track_that_only_a_later_vehicle_has(pair):
    alone = dataclasses.replace(pair.vehicles["uav1"], c_slam=None)
    figure = nees_plot(dataclasses.replace(pair, vehicles=pair.vehicles | {"uav1": alone}))
    (legend,) = figure.legends
    assert {"S-SLAM", "C-SLAM"} <= {text.get_text() for text in legend.get_texts()}


def test_an_over_confident_estimate_stays_in_the_picture(pair):
    vehicle = pair.vehicles["uav1"]
    sure = dataclasses.replace(vehicle.s_slam, covariance=1e-6 * vehicle.s_slam.covariance)
    flight = dataclasses.replace(pair, vehicles={"uav1": dataclasses.replace(vehicle, s_slam=sure)})
    assert nees_plot(flight).axes[0].get_ylim()[1] > nees(sure, vehicle.truth).position.max()


def test_without_truth_or_covariance_there_is_nothing_to_draw(blind, pair):
    assert nees_plot(blind) is None
    vehicle = dataclasses.replace(pair.vehicles["uav1"], c_slam=None)
    bare = dataclasses.replace(vehicle, s_slam=dataclasses.replace(vehicle.s_slam, covariance=None))
    assert nees_plot(dataclasses.replace(pair, vehicles={"uav1": bare})) is None
