# SPDX-License-Identifier: Apache-2.0
"""The figures of a map: what `map.json` holds of its surface and its views."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from uav_vslam.mapping.overlap import Overlap
from uav_vslam.mapping.surface.grid import HeightGrid


@dataclass(frozen=True, slots=True)
class MapFrame:
    """The frame of a map, z up.

    Attributes:
        name: as the nodes publish it.
        north_up: its y axis points north; it does not where the start state defines the frame, or a yaw is given.
    """

    name: str
    north_up: bool


def map_figures(grid: HeightGrid, overlap: Overlap, views: Mapping[str, int], frame: MapFrame) -> dict[str, Any]:
    """Return the tree of `map.json`, in metres and in the map frame.

    Coverage is the share of the cells which some view shows, over a surface without anything that stands, that have
    a height; `filled` is the share of the cells with a height that are gaps.

    Args:
        grid: the surface.
        overlap: of all views.
        views: their number by vehicle.
        frame: of the grid.
    """
    extent, counts = overlap.count(grid)
    shown = counts > 0
    covered = filled = 0
    sigmas, heights = [], []
    for part in grid.parts(extent):
        known = np.isfinite(part.height)
        covered += int((known & shown[part.raster.within(extent)]).sum())
        filled += int(part.filled.sum())
        sigmas.append(part.sigma[np.isfinite(part.sigma)])
        heights.append(part.height[known])
    cells = sum(map(len, heights))
    height = np.concatenate(heights) if cells else None
    gsd_m = float("nan") if height is None else overlap.gsd_m(float(np.median(height)))
    tree: dict[str, Any] = {
        "frame": frame.name,
        "north_up": frame.north_up,
        "cell_m": grid.cell_m,
        "gsd_m": gsd_m if np.isfinite(gsd_m) else None,
        "bounds_m": list(extent.bounds_m),
        "vehicles": {vehicle: {"views": count} for vehicle, count in views.items()},
        "surface": {
            "cells": cells,
            "coverage": covered / max(int(shown.sum()), 1),
            "filled": filled / max(cells, 1),
        },
    }
    if height is not None:
        tree["surface"]["median_sigma_m"] = float(np.median(np.concatenate(sigmas)))
        tree["surface"]["height_m"] = [float(height.min()), float(height.max())]
    return tree
