# SPDX-License-Identifier: Apache-2.0
"""Draws the association study: precision, recall, ATE and time of each method."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from uav_vslam.evaluation.study import Row
from uav_vslam.report.style import LINE_COLOURS, clean, plain_log, save, shared_legend

MARKERS = ("o", "s", "D", "^", "v")
MAP_PANELS = {"precision": "Precision", "recall": "Recall", "ate_rms_m": "ATE [m]", "ms_association": "Time [ms]"}
IMAGE_PANELS = {"precision": "Precision", "recall": "Recall", "ms_per_pair": "Time [ms]"}


def draw_association(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw a picture per table into the study's folder and return the paths."""
    in_map = [row for row in tree["rows"] if "pairs_per_frame" in row]
    in_images = [row for row in tree["rows"] if "ms_per_pair" in row]
    pictures = {"association.png": (in_map, MAP_PANELS), "matching.png": (in_images, IMAGE_PANELS)}
    return [save(dot_plot(rows, panels), folder / name) for name, (rows, panels) in pictures.items() if rows]


def dot_plot(rows: list[Row], panels: dict[str, str]) -> Figure:
    """Return a panel per figure with a line per method and a mark per condition.

    Args:
        rows: of one table.
        panels: heading by key of the rows.
    """
    methods = list(dict.fromkeys(row["method"] for row in rows))
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    figure = Figure(figsize=(3.2 * len(panels) + 1.0, 0.34 * len(methods) + 1.6), layout="constrained")
    for axes, (key, heading) in zip(figure.subplots(1, len(panels), sharey=True), panels.items(), strict=True):
        for number, condition in enumerate(conditions):
            shown = [r for r in rows if r["condition"] == condition and r.get(key) is not None]
            axes.plot(
                [row[key] for row in shown],
                [methods.index(row["method"]) for row in shown],
                MARKERS[number % len(MARKERS)],
                color=LINE_COLOURS[number % len(LINE_COLOURS)],
                markersize=6,
                alpha=0.85,
                label=condition,
            )
        axes.set(xlabel=heading, yticks=range(len(methods)), yticklabels=methods, ylim=(len(methods) - 0.5, -0.5))
        if key.startswith(("ms", "ate")):
            plain_log(axes, "x")
        clean(axes)
    shared_legend(figure, [axes], ncols=3)
    return figure
