# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.mapping.pictures.raw_values import RawValues


@pytest.mark.parametrize(
    "image",
    [np.arange(36).reshape(3, 4, 3).astype(np.uint8), np.full((3, 4), 7, np.uint16), np.zeros((3, 4), np.uint16)],
    ids=["8 bits", "one value", "black"],
)
def test_an_image_without_a_range_gives_no_levels(image: np.ndarray) -> None:
    values = RawValues()
    values.add("camera", image)
    assert values.levels("camera") is None


def test_levels_are_those_of_all_images_of_a_camera() -> None:
    values = RawValues()
    for top in (1000, 4000):
        values.add("camera", np.linspace(0, top, 10_000).reshape(100, 100).astype(np.uint16))
    assert values.levels("camera") == (0.0, pytest.approx(3960.0, rel=0.01))  # the brightest half percent of both
    assert values.levels("another") is None
