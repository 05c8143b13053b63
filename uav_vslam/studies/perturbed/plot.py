# SPDX-License-Identifier: Apache-2.0
"""Draws what each error of the calibration costs: ATE beside that of the exact one, and consistency, also over time."""

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uav_vslam.evaluation.consistency import chi_square_band
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.report.style import BAND, LINE_COLOURS, clean, plain_log, save, shared_legend
from uav_vslam.studies.engine.nees_time_plot import nees_over_time
from uav_vslam.studies.engine.pool import grouped

PANELS = {
    "ratio_to_exact": "ATE / that with the exact calibration",
    "nees_position": "Position NEES / 3",
    "nees_rotation": "Attitude NEES / 3",
}
INTERVALS = {"ratio_to_exact": "ratio", "nees_position": "nees_position"}  # of the bootstrap over seeds
MARKERS = ("o", "s", "^", "x")


def draw_perturbed(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw a study into its folder and return the paths."""
    written = [save(cost_plot(tree["rows"]), folder / "perturbed.png")]
    for level, curves in grouped(tree.get("series", []), _level).items():
        # a column for each method, a line for each condition
        turned = [{**curve, "condition": curve["method"], "method": curve["condition"]} for curve in curves]
        written.append(save(nees_over_time(turned), folder / f"nees_{level.replace(' ', '_')}.png"))
    return written


def cost_plot(rows: list[Row]) -> Figure:
    """Return ATE and NEES on logarithmic axes, conditions downwards, a row of panels for each level."""
    levels = grouped(rows, _level)
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    figure = Figure(figsize=(13.0, len(levels) * (1.0 + 0.42 * len(conditions)) + 0.8), layout="constrained")
    grid = figure.subplots(len(levels), len(PANELS), sharey=True, squeeze=False)
    for line, (level, found) in zip(grid, levels.items(), strict=True):
        for axes, (key, title) in zip(line, PANELS.items(), strict=True):
            _draw(axes, found, conditions, key)
            axes.set_xlabel(title)
        line[0].set_title(f"{level}, runs of each mark: {found[0]['runs']}", loc="left", fontsize=10)
    grid[0, 0].set_yticks(range(len(conditions)), conditions)
    grid[0, 0].invert_yaxis()
    shared_legend(figure, grid[0, 1:2], ncols=4)
    return figure


def _draw(axes: Axes, rows: list[Row], conditions: list[str], key: str) -> None:
    clean(axes)
    if key.startswith("nees"):
        axes.axvspan(
            *chi_square_band(rows[0]["runs"]), color=BAND, zorder=0, label="95 % of a consistent filter's mean"
        )
    axes.axvline(1.0, color="black", linewidth=0.9, zorder=1)
    methods = grouped(rows, lambda row: row["method"])
    for number, (method, of_method) in enumerate(methods.items()):
        found = [row for row in of_method if row[key] is not None]
        colour, marker = LINE_COLOURS[number % len(LINE_COLOURS)], MARKERS[number % len(MARKERS)]
        places = [conditions.index(row["condition"]) + 0.16 * (number - 0.5 * (len(methods) - 1)) for row in found]
        axes.plot([row[key] for row in found], places, marker, color=colour, label=method, zorder=3)
        for place, row in zip(places, found, strict=True):
            if f"{INTERVALS.get(key)}_low" in row:
                ends = [row[f"{INTERVALS[key]}_{end}"] for end in ("low", "high")]
                axes.plot(ends, [place] * 2, color=colour, linewidth=1.5, zorder=2)
    plain_log(axes, "x")


def _level(row: Row) -> str:
    return str(row[TABLE])
