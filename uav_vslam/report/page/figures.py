# SPDX-License-Identifier: Apache-2.0
"""Which charts over time the page has, and what each of them shows of a vehicle."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from uav_vslam.report.page.charts import Chart, Data, chart_data, points_of_each
from uav_vslam.report.page.error_charts import error_charts, nees_charts
from uav_vslam.report.page.flight import FlightFiles, VehicleFiles
from uav_vslam.report.page.frame_charts import (
    calibration_charts,
    innovation_charts,
    link_charts,
    point_charts,
    sigma_charts,
    timing_charts,
)
from uav_vslam.report.page.html import Markup, section, tag


@dataclass(frozen=True, slots=True)
class Figure:
    """A section with charts.

    Attributes:
        title: of the section.
        short: its name in the contents.
        text: what is to be seen.
        charts: makes a vehicle's charts, none without data.
    """

    title: str
    short: str
    text: str
    charts: Callable[[FlightFiles, VehicleFiles], Sequence[Chart]]


FIGURES = {
    "errors": Figure(
        "Errors over time",
        "Errors",
        "Estimate minus truth in the map frame, not aligned; bands: three claimed standard deviations.",
        error_charts,
    ),
    "nees": Figure(
        "Consistency: NEES",
        "NEES",
        "Squared error normalised by the claimed covariance, over 3; 1 is expected, above the band over-confident. "
        "Band: 95 % of a consistent filter's poses (chi-square).",
        nees_charts,
    ),
    "innovations": Figure(
        "Innovations: NIS",
        "NIS",
        "Squared innovations of S-SLAM normalised by their claimed covariance, over the degrees of freedom; needs no "
        "truth. Shaded: frames without a visual update; dashed: reported problems.",
        innovation_charts,
    ),
    "sigmas": Figure("Claimed uncertainty", "Claims", "Standard deviations that the estimates claim.", sigma_charts),
    "calibration": Figure(
        "Calibration in flight",
        "Calibration",
        "What S-SLAM has found of the calibration's errors: the exposure of the images minus their stamp, by the IMU's "
        "clock, and a constant error of the disparity; bands: claimed standard deviations.",
        calibration_charts,
    ),
    "points": Figure(
        "Features and tracks",
        "Features",
        "Stereo points offered by the front end, those followed from the frame before, those that corrected the "
        "state, and landmarks in the state.",
        point_charts,
    ),
    "link": Figure(
        "Radio link", "Link", "Payload of the packets between two fusion epochs, and since the start.", link_charts
    ),
    "timing": Figure(
        "Time per stage", "Timing", "Processor time on each frame; fusion runs once an epoch.", timing_charts
    ),
}


def figure_sections(flights: Sequence[FlightFiles]) -> tuple[list[Markup], dict[str, Data]]:
    """Return a section for each figure with data, and the data by the figure's key."""
    sections, data = [], {}
    most = points_of_each(sum(len(flight.vehicles) for flight in flights))
    names = dict.fromkeys(name for flight in flights for name in flight.vehicles)  # a vehicle's flights side by side
    for key, figure in FIGURES.items():
        cells = [
            cell
            for name in names
            for flight in flights
            for cell in _cells(flight, name, figure, several=len(flights) > 1, most=most)
        ]
        if cells:
            data[key] = {"title": figure.title, "cells": cells}
            sections.append(_section(key, figure))
    return sections, data


def _section(key: str, figure: Figure) -> Markup:
    place = tag("div", data_figure=key, class_="cells")
    return section(key, figure.title, place, text=figure.text, short=figure.short)


def _cells(flight: FlightFiles, name: str, figure: Figure, *, several: bool, most: int) -> list[Data]:
    """Return the charts of a vehicle in a flight; nothing if it did not take part, or has no data."""
    charts = figure.charts(flight, flight.vehicles[name]) if name in flight.vehicles else ()
    if not charts:
        return []
    title = f"{flight.label}: {name}" if several else name
    return [{"title": title, "charts": [chart_data(chart, most) for chart in charts]}]
