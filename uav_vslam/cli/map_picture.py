# SPDX-License-Identifier: Apache-2.0
"""The orthomosaic and the model of `uav-vslam map`, over its height grid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from uav_vslam.cli.messages import warn
from uav_vslam.cli.progress import progress_bar

if TYPE_CHECKING:
    from uav_vslam.cli.map_inputs import MappedFlight
    from uav_vslam.evaluation.files.geodetic import Datum
    from uav_vslam.mapping.raster import Raster
    from uav_vslam.mapping.surface.grid import HeightGrid
    from uav_vslam.mapping.view import View

PIXEL_M, PIXEL_STEP_M = 0.1, 0.05
MOST_PIXELS = 200_000_000  # of the default: some 3 GB while the picture is written
PASSES = 3  # over the key frames: brightness, picture, seams and walls


def default_pixel_m(extent: Raster) -> float:
    """Return the side of a pixel [m] with which a picture of an area fits into the memory; warn if it is large."""
    west, south, east, north = extent.bounds_m
    area_m2 = (east - west) * (north - south)
    if area_m2 <= PIXEL_M**2 * MOST_PIXELS:
        return PIXEL_M
    pixel_m = round(PIXEL_STEP_M * math.ceil(math.sqrt(area_m2 / MOST_PIXELS) / PIXEL_STEP_M), 2)
    megapixels = area_m2 / PIXEL_M**2 / 1e6
    warn(
        f"pixels of the orthomosaic are {pixel_m:g} m wide, as {PIXEL_M:g} m would make {megapixels:.0f} megapixels; "
        "--pixel M chooses"
    )
    return pixel_m


def write_picture_and_model(
    flights: list[MappedFlight], grid: HeightGrid, folder: Path, pixel_m: float, datum: Datum | None
) -> dict[str, Any]:
    """Write the orthomosaic, with pixels of a side [m], and the model; return their parts of `map.json`.

    Raises:
        UavVslamError: no view shows the surface.
    """
    from uav_vslam.mapping.model import write_model
    from uav_vslam.mapping.orthomosaic import blended_mosaic
    from uav_vslam.mapping.orthomosaic.heights import GridHeights
    from uav_vslam.mapping.orthomosaic.output import write_orthomosaic
    from uav_vslam.mapping.orthomosaic.seams import seams
    from uav_vslam.mapping.progress import counted

    stamps, colour = _key_frames(flights, grid)
    surface = GridHeights(grid)

    def views() -> Iterator[View]:
        return _chosen(flights, stamps, colour=colour)

    with TemporaryDirectory(dir=folder, prefix="tiles_") as tiles:
        with progress_bar("orthomosaic", PASSES * len(stamps)) as advance:
            mosaic = blended_mosaic(views, surface, pixel_m, folder=Path(tiles), on_view=advance)
            picture = mosaic.picture()
            found = seams(mosaic, picture, counted(views(), advance)).figures()
        written = write_orthomosaic(mosaic, picture, folder, datum)
        model = write_model(surface, picture, folder, views=views(), cell_m=grid.cell_m)
        shares = mosaic.shares()
    finite = {name: value for name, value in found.items() if np.isfinite(value)}
    figures = written | {"seam_px": finite.get("median_px"), "seam_p90_px": finite.get("p90_px")}
    return {"orthomosaic": figures, "model": model, "shares": shares}


def _key_frames(flights: list[MappedFlight], grid: HeightGrid) -> tuple[set[tuple[str, int]], bool]:
    """Return vehicle and stamp of the views that the picture is made of, and whether any of them is in colour."""
    from uav_vslam.mapping.orthomosaic import KeyFrames

    ground_m = float(np.nanmedian(grid.height(grid.extent))) if grid.extent.columns else 0.0
    chosen: set[tuple[str, int]] = set()
    colour = False
    with progress_bar("key frames", sum(len(flight) for flight in flights)) as advance:
        for flight in flights:
            keys = KeyFrames()
            for view in flight.views():
                if keys.takes(view, ground_m):
                    chosen.add((view.vehicle, view.stamp_ns))
                    colour |= view.image.ndim == 3
                advance()
    return chosen, colour


def _chosen(flights: list[MappedFlight], stamps: set[tuple[str, int]], *, colour: bool) -> Iterator[View]:
    """Yield the chosen views, grey ones converted if the picture is in colour; no other images are read."""
    for flight in flights:
        name = flight.flight.vehicle
        views = replace(flight, poses={k: T for k, T in flight.poses.items() if (name, k) in stamps}).views()
        yield from (view.in_colour() if colour else view for view in views)
