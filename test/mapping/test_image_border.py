# SPDX-License-Identifier: Apache-2.0
import numpy as np

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.mapping.image_border import image_border


def test_the_border_runs_once_around_the_outermost_pixels() -> None:
    border = image_border(PinholeCamera(40, 30, 50.0, 50.0, 19.5, 14.5), 5)
    assert border.shape == (20, 2)
    assert border[[0, 5, 10, 15]].tolist() == [[-0.5, -0.5], [39.5, -0.5], [39.5, 29.5], [-0.5, 29.5]]
    steps = np.roll(border, -1, axis=0) - border
    assert np.unique(np.abs(steps).round(9), axis=0).tolist() == [[0.0, 6.0], [8.0, 0.0]]
