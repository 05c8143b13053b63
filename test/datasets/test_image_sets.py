# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from uav_vslam.datasets.image_sets import LAYOUTS, Layout, files_of, read_image, shift_between
from uav_vslam.datasets.messages import decoded, halved
from uav_vslam.errors import ConfigError


def test_the_first_image_and_those_at_the_distances_are_found_by_band(tmp_path: Path) -> None:
    for k in range(5):
        (tmp_path / f"{k}_a.png").touch()
        (tmp_path / f"{k}_b.jpg").touch()
    (tmp_path / "notes_a.txt").touch()
    layout = Layout({"one": "*_a.*", "two": "*_b.*"}, spacings=(1, 3, 9), usual=1, cross=2)
    found = files_of(layout, tmp_path)
    assert {band: sorted(files) for band, files in found.items()} == {"one": [0, 1, 2, 3], "two": [0, 1, 2, 3]}
    assert found["one"][3] == tmp_path / "3_a.png"


def test_a_folder_with_one_image_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").touch()
    with pytest.raises(ConfigError, match="holds 1 images"):
        files_of(Layout({"images": "*"}), tmp_path)


@pytest.mark.parametrize(("shape", "dtype"), [((6, 8), np.uint8), ((6, 8, 3), np.uint8), ((6, 8), np.uint16)])
def test_an_image_keeps_its_channels_and_bits(tmp_path: Path, shape: tuple[int, ...], dtype: type) -> None:
    image = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image)


@pytest.mark.parametrize("orientation", [3, 6])
def test_pixels_stay_where_they_are_stored_whatever_exif_says(tmp_path: Path, orientation: int) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    stored = np.repeat(np.arange(0, 240, 5, np.uint8)[:, None], 64, axis=1)  # dark above
    Image.fromarray(stored).save(tmp_path / "a.jpg", exif=exif, quality=95)
    data = np.frombuffer((tmp_path / "a.jpg").read_bytes(), np.uint8)
    for image in (read_image(tmp_path / "a.jpg"), decoded(data)):
        np.testing.assert_allclose(np.asarray(image, float), stored, atol=4)
    np.testing.assert_allclose(np.asarray(halved(data), float), stored[::2, ::2] + 2.5, atol=4)


def test_a_file_that_is_not_an_image_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_text("no image")
    with pytest.raises(ConfigError, match=r"a\.png can't be read as an image"):
        read_image(tmp_path / "a.png")


def test_the_shift_of_an_image_is_found() -> None:
    noise = cv2.GaussianBlur(np.random.default_rng(2).normal(128, 60, (150, 200)).astype(np.float32), (0, 0), 0.8)
    first, second = noise[20:120, 20:160], noise[17:117, 25:165]  # the point at u, v moves to u - 5, v + 3
    np.testing.assert_allclose(shift_between(first, second), [-5.0, 3.0], atol=0.1)


@pytest.mark.data
def test_the_first_visible_image_of_the_camp_is_shifted_by_two_pixels(data_root: Path) -> None:
    files = files_of(LAYOUTS["tno_nato_camp"], data_root / "tno_nato_camp")
    assert {band: len(found) for band, found in files.items()} == {"visible": 10, "thermal": 10}
    images = {band: [read_image(path) for path in found.values()] for band, found in files.items()}
    shifts = {band: [shift_between(image, found[-1]) for image in found] for band, found in images.items()}
    np.testing.assert_allclose(shifts["visible"][0], [0.0, 2.2], atol=0.3)
    others = [*shifts["visible"][1:], *shifts["thermal"]]
    assert np.abs(others).max() < 0.7
