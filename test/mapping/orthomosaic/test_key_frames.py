# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import cv2
import numpy as np
import pytest
from flown_scene import CAMERA, Scene

from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.orthomosaic.footprint import footprint, outline, overlap
from uav_vslam.mapping.orthomosaic.key_frames import KeyFrames

SCENE = Scene()
VIEW = SCENE.view((0.0, 0.0, 32.0))


def at(x_m: float, *, blur: int = 1) -> object:
    image = cv2.blur(VIEW.image, (blur, blur))
    return replace(VIEW, T_map_cam=Pose(VIEW.T_map_cam.R, np.array([x_m, 0.0, 32.0])), image=image)


def test_a_key_frame_comes_when_the_overlap_falls_below_the_limit() -> None:
    keys = KeyFrames()
    taken = [x for x in range(40) if keys.takes(at(float(x)), 0.0)]
    assert taken == [0, 10, 20, 30]  # an image is 32 m wide: 10 m leave 0.69


def test_a_blurred_image_is_passed_over_for_the_next_sharp_one() -> None:
    keys = KeyFrames()
    taken = [x for x in range(14) if keys.takes(at(float(x), blur=15 if x in (10, 11) else 1), 0.0)]
    assert taken == [0, 12]


def test_outline_and_overlap_of_a_level_view_are_those_of_rectangles() -> None:
    corners = outline(CAMERA, VIEW.T_map_cam, 0.0)
    assert np.ptp(corners, axis=0) == pytest.approx([32.0, 24.0])
    assert overlap(corners, corners + np.array([8.0, 6.0])) == pytest.approx(0.75 * 0.75, abs=1e-3)
    assert overlap(corners, corners + np.array([80.0, 6.0])) == 0.0


def test_a_footprint_contains_all_that_is_seen_of_a_hilly_surface() -> None:
    hills = Scene(lambda x, y: 4.0 * np.sin(0.2 * x))
    view = hills.view((5.0, 3.0, 30.0), (8.0, -12.0, 30.0))
    raster = footprint(view.camera, view.T_map_cam, hills, 0.5)
    x, y = np.meshgrid(np.arange(-60.0, 60.0), np.arange(-60.0, 60.0))
    pixels = CAMERA.project(view.T_map_cam.inverse().apply(np.stack([x, y, hills.surface(x, y)], axis=-1)))
    seen = ((pixels > 0) & (pixels < [320, 240])).all(axis=-1)
    west, south, east, north = raster.bounds_m
    assert seen.sum() > 100
    assert ((x > west) & (x < east) & (y > south) & (y < north))[seen].all()
