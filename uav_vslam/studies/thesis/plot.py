# SPDX-License-Identifier: Apache-2.0
"""Draws the thesis's simulation: gains, and trajectory, errors and covariance of an example."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from uav_vslam.report.error_plot import error_plot
from uav_vslam.report.style import save
from uav_vslam.report.views import plan_view
from uav_vslam.studies.engine.fusion_parts import Part
from uav_vslam.studies.engine.fusion_plot import draw_fusion
from uav_vslam.studies.thesis.compute import example
from uav_vslam.studies.thesis.ellipsoid_plot import ellipsoid_plot


def draw_thesis(parts: Sequence[Part], seed: int) -> Callable[[dict[str, Any], Path], list[Path]]:
    """Return a function that draws the study and returns the paths; it re-runs a seed for the figures."""

    def draw(tree: dict[str, Any], folder: Path) -> list[Path]:
        drawn = draw_fusion(tree, folder)
        for part in parts:
            result = example(part, seed)
            for name, plot in (("trajectory", plan_view), ("errors", error_plot), ("covariance", ellipsoid_plot)):
                figure = plot(result)
                if figure is not None:
                    drawn.append(save(figure, folder / f"{part.table.replace(' ', '_')}_{name}.png"))
        return drawn

    return draw
