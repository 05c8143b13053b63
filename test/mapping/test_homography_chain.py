# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import cv2
import numpy as np
import pytest
from flown_scene import CAMERA, Scene, patches

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.homography_chain import chain_homographies, chained_mosaic
from uav_vslam.mapping.pictures.chain import draw_chain
from uav_vslam.mapping.pictures.features import detect_all
from uav_vslam.mapping.pictures.reading import read_folder

SCENE = Scene(colour=patches(0.8))
VIEWS = [SCENE.view((5.0 * k, 0.0, 30.0), (2.0 * k, -k, 3.0 * k)) for k in range(4)]
IMAGES = [view.image for view in VIEWS]


def plane_to_pixels(view) -> np.ndarray:
    """Return the homography from x, y of the plane z = 0 to pixels."""
    T = view.T_map_cam.inverse()
    return CAMERA.K @ np.column_stack([T.R[:, 0], T.R[:, 1], T.t])


def test_over_a_plane_the_chain_is_the_true_homography() -> None:
    found = chain_homographies(IMAGES)
    pixels = np.array([[20.0, 20.0, 1.0], [300.0, 30.0, 1.0], [160.0, 220.0, 1.0]]).T
    for view, H in zip(VIEWS, found, strict=True):
        true = plane_to_pixels(VIEWS[0]) @ np.linalg.inv(plane_to_pixels(view)) @ pixels
        chained = H @ pixels
        np.testing.assert_allclose(chained[:2] / chained[2], true[:2] / true[2], atol=1.0)


def test_images_are_drawn_to_scale_and_later_ones_on_top() -> None:
    to_map = [np.linalg.inv(plane_to_pixels(view)) for view in VIEWS]
    chained = chained_mosaic(IMAGES, to_map, 0.1)
    error = (chained.image - SCENE.truth(chained.raster))[chained.labels >= 0]
    assert np.median(np.abs(error)) < 3.0
    row, column = (int(k) for k in chained.raster.index([13.0, 0.0]))
    assert chained.labels[row, column] == 3


def test_images_without_a_common_place_are_named(tmp_path: Path) -> None:
    apart = [IMAGES[0], SCENE.view((90.0, 60.0, 30.0)).image]
    with pytest.raises(UavVslamError, match="images 0 and 1 have"):
        chain_homographies(apart)
    for number, image in enumerate(apart):
        cv2.imwrite(str(tmp_path / f"{number}.png"), image)
    with pytest.raises(UavVslamError, match=r"images 0\.png and 1\.png have"):
        draw_chain(read_folder(tmp_path).pictures, 1.0, tmp_path)


def test_pictures_of_16_bits_are_drawn_with_the_same_black_and_white(tmp_path: Path) -> None:
    """Each by its own range, the ones of dark ground alone came out bright."""

    def colour(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.asarray(patches(0.8)(x, y) * np.where(x < 8.0, 0.3, 1.0))

    views = [Scene(colour=colour).view((8.0 * k, 0.0, 30.0)) for k in range(4)]
    for number, view in enumerate(views):
        cv2.imwrite(str(tmp_path / f"{number}.png"), view.image.astype(np.uint16) * 40)
    pictures = read_folder(tmp_path).pictures
    drawn = cv2.imread(str(draw_chain(pictures, 1.0, tmp_path)), cv2.IMREAD_UNCHANGED)
    first = drawn[:240, :20][drawn[:240, :20, 3] > 0][:, 0]  # only the first picture shows the west
    truth = views[0].image[:, :20]
    levels = detect_all(pictures, on_picture=int).pictures[0].levels
    assert levels is not None
    assert np.median(first) == pytest.approx(255.0 * np.median(truth * 40.0) / levels[1], rel=0.05)


@pytest.mark.parametrize("wild", [np.diag([1e4, 1e4, 1.0]), np.array([[1.0, 0, 0], [0, 1.0, 0], [-0.01, 0, 1.0]])])
def test_a_chain_that_has_come_apart_is_an_error_and_no_huge_picture(wild: np.ndarray) -> None:
    with pytest.raises(UavVslamError, match="come apart"):
        chained_mosaic(IMAGES[:1], [wild], 0.1)
