# SPDX-License-Identifier: Apache-2.0
import dataclasses

import cv2
import numpy as np
import pytest

from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.mapping.flight_views import LeftCamera, flight_views
from uav_vslam.mapping.undistortion import Undistorter
from uav_vslam.simulation.rig import kagaru_rig

RIG = kagaru_rig(0.25)
POSES = {k: Pose(so3_exp([0.0, 0.0, 0.1 * k]), np.array([k, 0.0, 70.0])) for k in (1, 2, 4)}
LENSES = {
    "plumb_bob": np.array([-0.3, 0.1, 0.001, -0.002, 0.0]),
    "equidistant": np.array([0.02, -0.01, 0.003, 0.0]),
}


def dots(camera: PinholeCamera) -> tuple[np.ndarray, np.ndarray]:
    """Return ideal pixels, and the distorted image that shows a dot at each."""
    u, v = np.meshgrid(np.linspace(60, 260, 6), np.linspace(50, 190, 5))
    ideal = np.stack([u, v], axis=-1).reshape(-1, 2)
    image = np.zeros((camera.height, camera.width), np.float32)
    y, x = np.indices(image.shape)
    for at in camera.distort(ideal):
        image += 200.0 * np.exp(-0.5 * ((x - at[0]) ** 2 + (y - at[1]) ** 2) / 1.5**2).astype(np.float32)
    return ideal, np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("model", list(LENSES))
def test_a_dot_is_undistorted_to_where_a_pinhole_shows_it(model: str) -> None:
    lens = Undistorter(dataclasses.replace(RIG.left, distortion=LENSES[model], model=model))
    ideal, image = dots(dataclasses.replace(RIG.left, distortion=LENSES[model], model=model))
    found = lens.apply(image).astype(float)
    assert not np.any(lens.camera.distortion)
    for u, v in ideal:
        part = found[int(v) - 5 : int(v) + 6, int(u) - 5 : int(u) + 6]
        y, x = np.indices(part.shape)
        centre = np.array([(x * part).sum(), (y * part).sum()]) / part.sum() + [int(u) - 5, int(v) - 5]
        assert centre == pytest.approx([u, v], abs=0.1)


def test_a_lens_that_leaves_corners_empty_is_zoomed_until_it_does_not() -> None:
    pincushion = dataclasses.replace(RIG.left, distortion=np.array([0.3, 0.0, 0.0, 0.0, 0.0]))
    lens = Undistorter(pincushion)
    assert lens.camera.fx > 1.02 * pincushion.fx
    grey = np.full((pincushion.height, pincushion.width), 200, np.uint8)
    assert (lens.apply(grey) == 200).all()
    at = np.array([[200.0, 100.0], [60.0, 200.0]])  # seen where the zoomed pinhole says
    seen = pincushion.distort(pincushion.project(lens.camera.bearings(at)))
    image = np.zeros_like(grey)
    for u, v in np.rint(seen).astype(int):
        image[v - 1 : v + 2, u - 1 : u + 2] = 255
    found = lens.apply(image)
    for u, v in at.astype(int):
        assert found[v - 2 : v + 3, u - 2 : u + 3].max() > 200


def test_an_image_without_distortion_is_passed_on() -> None:
    image = np.zeros((240, 320), np.uint8)
    assert Undistorter(RIG.left).apply(image) is image


def test_views_have_the_pose_of_the_left_camera_and_frames_without_pose_are_left_out() -> None:
    image = np.arange(240 * 320, dtype=np.uint32).reshape(240, 320).astype(np.uint8)
    views = list(flight_views("uav1", RIG, POSES, [(k, image) for k in range(5)]))
    assert [view.stamp_ns for view in views] == [1, 2, 4]
    for view in views:
        assert view.T_map_cam.t == pytest.approx(POSES[view.stamp_ns].apply(RIG.T_body_left.t))
        assert np.array_equal(view.image, image)


def test_colour_stays_and_sixteen_bits_become_eight() -> None:
    colour = np.zeros((240, 320, 3), np.uint8)
    deep = cv2.resize(np.arange(1200, dtype=np.uint16).reshape(30, 40) * 50, (320, 240))
    (one, two) = flight_views("uav1", RIG, POSES, [(1, colour), (2, deep)])
    assert one.image.shape == (240, 320, 3)
    assert two.image.dtype == np.uint8


@pytest.mark.parametrize("shape", [(120, 160), (480, 640, 3), (320, 240)])
@pytest.mark.parametrize("model", ["none", *LENSES])
def test_an_image_of_another_size_than_the_calibration_is_refused(model: str, shape: tuple[int, ...]) -> None:
    lens = {} if model == "none" else {"distortion": LENSES[model], "model": model}
    rig = dataclasses.replace(RIG, left=dataclasses.replace(RIG.left, **lens))
    with pytest.raises(InvalidMessage, match=r"left image is .* px but its calibration is for \(320, 240\) px"):
        LeftCamera("uav1", rig).view(1, np.zeros(shape, np.uint8), POSES[1])
