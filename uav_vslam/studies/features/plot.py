# SPDX-License-Identifier: Apache-2.0
"""Draws the study of features: matches by place, by spacing of images, and by ratio."""

import re
from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from uav_vslam.evaluation.study import Row
from uav_vslam.report.style import LINE_COLOURS, clean, plain_log, save, shared_legend
from uav_vslam.studies.engine.pool import grouped
from uav_vslam.studies.features.compute import FeatureLab
from uav_vslam.studies.features.match_picture import match_picture, save_match_picture
from uav_vslam.studies.features.sets import ImageSet, cross_pairs, usual_pairs

BLACK = "#000000"
COLUMNS = 3
MATCHES_DRAWN = ("SIFT", "SURF")
LEAST = 0.5  # stands for zero matches on the logarithmic axis


def draw_with_matches(
    sets: Sequence[ImageSet], lab: FeatureLab, methods: Sequence[str]
) -> Callable[[dict[str, Any], Path], list[Path]]:
    """Return a function that draws the study and the matches of each set within and between bands."""

    def draw(tree: dict[str, Any], folder: Path) -> list[Path]:
        pairs = [pair for images in sets for pair in [*usual_pairs(images), *cross_pairs(images)]]
        for pair in pairs:
            for method in (method for method in methods if method in MATCHES_DRAWN):
                found, name = lab.match(method, pair), f"{method} {pair.label}".lower()
                images = pair.first.image, pair.second.image
                figure = match_picture(images, (found.first, found.second), found.kept, f"{method}, {pair.label}")
                save_match_picture(folder / "matches" / f"{re.sub(r'[^a-z0-9]+', '_', name)}.png", figure)
        return draw_features(tree, folder)

    return draw


def draw_features(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw what the study holds into its folder and return the paths."""
    tables = {name: [row for row in tree["rows"] if row["table"].startswith(name)] for name in _PLOTS}
    return [save(plot(tables[name]), folder / f"{name.lower()}.png") for name, plot in _PLOTS.items() if tables[name]]


def places_plot(rows: list[Row]) -> Figure:
    """Return bars of matches without (pale) and with RANSAC, and dots of time, by algorithm, a panel for each pair."""
    panels = grouped(rows, lambda row: str(row["condition"]))
    figure, axes = _panels(len(panels))
    for at, (images, group) in zip(axes, panels.items(), strict=False):
        positions = range(len(group))
        colours = [_colours(rows)[row["method"]] for row in group]
        at.bar(positions, [max(row["matches"], LEAST) for row in group], color=colours, alpha=0.35)
        at.bar(positions, [max(row["matches_ransac"], LEAST) for row in group], color=colours)
        at.set_xticks(positions, [row["method"] for row in group], rotation=45, ha="right", fontsize=8)
        at.set_title(images, fontsize=8)
        plain_log(at, "y")
        at.set_ylim(bottom=LEAST)
        clean(at)
    figure.supylabel("Matches, pale without and full with RANSAC")
    return figure


def spacing_plot(rows: list[Row]) -> Figure:
    """Return curves of the matching rate with RANSAC over the spacing, a panel for each set and band."""
    panels = grouped(rows, _sequence)
    figure, axes = _panels(len(panels))
    for at, (sequence, group) in zip(axes, panels.items(), strict=False):
        for method, curve in grouped(group, lambda row: str(row["method"])).items():
            spacings, rates = ([row[key] for row in curve] for key in ("spacing", "rate_1_ransac"))
            colour = _colours(rows)[method]
            at.plot(spacings, rates, color=colour, marker="o", markersize=3.5, linewidth=1.5, label=method)
        at.set_title(f"{sequence} …", fontsize=8)
        at.set_ylim(-0.02, 1.0)
        at.set_xlabel("Images apart")
        at.xaxis.set_major_locator(MaxNLocator(integer=True))
        clean(at)
    shared_legend(figure, axes[:1], ncols=4)
    figure.supylabel("Matches with RANSAC / keypoints of the first image")
    return figure


def threshold_plot(rows: list[Row]) -> Figure:
    """Return curves of matches without (dashed) and with RANSAC over the ratio, a panel for each algorithm."""
    panels = grouped(rows, lambda row: str(row["method"]))
    figure, axes = _panels(len(panels))
    for at, (method, group) in zip(axes, panels.items(), strict=False):
        curves = grouped(group, lambda row: str(row["condition"]))
        for (images, curve), colour in zip(curves.items(), cycle(LINE_COLOURS), strict=False):
            ratios = [row["descriptor_ratio"] for row in curve]
            every, kept = ([max(row[key], LEAST) for row in curve] for key in ("matches", "matches_ransac"))
            at.plot(ratios, every, color=colour, linestyle="--", marker="o", markersize=3)
            at.plot(ratios, kept, color=colour, marker="o", markersize=3, label=images)
        at.set_title(method, fontsize=9)
        at.set_xlabel("Ratio of nearest to second-nearest distance")
        plain_log(at, "y")
        clean(at)
    shared_legend(figure, axes[:1], ncols=2, fontsize=8)
    figure.supylabel("Matches, dashed without and full with RANSAC")
    return figure


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(1.0 + 3.8 * columns, 1.2 + 2.9 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for at in axes[count:]:
        at.set_axis_off()
    return figure, axes


def _sequence(row: Row) -> str:
    """Return the set, band and first image of a pair."""
    return str(row["condition"]).split(" – ")[0]


def _colours(rows: list[Row]) -> dict[str, str]:
    methods = dict.fromkeys(row["method"] for row in rows)
    return dict(zip(methods, (*LINE_COLOURS, BLACK), strict=False))


_PLOTS = {"Places": places_plot, "Spacing": spacing_plot, "Thresholds": threshold_plot}
