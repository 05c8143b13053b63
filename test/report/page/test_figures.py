# SPDX-License-Identifier: Apache-2.0
"""The charts show what the folder holds, and are absent where it holds nothing."""

from pathlib import Path

import numpy as np
import pytest
from made_up_results import DARK, FRAMES, write_bare, write_full

from uav_vslam.evaluation.consistency import chi_square_band
from uav_vslam.report.page.charts import MOST_POINTS, Chart, Line, chart_data, numbers, points_of_each
from uav_vslam.report.page.figures import FIGURES, figure_sections
from uav_vslam.report.page.flight import read_flight


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> dict:
    flight = read_flight(write_full(tmp_path_factory.mktemp("full")), "full")
    return figure_sections([flight])[1]


def lines(chart: dict) -> dict[str, dict]:
    return {line["label"]: line for line in chart["lines"]}


def test_a_flight_with_all_records_has_all_figures_for_each_vehicle(data: dict) -> None:
    assert list(data) == list(FIGURES)
    for figure in data.values():
        assert [cell["title"] for cell in figure["cells"]] == ["uav1", "uav2"]


def test_every_chart_names_its_quantity_and_unit(data: dict) -> None:
    for figure in data.values():
        for chart in figure["cells"][0]["charts"]:
            assert "[" in chart["title"] or chart["title"] in ("Count", "NIS / dof") or "NEES" in chart["title"]


def test_errors_and_their_bands_are_three_claimed_sigmas(data: dict) -> None:
    east, north, up = data["errors"]["cells"][0]["charts"]
    np.testing.assert_allclose(lines(north)["S-SLAM"]["y"], np.linspace(0, 2, FRAMES), atol=1e-4)
    np.testing.assert_allclose(lines(east)["C-SLAM"]["y"], 0.0, atol=1e-9)
    for chart in (east, north, up):
        for band in chart["bands"]:
            np.testing.assert_allclose(band["high"], 1.5)
            np.testing.assert_allclose(band["low"], -1.5)


def test_nees_is_the_normalised_error_with_the_chi_square_band(data: dict) -> None:
    position = data["nees"]["cells"][0]["charts"][0]
    assert position["log"]
    assert lines(position)["S-SLAM"]["y"][-1] == pytest.approx((2.0 / 0.5) ** 2 / 3, rel=1e-4)
    band = position["bands"][0]
    assert (band["low"][0], band["high"][0]) == pytest.approx(chi_square_band(1), rel=1e-4)


def test_innovations_have_gaps_at_frames_without_update_which_are_marked(data: dict) -> None:
    chart = data["innovations"]["cells"][0]["charts"][0]
    expected = [np.nan if k in DARK else 0.9 + 0.01 * k for k in range(FRAMES)]
    np.testing.assert_allclose(np.array(lines(chart)["S-SLAM"]["y"], float), expected, rtol=1e-4)
    np.testing.assert_allclose(chart["shades"], [(0.1 * (k - 1), 0.1 * k) for k in DARK], atol=1e-6)
    assert [(mark["x"], mark["text"]) for mark in chart["marks"]] == [(4.0, "<b>a problem</b>")]


def test_the_calibration_has_its_sigma_about_it_and_gaps_where_it_is_not_estimated(data: dict) -> None:
    offset, disparity = data["calibration"]["cells"][0]["charts"]
    np.testing.assert_allclose(lines(offset)["estimate"]["y"], -0.2)
    np.testing.assert_allclose(
        (offset["bands"][0]["low"], offset["bands"][0]["high"]), [[-0.3] * FRAMES, [-0.1] * FRAMES]
    )
    expected = [np.nan if k in DARK else 0.02 for k in range(FRAMES)]
    np.testing.assert_allclose(np.array(lines(disparity)["estimate"]["y"], float), expected)


def test_results_from_before_the_calibration_was_written_have_all_other_figures(tmp_path: Path) -> None:
    folder = write_full(tmp_path)
    for path in folder.glob("*_frames.csv"):
        rows = [row.split(",") for row in path.read_text().splitlines()]
        kept = [k for k, name in enumerate(rows[0]) if "time_offset" not in name and "disparity" not in name]
        path.write_text("".join(",".join(row[k] for k in kept) + "\n" for row in rows))
    assert list(figure_sections([read_flight(folder, "older")])[1]) == [key for key in FIGURES if key != "calibration"]


def test_traffic_of_the_epochs_sums_to_that_since_the_start(data: dict) -> None:
    each, total = data["link"]["cells"][0]["charts"]
    np.testing.assert_allclose(np.cumsum(lines(each)["sent"]["y"]), lines(total)["sent"]["y"])
    assert lines(total)["received"]["y"][-1] == 8.1  # kB


def test_the_traffic_of_the_first_epoch_is_that_since_the_flights_start(tmp_path: Path) -> None:
    folder = write_full(tmp_path)
    path = folder / "uav1_link.csv"
    head, _, *rows = path.read_text().splitlines()  # the first epoch ends after a second, with 1 kB sent
    path.write_text("\n".join([head, *rows]) + "\n")
    each, total = figure_sections([read_flight(folder, "full")])[1]["link"]["cells"][0]["charts"]
    assert (lines(each)["sent"]["x"][:2], lines(each)["sent"]["y"][:2]) == ([0, 1], [0, 1])
    assert (lines(total)["sent"]["x"][:2], lines(total)["sent"]["y"][:2]) == ([0, 1], [0, 1])


def test_times_are_in_milliseconds(data: dict) -> None:
    chart = data["timing"]["cells"][0]["charts"][0]
    assert {label: set(line["y"]) for label, line in lines(chart).items()} == {"Front end": {10}, "Back end": {30}}


def test_a_flight_without_records_and_truth_has_claims_alone(tmp_path: Path) -> None:
    sections, data = figure_sections([read_flight(write_bare(tmp_path), "bare")])
    assert list(data) == ["sigmas"]
    assert len(sections) == 1


def test_flights_of_a_vehicle_stand_side_by_side(tmp_path: Path) -> None:
    flights = [read_flight(write_full(tmp_path), label) for label in ("a", "b")]
    cells = figure_sections(flights)[1]["errors"]["cells"]
    assert [cell["title"] for cell in cells] == ["a: uav1", "b: uav1", "a: uav2", "b: uav2"]


def test_long_lines_are_thinned_but_keep_their_ends() -> None:
    x = np.linspace(0.0, 900.0, 180_001)
    shown = chart_data(Chart("y [m]", (Line("y", "line-0", x, np.sin(x)),)))["lines"][0]
    assert len(shown["x"]) <= MOST_POINTS + 1
    assert points_of_each(1) == MOST_POINTS > points_of_each(6) > points_of_each(1000) > 100
    assert (shown["x"][0], shown["x"][-1]) == (0, 900)


def test_what_is_not_finite_becomes_a_gap() -> None:
    assert numbers(np.array([1.0, np.nan, np.inf, 123456.7])) == [1, None, None, 123460]
