# SPDX-License-Identifier: Apache-2.0
"""Which charts over time the page has, and what each of them shows of a vehicle."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from uav_vslam.report.page.charts import Chart, Data, chart_data
from uav_vslam.report.page.error_charts import error_charts, nees_charts
from uav_vslam.report.page.flight import FlightFiles, VehicleFiles
from uav_vslam.report.page.frame_charts import innovation_charts, link_charts, point_charts, sigma_charts, timing_charts
from uav_vslam.report.page.html import Markup, section, tag


@dataclass(frozen=True, slots=True)
class Figure:
    """A section with charts.

    Attributes:
        title: of the section.
        text: what is to be seen.
        charts: makes a vehicle's charts, none without data.
    """

    title: str
    text: str
    charts: Callable[[FlightFiles, VehicleFiles], Sequence[Chart]]


FIGURES = {
    "errors": Figure(
        "Errors over time",
        "Estimate minus truth in the map frame, not aligned; bands: three claimed standard deviations.",
        error_charts,
    ),
    "nees": Figure(
        "Consistency: NEES",
        "Squared error normalised by the claimed covariance, over 3; 1 is expected, above the band over-confident. "
        "Band: 95 % of a consistent filter's poses (chi-square).",
        nees_charts,
    ),
    "innovations": Figure(
        "Innovations: NIS",
        "Squared innovations of S-SLAM normalised by their claimed covariance, over the degrees of freedom; needs no "
        "truth. Shaded: frames without a visual update; dashed: reported problems.",
        innovation_charts,
    ),
    "sigmas": Figure("Claimed uncertainty", "Standard deviations that the estimates claim.", sigma_charts),
    "points": Figure(
        "Features and tracks",
        "Stereo points offered by the front end, those followed from the frame before, those that corrected the "
        "state, and landmarks in the state.",
        point_charts,
    ),
    "link": Figure(
        "Radio link", "Payload of the packets between two fusion epochs, and since the start.", link_charts
    ),
    "timing": Figure(
        "Time per stage", "Processor time on each frame; fusion runs once an epoch.", timing_charts
    ),
}


def figure_sections(flights: Sequence[FlightFiles]) -> tuple[list[Markup], dict[str, Data]]:
    """Return a section for each figure with data, and the data by the figure's key."""
    sections, data = [], {}
    for key, figure in FIGURES.items():
        cells = [cell for flight in flights for cell in _cells(flight, figure, several=len(flights) > 1)]
        if cells:
            data[key] = {"title": figure.title, "cells": cells}
            sections.append(section(key, figure.title, tag("div", data_figure=key, class_="cells"), text=figure.text))
    return sections, data


def _cells(flight: FlightFiles, figure: Figure, *, several: bool) -> list[Data]:
    cells = []
    for vehicle in flight.vehicles.values():
        charts = figure.charts(flight, vehicle)
        if charts:
            title = f"{flight.label}: {vehicle.name}" if several else vehicle.name
            cells.append({"title": title, "charts": [chart_data(chart) for chart in charts]})
    return cells
