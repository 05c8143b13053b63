# SPDX-License-Identifier: Apache-2.0
import cv2
import numpy as np
import pytest

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.mapping.pictures.views import STRIP_ROWS, undistortion


@pytest.mark.parametrize("k1", [-0.08, 0.06])
def test_a_ray_meets_the_same_spot_in_both_images(k1: float) -> None:
    lens = np.array([k1, 0.0, 0.0, 0.0, 0.0])
    camera = PinholeCamera(400, 2 * STRIP_ROWS + 90, 700.0, 700.0, 199.5, 300.5, lens)
    ideal, maps = undistortion(camera)
    columns, rows = (np.arange(count, dtype=np.float32) for count in (camera.width, camera.height))
    u, v = np.meshgrid(columns, rows)
    drawn = np.stack([cv2.remap(axis, *maps, cv2.INTER_LINEAR) for axis in (u, v)], axis=-1)  # where each pixel is from
    at = np.array([[20, 20], [380, STRIP_ROWS - 1], [380, STRIP_ROWS], [5, 2 * STRIP_ROWS], [200, camera.height - 9]])
    expected = camera.distort(camera.project(ideal.bearings(at.astype(float))))
    np.testing.assert_allclose(drawn[at[:, 1], at[:, 0]], expected, atol=1.0 / 32.0 + 1e-3)  # of OpenCV's fixed point
    corners = np.array([[0.0, 0.0], [camera.width - 1.0, camera.height - 1.0]])
    inside = camera.distort(camera.project(ideal.bearings(corners)))
    assert (inside >= -0.6).all()
    assert (inside <= np.array([camera.width, camera.height]) - 0.4).all()
