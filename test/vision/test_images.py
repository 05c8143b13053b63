# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.errors import InvalidMessage
from uav_vslam.vision.images import quarter, shrink, to_bgr8, to_full_resolution, to_grey8, to_shrunk


def test_a_shrunk_blob_maps_back_to_its_full_resolution_centre():
    rows, columns = np.mgrid[:120, :160]
    image = np.rint(250 * np.exp(-((columns - 70.4) ** 2 + (rows - 50.9) ** 2) / (2 * 8.0**2))).astype(np.uint8)
    small = shrink(image, 0.5)
    weight = small.astype(float)
    v, u = np.mgrid[: small.shape[0], : small.shape[1]]
    centre = np.array([[(u * weight).sum(), (v * weight).sum()]]) / weight.sum()
    np.testing.assert_allclose(to_full_resolution(centre, small.shape, image.shape), [[70.4, 50.9]], atol=0.02)


def test_half_resolution_pixels_are_two_u_plus_a_half():
    full = to_full_resolution(np.array([[0.0, 10.0]]), (48, 64), (96, 128))
    np.testing.assert_allclose(full, [[0.5, 20.5]])


def test_a_rounded_size_sets_the_scale_of_each_axis():
    full = to_full_resolution(np.array([[37.0, 24.0]]), (24, 37), (48, 75))
    np.testing.assert_allclose(full, [[37.5 * 75 / 37 - 0.5, 48.5]])


def test_mapping_to_the_shrunk_image_and_back_changes_nothing():
    pixels = np.random.default_rng(1).uniform(0.0, 75.0, (20, 2))
    there = to_shrunk(pixels, (12, 19), (48, 75))
    np.testing.assert_allclose(to_full_resolution(there, (12, 19), (48, 75)), pixels)


def test_a_quarter_is_the_mean_of_four_by_four_pixels():
    image = np.random.default_rng(2).integers(0, 256, (48, 64), np.uint8)
    means = image.reshape(12, 4, 16, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(quarter(image), means, atol=1.01)  # rounded twice


def test_16_bit_images_of_any_depth_fill_8_bits():
    ramp = np.tile(np.arange(200, 3000, 10, dtype=np.uint16), (40, 1))
    grey = to_grey8(ramp)
    assert grey.dtype == np.uint8
    assert grey.min() == 0
    assert grey.max() == 255
    assert (np.diff(grey.astype(int), axis=1) >= 0).all()


def test_a_uniform_16_bit_image_stays_uniform():
    assert not to_grey8(np.full((32, 32), 900, np.uint16)).any()


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (np.zeros((4, 4)), "image_type"),
        (np.zeros((4, 4, 2), np.uint8), "image_shape"),
        (np.zeros((0, 4), np.uint8), "image_shape"),
    ],
)
def test_other_images_are_rejected_with_a_reason(image, reason):
    with pytest.raises(InvalidMessage) as caught:
        to_grey8(image)
    assert caught.value.reason == reason


def test_a_grey_image_in_colour_has_equal_channels():
    grey = np.arange(60, dtype=np.uint8).reshape(6, 10)
    colour = to_bgr8(grey)
    np.testing.assert_array_equal(colour, np.dstack([grey] * 3))
    np.testing.assert_array_equal(to_bgr8(colour), colour)
    np.testing.assert_array_equal(to_bgr8(grey[:, :, None]), colour)


def test_the_channels_of_a_16_bit_image_are_stretched_equally():
    ramp = np.tile(np.arange(200, 3000, 10, dtype=np.uint16), (40, 1))
    colour = to_bgr8(np.dstack([ramp, ramp // 2, ramp // 4]))
    assert colour.dtype == np.uint8
    assert colour[:, :, 0].max() == 255
    assert colour[:, :, 1].max() < 160


@pytest.mark.parametrize("shape", [(12, 16), (12, 16, 3)])
def test_images_of_any_kind_are_shrunk(shape):
    image = np.full(shape, 40_000, np.uint16)
    small = shrink(image, 0.5)
    assert small.shape == (6, 8, *shape[2:])
    assert small.dtype == np.uint16
    assert (small == 40_000).all()
    with pytest.raises(InvalidMessage):
        shrink(np.zeros((4, 4)), 0.5)
