# SPDX-License-Identifier: Apache-2.0
"""Pictures of a map name directions and units only as far as they are known."""

from pathlib import Path

import numpy as np
import pytest

from uav_vslam.report.height_picture import MOST_CELLS, draw_ground, frame_of, height_picture, overlap_picture
from uav_vslam.report.mosaic_table import unit_of

BOUNDS = (-10.0, -5.0, 10.0, 5.0)
HEIGHT = np.add.outer(np.arange(10.0), np.arange(20.0))


@pytest.mark.parametrize(
    ("scale", "north", "x", "unit"),
    [
        ("none", False, "x", "units"),
        ("height", False, "x", "m"),
        ("height", True, "East", "m"),
        ("gps", True, "East", "m"),
    ],
)
def test_axes_are_named_as_far_as_they_are_known(scale: str, north: bool, x: str, unit: str) -> None:
    figure = height_picture(HEIGHT, BOUNDS, frame_of(north=north, unit=unit_of(scale)))
    assert figure is not None
    ground, colours = figure.axes
    assert (ground.get_xlabel(), colours.get_ylabel()) == (f"{x} [{unit}]", f"Height [{unit}]")
    (scale_bar,) = ground.texts
    assert scale_bar.get_text().split()[1] == unit
    assert scale_bar.get_path_effects()  # legible on a dark map, too


def test_numbers_of_pictures_have_a_scale_of_colours() -> None:
    counts = np.arange(200).reshape(10, 20) // 100 + 1
    figure = overlap_picture(counts, BOUNDS, frame_of(north=False), label="Pictures")
    assert figure is not None
    colours = figure.axes[1]
    assert colours.get_ylabel() == "Pictures"
    assert all(float(value).is_integer() for value in colours.get_yticks())


def test_a_large_map_is_drawn_with_as_many_cells_as_the_figure_shows() -> None:
    height = np.zeros((MOST_CELLS + 1, 3 * MOST_CELLS - 100), np.float32)
    height[:, :1000] = np.nan
    bounds = (0.0, 0.0, 0.5 * height.shape[1], 0.5 * height.shape[0])
    figure = height_picture(height, bounds, frame_of(north=True))
    assert figure is not None
    (drawn,) = figure.axes[0].images
    assert drawn.get_array().shape[:2] == (-(-height.shape[0] // 3), -(-height.shape[1] // 3))
    west, east, south, north = drawn.get_extent()
    assert (west, south) == (0.0, 0.0)
    assert 0.0 <= east - 0.5 * height.shape[1] < 1.5
    assert 0.0 <= north - 0.5 * height.shape[0] < 1.5
    assert (drawn.get_array()[0, :, 3] == 0.0).sum() == 334  # of 1000 cells, every third


def test_both_are_drawn_into_the_folder(tmp_path: Path) -> None:
    draw_ground(HEIGHT, np.ones(HEIGHT.shape, np.uint16), BOUNDS, frame_of(north=True), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"height.png", "overlap.png"}
