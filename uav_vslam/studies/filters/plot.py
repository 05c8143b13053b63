# SPDX-License-Identifier: Apache-2.0
"""Draws the study of the filters: error and consistency of each, and the relative error rate over noise scales."""

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uav_vslam.evaluation.consistency import chi_square_band
from uav_vslam.evaluation.study import Row
from uav_vslam.report.style import BAND, clean, column, plain_log, save
from uav_vslam.studies.engine.pool import grouped

Tree = dict[str, Any]

FILTER_STYLES = {  # colour, marker, width: equal filters overlap, so the first are drawn broad
    "eif": ("#0072b2", "o", 5.0),
    "ekf": ("#56b4e9", "s", 1.6),
    "uhf": ("#d55e00", "^", 5.0),
    "ukf": ("#f0a500", "v", 1.6),
    "thesis_uhf": ("#555555", "x", 2.0),
    "thesis_ukf": ("#999999", "d", 2.0),
}
MODEL_DASHES = {"ri15": "-", "so15": "-.", "euler9": "--"}


def draw_filters(tree: Tree, folder: Path) -> list[Path]:
    """Draw what the study holds into its folder and return the paths."""
    consistency = [row for row in tree["rows"] if "end_ratio_to_batch" in row]
    scales = [row for row in tree["rows"] if "rer" in row]
    paths = []
    if consistency:
        paths.append(save(consistency_plot(consistency), folder / "consistency.png"))
    for extractor, chosen in grouped(scales, lambda row: str(row["extractor"])).items():
        paths.append(save(noise_plot(chosen), folder / f"noise_scales_{extractor.lower()}.png"))
    return paths


def consistency_plot(rows: list[Row]) -> Figure:
    """Return errors and NEES of each method on logarithmic axes, methods downwards."""
    figure = Figure(figsize=(11.0, 1.6 + 0.36 * len(rows)), layout="constrained")
    errors, nees = figure.subplots(1, 2, sharey=True)
    _dots(errors, rows, "ate_rms_m", "o", "#0072b2", "ATE")
    _dots(errors, rows, "end_rms_m", "D", "#d55e00", "at the end")
    _dots(nees, rows, "nees_position", "o", "#0072b2", "mean over the flight")
    _dots(nees, rows, "nees_position_end", "D", "#d55e00", "at the end")
    low, high = chi_square_band(rows[0]["runs"])
    nees.axvspan(low, high, color=BAND, zorder=0, label=f"consistent: {low:.2f} to {high:.2f}")
    for place, row in enumerate(rows):
        if row["failures"]:
            note = f"{row['failures']} of {row['runs']} failed"
            nees.annotate(note, (1.0, place), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8)
    errors.set(xlabel="Position error, root mean square [m]", yticks=range(len(rows)))
    errors.set_yticklabels([row["method"] for row in rows])
    errors.set_ylim(len(rows) - 0.5, -0.5)
    nees.set(xlabel="Position NEES / 3")
    for axes in (errors, nees):
        plain_log(axes, "x")
        clean(axes)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=9)
    return figure


def noise_plot(rows: list[Row]) -> Figure:
    """Return relative error rate and NEES of each method over the noise scales."""
    figure = Figure(figsize=(11.0, 5.4), layout="constrained")
    rates, nees = figure.subplots(1, 2, sharex=True)
    scales = list(dict.fromkeys(row["condition"] for row in rows))
    for method, of_method in grouped(rows, lambda row: row["method"]).items():
        by_scale = {row["condition"]: row for row in of_method}
        found = [by_scale[scale] for scale in scales]
        missing = all(row["rer"] is None for row in found)
        label = f"{method} (fails)" if missing else method
        rates.plot(scales, column(found, "rer"), label=label, **_line(method))
        nees.plot(scales, column(found, "nees_position"), **_line(method))
    low, high = chi_square_band(rows[0]["runs"])
    nees.axhspan(low, high, color=BAND, zorder=0, label=f"consistent: {low:.2f} to {high:.2f}")
    rates.set(ylabel="Relative error rate, SLAM / INS", xlabel="Noise scale")
    nees.set(ylabel="Position NEES / 3", xlabel="Noise scale")
    for axes in (rates, nees):
        plain_log(axes, "y")
        clean(axes)
    figure.legend(loc="outside lower center", ncols=6, frameon=False, handlelength=3.5, fontsize=9)
    return figure


def _dots(axes: Axes, rows: list[Row], key: str, marker: str, colour: str, label: str) -> None:
    axes.plot(column(rows, key), range(len(rows)), marker, color=colour, label=label, markersize=6, alpha=0.9)


def _line(method: str) -> dict[str, Any]:
    model, _, name = method.partition(" ")
    colour, marker, width = FILTER_STYLES.get(name, ("#000000", ".", 1.5))
    return {
        "color": colour,
        "marker": marker,
        "linewidth": width,
        "linestyle": MODEL_DASHES.get(model, ":"),
        "markersize": 4.0 + width,
        "alpha": 0.9,
    }
