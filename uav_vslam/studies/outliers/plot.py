# SPDX-License-Identifier: Apache-2.0
"""Draws the study of wrong matches: end error and consistency over their share."""

from itertools import cycle
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from uav_vslam.evaluation.consistency import chi_square_band
from uav_vslam.evaluation.study import Row
from uav_vslam.report.style import BAND, LINE_COLOURS, clean, column, plain_log, save
from uav_vslam.studies.engine.pool import grouped
from uav_vslam.studies.outliers.compute import CLEAN

KIND_DASHES = {"swapped": "--", "lookalike": "-"}
ALLOWED_RATIO = 1.3  # of the end error with a tenth of the matches wrong


def draw_outliers(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw what the study holds into its folder and return the path."""
    return [save(outlier_plot(tree["rows"]), folder / "outliers.png")] if tree["rows"] else []


def outlier_plot(rows: list[Row]) -> Figure:
    """Return end error, as a multiple of the clean one, and NEES over the share of wrong matches."""
    figure = Figure(figsize=(11.0, 4.8), layout="constrained")
    errors, nees = figure.subplots(1, 2, sharex=True)
    methods = grouped(rows, lambda row: row["method"])
    for (method, of_method), colour in zip(methods.items(), cycle(LINE_COLOURS), strict=False):
        for kind, dashes in KIND_DASHES.items():
            curve = [row for row in of_method if row["kind"] in (kind, CLEAN)]
            percent = [100.0 * row["wrong_match_share"] for row in curve]
            style = {"color": colour, "linestyle": dashes, "marker": "o", "linewidth": 1.6}
            errors.plot(percent, column(curve, "end_ratio_to_clean"), label=f"{method}, {kind}", **style)
            nees.plot(percent, column(curve, "nees_position"), **style)
    errors.axhline(ALLOWED_RATIO, color="#888888", linewidth=0.8, linestyle=":", label=f"allowed: {ALLOWED_RATIO:g}")
    low, high = chi_square_band(rows[0]["runs"])
    nees.axhspan(low, high, color=BAND, zorder=0, label=f"consistent: {low:.2f} to {high:.2f}")
    errors.set(ylabel="End error / that without wrong matches", xlabel="Wrong matches [%]")
    nees.set(ylabel="Position NEES / 3", xlabel="Wrong matches [%]")
    for axes in (errors, nees):
        plain_log(axes, "y")
        clean(axes)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, handlelength=3.5)
    return figure
