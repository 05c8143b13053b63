# SPDX-License-Identifier: Apache-2.0
"""Overlap of downward views over flat ground is that of their footprints."""

import numpy as np
import pytest

from uav_vslam.evaluation.overlap import LARGEST_VIEW_ANGLE_DEG, View, overlap_of
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy

HEIGHT_M = 50.0
CAMERA = PinholeCamera(400, 200, 400.0, 400.0, 200.0, 100.0)
FOOTPRINT_M = 50.0, 25.0  # across and along the image's columns, from that height
R_DOWN = rotation_from_rpy(np.pi, 0.0, 0.0)  # x forward, y to the right, z down
GRID = np.stack(np.meshgrid(np.arange(5.0, 400.0, 10.0), np.arange(5.0, 200.0, 10.0)), axis=-1).reshape(-1, 2)


def view(x_m: float, *, height_m: float = HEIGHT_M, heading_deg: float = 0.0, stamp_ns: int = 0) -> View:
    """Return what a camera that looks down on the ground z = 0 sees, a point every ten pixels."""
    R = rotation_from_rpy(0.0, 0.0, np.deg2rad(heading_deg)) @ R_DOWN
    T_world_cam = Pose(R, np.array([x_m, 0.0, height_m]))
    return View(stamp_ns, T_world_cam, T_world_cam.apply(height_m * CAMERA.bearings(GRID)))


@pytest.mark.parametrize("shift_m", [0.0, 10.0, 40.0, 60.0])
def test_the_share_is_that_of_the_footprints(shift_m: float) -> None:
    found = overlap_of([view(0.0), view(shift_m)], CAMERA)
    expected = max(0.0, 1.0 - shift_m / FOOTPRINT_M[0])
    np.testing.assert_allclose(found.share, [[1.0, expected], [expected, 1.0]], atol=1e-12)


def test_a_higher_view_sees_all_of_a_lower_one_and_not_the_reverse() -> None:
    found = overlap_of([view(0.0), view(0.0, height_m=2 * HEIGHT_M)], CAMERA)
    np.testing.assert_allclose(found.share, [[1.0, 1.0], [0.25, 1.0]], atol=0.02)


@pytest.mark.parametrize(("heading_deg", "difference_deg"), [(180.0, 180.0), (-30.0, 30.0), (190.0, 170.0)])
def test_the_heading_differs_by_the_turn_about_the_vertical(heading_deg: float, difference_deg: float) -> None:
    found = overlap_of([view(0.0), view(0.0, heading_deg=heading_deg)], CAMERA)
    assert found.heading_deg[0, 1] == pytest.approx(difference_deg)
    assert found.view_angle_deg[0, 1] == pytest.approx(0.0, abs=1e-5)  # the camera is at the same place


def test_the_viewing_angle_is_that_at_the_point() -> None:
    ahead, aside = view(0.0), view(20.0)
    one = View(0, ahead.T_world_cam, np.array([[10.0, 0.0, 0.0]]))  # half-way between the two cameras
    found = overlap_of([one, aside], CAMERA)
    assert found.view_angle_deg[0, 1] == pytest.approx(2.0 * np.degrees(np.arctan(10.0 / HEIGHT_M)))
    assert np.isnan(overlap_of([view(0.0), view(500.0)], CAMERA).view_angle_deg[0, 1])


@pytest.mark.parametrize(("beyond_deg", "share"), [(-1.0, 1.0), (1.0, 0.0)])
def test_a_point_seen_from_another_side_does_not_count(beyond_deg: float, share: float) -> None:
    """A camera that looks obliquely at the point below the other one."""
    angle = np.deg2rad(LARGEST_VIEW_ANGLE_DEG + beyond_deg)
    R = rotation_from_rpy(0.0, angle, 0.0) @ R_DOWN
    oblique = Pose(R, -HEIGHT_M * R[:, 2])
    views = [View(0, pose, np.zeros((1, 3))) for pose in (view(0.0).T_world_cam, oblique)]
    np.testing.assert_array_equal(overlap_of(views, CAMERA).share, [[1.0, share], [share, 1.0]])


def test_a_point_behind_a_camera_does_not_count() -> None:
    upward = Pose(rotation_from_rpy(0.0, np.pi, 0.0) @ R_DOWN, np.array([0.0, 0.0, HEIGHT_M]))
    views = [View(0, pose, np.zeros((1, 3))) for pose in (view(0.0).T_world_cam, upward)]
    assert overlap_of(views, CAMERA).share[0, 1] == 0.0


@pytest.mark.parametrize(
    ("model", "distortion"),
    [("plumb_bob", [-0.28, 0.07, 0.0, 0.0, 0.0]), ("plumb_bob", [0.2, 0, 0, 0, 0]), ("equidistant", [0.01, 0, 0, 0])],
)
def test_all_of_an_image_is_seen_in_itself_through_any_lens(model: str, distortion: list[float]) -> None:
    lens = PinholeCamera(400, 300, 250.0, 250.0, 200.0, 150.0, np.array(distortion), model)
    pixels = np.stack(np.meshgrid(np.arange(2.0, 400.0, 12.0), np.arange(2.0, 300.0, 12.0)), axis=-1).reshape(-1, 2)
    T_world_cam = Pose(R_DOWN, np.array([0.0, 0.0, HEIGHT_M]))
    points = T_world_cam.apply(HEIGHT_M * lens.bearings(lens.undistort(pixels)))
    assert overlap_of([View(0, T_world_cam, points)], lens).share[0, 0] == 1.0
    far = View(0, T_world_cam, T_world_cam.apply(HEIGHT_M * np.array([[30.0, 0.0, 1.0]])))  # where models fold over
    assert overlap_of([far], lens).share[0, 0] == 0.0


def test_views_without_points_share_nothing() -> None:
    blind = View(0, view(0.0).T_world_cam, np.zeros((0, 3)))
    found = overlap_of([blind, view(0.0)], CAMERA)
    np.testing.assert_array_equal(found.share, [[0.0, 0.0], [1.0, 1.0]])
    assert len(overlap_of([], CAMERA)) == 0
