# SPDX-License-Identifier: Apache-2.0
"""The contract of every extractor."""

import cv2
import numpy as np
import pytest

from uav_vslam.config import FrontendConfig
from uav_vslam.vision.features import EXTRACTORS

CONFIG = FrontendConfig(max_features=200)


@pytest.fixture(params=sorted(EXTRACTORS))
def extractor(request):
    return EXTRACTORS[request.param](CONFIG)


def test_points_come_strongest_first_and_capped(extractor, texture_image):
    found = extractor.detect(texture_image(240, 320))
    assert len(found) == CONFIG.max_features
    assert (np.diff(found.responses) <= 0).all()
    assert found.pixels.shape == (200, 2)
    assert found.pixels.dtype == np.float32
    assert found.descriptors.dtype == np.uint8
    assert len(found.descriptors) == len(found.responses) == 200
    assert ((found.pixels >= -0.5) & (found.pixels <= [319.5, 239.5])).all()


def test_an_image_without_texture_has_no_points(extractor):
    found = extractor.detect(np.full((64, 64), 77, np.uint8))
    assert found.pixels.shape == (0, 2)
    assert found.descriptors.shape[0] == 0
    assert found.descriptors.shape[1] > 0


def test_detection_repeats_and_leaves_the_image_alone(extractor, texture_image):
    image = texture_image(240, 320)
    before = image.copy()
    first, second = extractor.detect(image), extractor.detect(image)
    np.testing.assert_array_equal(image, before)
    assert first.pixels.tobytes() == second.pixels.tobytes()
    assert first.descriptors.tobytes() == second.descriptors.tobytes()


@pytest.mark.parametrize("sigma", [2.0, 5.0, 12.0])
def test_a_blob_is_found_at_its_centre_at_any_size(sigma):
    rows, columns = np.mgrid[:200, :200]
    u, v = 100.3, 95.8
    image = np.rint(60 + 150 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2 * sigma**2))).astype(np.uint8)
    found = EXTRACTORS["sift"](FrontendConfig()).detect(image)
    # OpenCV's default upscaling is off by 0.25 px.
    np.testing.assert_allclose(found.pixels[0], [u, v], atol=0.05)


def test_sift_descriptors_are_the_integers_that_opencv_computes_in_float(texture_image):
    image = texture_image(240, 320)
    found = EXTRACTORS["sift"](CONFIG).detect(image)
    reference = cv2.SIFT_create(200, 3, CONFIG.contrast_threshold, 10, 1.6, cv2.CV_32F, True)
    points, descriptors = reference.detectAndCompute(image, None)
    expected = {tuple(row) for row in descriptors}
    assert (descriptors == np.rint(descriptors)).all()
    assert {tuple(row) for row in found.descriptors.astype(np.float32)} <= expected
    assert len(points) >= len(found)
