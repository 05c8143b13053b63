# SPDX-License-Identifier: Apache-2.0
"""The ellipsoids' axes can be read."""

import dataclasses

import numpy as np
import pytest
from made_up_results import FLIGHT

from uav_vslam.studies.thesis.ellipsoid_plot import TICKS, ellipsoid_plot

COVARIANCE = np.tile(0.17**2 * np.eye(6), (100, 1, 1))  # 2 sigma from an error of 0.1 m reach 0.44 m: nine tenths


@pytest.mark.parametrize("axis", ["xaxis", "yaxis", "zaxis"])
def test_an_axis_has_few_labels(axis: str) -> None:
    vehicle = FLIGHT.vehicles["uav1"]
    assert vehicle.truth is not None
    near = dataclasses.replace(vehicle.truth, positions=vehicle.truth.positions + 0.1, covariance=COVARIANCE)
    vehicles = {"uav1": dataclasses.replace(vehicle, s_slam=near, c_slam=near)}
    figure = ellipsoid_plot(dataclasses.replace(FLIGHT, vehicles=vehicles))
    assert figure is not None
    shown = getattr(figure.axes[0], axis)
    low, high = shown.get_view_interval()
    assert 2 < sum(low <= value <= high for value in shown.get_majorticklocs()) <= TICKS
