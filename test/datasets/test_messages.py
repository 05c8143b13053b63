# SPDX-License-Identifier: Apache-2.0
"""Images of every encoding decode to the picture that was recorded."""

import dataclasses
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from uav_vslam.datasets.message_builders import camera_info_message, image_message
from uav_vslam.datasets.messages import ENCODINGS, camera_of, image_of, rectified_camera_of
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.geometry.camera import PinholeCamera

BGR = np.zeros((8, 12, 3), np.uint8)
BGR[..., 0], BGR[..., 1], BGR[..., 2] = 40, 90, 200  # one colour: Bayer interpolation leaves it as it is
YUV_GREY = 3  # grey levels that 8 bits of luminance and colour differences lose


def mosaic(pattern: str) -> np.ndarray[Any, Any]:
    """Return the colour's Bayer mosaic; `pattern` names the first two pixels of the first two rows."""
    value = {"b": 40, "g": 90, "r": 200}
    tile = np.array([value[letter] for letter in pattern], np.uint8).reshape(2, 2)
    return np.tile(tile, (4, 6))


def packed_yuv(*, luminance_first: bool) -> np.ndarray[Any, Any]:
    """Return the colour with a blue and a red difference in turn, as cameras send it."""
    Y, V, U = cv2.cvtColor(BGR, cv2.COLOR_BGR2YCrCb)[0, 0].astype(float)
    Y, U, V = 16 + Y * 219 / 255, 128 + (U - 128) * 224 / 255, 128 + (V - 128) * 224 / 255  # BT.601, video range
    pair = [[Y, U], [Y, V]] if luminance_first else [[U, Y], [V, Y]]
    return np.tile(np.rint(pair).astype(np.uint8), (8, 6, 1))


def recorded(encoding: str) -> Any:
    kind, channels, _ = ENCODINGS[encoding]
    if encoding.startswith("bayer"):
        pixels = mosaic(encoding.removeprefix("bayer_")[:4]).astype(kind)
    elif channels == 1:
        pixels = np.arange(96, dtype=kind).reshape(8, 12)
    elif channels == 2:
        pixels = packed_yuv(luminance_first=encoding.startswith("yuy") or encoding.endswith("yuy2"))
    else:
        order = {"rgb": [2, 1, 0], "bgr": [0, 1, 2]}["rgb" if encoding.startswith("rgb") else "bgr"]
        pixels = np.concatenate([BGR[..., order], np.full((8, 12, channels - 3), 255)], axis=-1).astype(kind)
    data = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
    blank = image_message(0, "camera", np.zeros((8, 12), np.uint8))
    return dataclasses.replace(blank, encoding=encoding, step=12 * channels * np.dtype(kind).itemsize, data=data)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_encoding_gives_the_recorded_picture(encoding: str) -> None:
    kind, channels, conversion = ENCODINGS[encoding]
    image = image_of(recorded(encoding))
    assert image.dtype == kind
    if channels == 1 and conversion is None:
        np.testing.assert_array_equal(image, np.arange(96).reshape(8, 12))
    else:
        np.testing.assert_allclose(image, BGR, atol=YUV_GREY if channels == 2 else 0)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_empty_image_is_refused_as_any_other_that_can_not_be_read(encoding: str) -> None:
    """OpenCV would raise an error of its own, which ends a run or a node."""
    empty = dataclasses.replace(recorded(encoding), width=0, height=0, step=0, data=np.zeros(0, np.uint8))
    with pytest.raises(BagError, match="0x0 px is empty"):
        image_of(empty)


def test_pixels_that_share_their_colour_come_in_pairs() -> None:
    with pytest.raises(BagError, match="11 px wide can't be yuyv"):
        image_of(dataclasses.replace(recorded("yuyv"), width=11))


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial", "equidistant"])
def test_a_camera_info_carries_each_lens(model: str) -> None:
    count = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}[model]
    camera = PinholeCamera(640, 480, 400.0, 401.0, 320.0, 240.0, np.linspace(0.01, 0.02, count), model)
    back = camera_of(camera_info_message(0, "camera", camera))
    assert back.model == model
    np.testing.assert_array_equal(back.distortion, camera.distortion)


@pytest.mark.parametrize("of", [camera_of, lambda info: rectified_camera_of(info)[0]], ids=["raw", "rectified"])
def test_binning_and_roi_give_the_camera_of_the_same_image_cut_and_shrunk(of: Callable[[Any], PinholeCamera]) -> None:
    sensor = PinholeCamera(640, 480, 400.0, 401.0, 322.0, 239.0)
    info = camera_info_message(0, "camera", sensor)
    full = np.zeros((480, 640), np.float32)
    point = np.array([[0.3, -0.2, 2.0]])
    u, v = np.rint(sensor.project(point)[0]).astype(int)
    full[v - 8 : v + 9, u - 8 : u + 9] = 1.0
    window = dataclasses.replace(info.roi, x_offset=160, y_offset=80, width=400, height=300)
    camera = of(dataclasses.replace(info, binning_x=4, binning_y=2, roi=window))
    recorded = cv2.resize(full[80:380, 160:560], (100, 150), interpolation=cv2.INTER_AREA)
    assert camera.size == (100, 150)
    centre = (np.array(np.nonzero(recorded))[::-1] * recorded[recorded > 0]).sum(axis=1) / recorded.sum()
    np.testing.assert_allclose(camera.project(point)[0], centre, atol=0.5 / 2)  # the square is centred to half a pixel
    np.testing.assert_allclose(camera.bearings(camera.project(point)), sensor.bearings(sensor.project(point)))


@pytest.mark.parametrize(("binning", "window"), [(0, (0, 0, 0, 0)), (1, (0, 0, 640, 480))])
def test_a_whole_sensor_keeps_its_camera_to_the_bit(binning: int, window: tuple[int, int, int, int]) -> None:
    sensor = PinholeCamera(640, 480, 400.1, 401.3, 322.7, 239.9)
    info = camera_info_message(0, "camera", sensor)
    x, y, width, height = window
    roi = dataclasses.replace(info.roi, x_offset=x, y_offset=y, width=width, height=height)
    np.testing.assert_array_equal(camera_of(dataclasses.replace(info, binning_x=binning, roi=roi)).K, sensor.K)


def test_a_window_beyond_the_sensor_is_refused() -> None:
    info = camera_info_message(0, "camera", PinholeCamera(640, 480, 400.0, 401.0, 320.0, 240.0))
    roi = dataclasses.replace(info.roi, x_offset=400, width=400, height=300)
    with pytest.raises(CalibrationError, match=r"400x300 px from \(400, 0\), is not within its 640x480 px"):
        camera_of(dataclasses.replace(info, roi=roi))


def test_a_camera_info_of_a_rectified_image_needs_no_coefficients() -> None:
    info = camera_info_message(0, "camera", PinholeCamera(640, 480, 400.0, 401.0, 320.0, 240.0))
    info.d = np.zeros(0)
    np.testing.assert_array_equal(camera_of(info).distortion, np.zeros(5))


@pytest.mark.parametrize(
    ("model", "given", "meant"),
    [
        ("plumb_bob", [0.1, 0.2, 0.3, 0.4], [0.1, 0.2, 0.3, 0.4, 0.0]),
        ("plumb_bob", [0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0], [0.1, 0.2, 0.3, 0.4, 0.5]),
        ("rational_polynomial", [0.1, 0.2, 0.3, 0.4, 0.5], [0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0]),
        ("rational_polynomial", [*range(1, 9), *[0] * 6], [*range(1, 9)]),
        ("equidistant", [0.1, 0.2, 0.3, 0.4, 0.0], [0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_trailing_zeros_of_a_lens_may_be_missing_or_too_many(
    model: str, given: list[float], meant: list[float]
) -> None:
    info = camera_info_message(0, "camera", PinholeCamera(640, 480, 400.0, 401.0, 320.0, 240.0))
    camera = camera_of(dataclasses.replace(info, distortion_model=model, d=np.array(given, float)))
    np.testing.assert_array_equal(camera.distortion, meant)


@pytest.mark.parametrize(("model", "given"), [("plumb_bob", np.full(8, 0.1)), ("equidistant", np.zeros(0))])
def test_coefficients_of_another_lens_are_refused(model: str, given: np.ndarray[Any, Any]) -> None:
    info = camera_info_message(0, "camera", PinholeCamera(640, 480, 400.0, 401.0, 320.0, 240.0))
    with pytest.raises(CalibrationError, match=f"{model} needs [45] values; give those, or the name of the model"):
        camera_of(dataclasses.replace(info, distortion_model=model, d=given))


def test_a_16_bit_bayer_picture_keeps_its_bits() -> None:
    message = recorded("bayer_rggb16")
    assert image_of(message).max() == 200
    assert cv2.cvtColor(image_of(message), cv2.COLOR_BGR2GRAY).dtype == np.uint16
