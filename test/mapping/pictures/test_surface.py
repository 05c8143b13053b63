# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.errors import PictureError
from uav_vslam.mapping.pictures.surface import PointSurface


def test_no_points_of_pictures_from_one_place_say_so() -> None:
    """Pictures of a hovering vehicle overlap entirely, and were said to overlap too little."""
    with pytest.raises(PictureError, match="overlap too little, or were all taken from one place"):
        PointSurface(np.zeros((0, 3)))
