# SPDX-License-Identifier: Apache-2.0
import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from rendered_views import ALTITUDE_M, ground, pose, view

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.flown_map import UNSEEN_GREY, FlownMap
from uav_vslam.mapping.orthomosaic.heights import GridHeights
from uav_vslam.mapping.orthomosaic.in_flight import MOST_WAITING, FlownOrthomosaic
from uav_vslam.mapping.orthomosaic.mosaic import Orthomosaic
from uav_vslam.mapping.summary import MapFrame
from uav_vslam.mapping.surface.grid import HeightGrid

VIEWS = 24


def flown(folder: Path | None = None, *, pixel_m: float = 0.25, views: int = VIEWS) -> FlownMap:
    found = FlownMap(folder, MapFrame("uav1/map", north_up=True), cell_m=1.0, pixel_m=pixel_m)
    for k in range(views):
        found.add(view(k))
    return found


def drawn(found: FlownMap) -> np.ndarray:
    """Return which points have a colour of their own: no ground is grey all over."""
    return (found.coloured()[1] != UNSEEN_GREY).any(axis=1)


def test_cells_have_the_colour_of_the_ground() -> None:
    found = flown()
    found.finish()
    points, bgr = found.coloured()
    assert drawn(found).mean() > 0.95
    x, y = points[:, :2].T
    side = np.linspace(-0.4, 0.4, 5)
    true = np.mean([ground().grey(x + dx, y + dy) for dx in side for dy in side], axis=0)
    assert np.corrcoef(true, bgr[:, 0])[0, 1] > 0.95
    np.testing.assert_array_equal(bgr[:, 0], bgr[:, 2])


def test_a_key_frame_waits_until_the_ground_below_it_is_mapped() -> None:
    found = flown()
    picture = found._picture
    assert picture is not None
    drawn_before = len(picture.mosaic.views)
    assert drawn_before
    latest, position = pose(VIEWS - 1).t, {view(k).stamp_ns: pose(k).t for k in range(VIEWS)}
    assert all(np.linalg.norm(latest - position[each.stamp_ns]) > 0.39 * ALTITUDE_M for each in picture.mosaic.views)
    found.finish()
    assert len(picture.mosaic.views) > drawn_before


def test_key_frames_that_never_settle_do_not_pile_up() -> None:
    picture = FlownOrthomosaic(Orthomosaic(GridHeights(HeightGrid(1.0)), 0.5), settled_ratio=1e6)
    for k in range(2 * MOST_WAITING):
        picture.add(dataclasses.replace(view(0), T_map_cam=pose(8 * k)), 0.0)
    assert len(picture._waiting) == MOST_WAITING


def test_saved_files_are_those_of_the_picture_so_far(tmp_path: Path) -> None:
    found = flown(tmp_path / "map")
    found.save()
    found.finish()
    tree = found.save()
    found.close()
    assert {path.name for path in (tmp_path / "map").iterdir()} == {
        "tiles",
        "height.tif",
        "map.json",
        "orthomosaic.png",
        "orthomosaic.pgw",
        "orthomosaic.jpg",
    }
    assert json.loads((tmp_path / "map" / "map.json").read_text())["orthomosaic"] == tree["orthomosaic"]
    image = cv2.imread(str(tmp_path / "map" / "orthomosaic.png"), cv2.IMREAD_UNCHANGED)
    assert image.shape[:2] == (tree["orthomosaic"]["height"], tree["orthomosaic"]["width"])
    assert (image[..., 3] > 0).mean() > 0.7


def test_without_a_pixel_there_is_no_picture(tmp_path: Path) -> None:
    found = flown(tmp_path / "map", pixel_m=0.0, views=8)
    assert not drawn(found).any()
    assert "orthomosaic" not in found.save()
    with pytest.raises(UavVslamError, match=r"map\.folder is empty"):
        flown(views=0).save()
    assert len(flown(views=0).coloured()[0]) == 0
