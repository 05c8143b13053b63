# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from flown_scene import Scene, moved, patches, waves

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.orthomosaic import Exposure, Orthomosaic, blended_mosaic
from uav_vslam.mapping.orthomosaic.thumbnail import thumbnail
from uav_vslam.mapping.orthomosaic.tiles import Tile
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.tile_store import SIDE
from uav_vslam.mapping.view import View

M_PER_PX = 0.1
PLAIN = Scene()
HILLS = Scene(lambda x, y: 2.0 * np.sin(0.15 * x) + 1.5 * np.cos(0.11 * y))
ALONG = [PLAIN.view((x, 0.0, 30.0), (2.0, -3.0, x)) for x in (0.0, 9.0, 18.0)]


def box(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of a block of 6 x 6 x 5 m at x = 8 m."""
    return np.where((np.abs(x - 8.0) < 3.0) & (np.abs(y) < 3.0), 5.0, 0.0)


def roof_white(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.where(box(x, y) > 0, 255.0, 60.0 + 0.1 * waves(x, y))


@pytest.mark.parametrize(
    ("scene", "m_per_px"), [(PLAIN, M_PER_PX), (HILLS, M_PER_PX), (PLAIN, 0.3)], ids=["plane", "hills", "coarse"]
)
def test_the_mosaic_is_the_ground_seen_from_straight_above(scene: Scene, m_per_px: float) -> None:
    mosaic = Orthomosaic(scene, m_per_px)
    for x in (0.0, 9.0, 18.0):
        mosaic.add(scene.view((x, 1.0, 30.0), (3.0, -4.0, 7.0)))
    picture = mosaic.picture()
    assert picture.seen.mean() > 0.8
    truth = scene.truth(picture.raster)
    error = picture.image - truth
    assert np.sqrt(np.mean(error[picture.seen] ** 2)) < 15.0 * m_per_px  # grey levels of a pattern of 30 rms
    inside = cv2.erode(picture.seen.astype(np.uint8), np.ones((9, 9))) > 0
    slopes = np.column_stack([slope[inside] for slope in np.gradient(truth)])
    shift = np.linalg.lstsq(slopes, error[inside], rcond=None)[0]
    assert np.hypot(*shift) < 0.05  # pixels


def test_pixels_too_small_to_draw_a_view_are_refused_with_a_size_that_suits() -> None:
    with pytest.raises(UavVslamError, match=r"pixels of 0.0001 m .* use a --pixel of more than 0.00\d+ m"):
        Orthomosaic(PLAIN, 1e-4).add(ALONG[0])


def test_what_stands_does_not_colour_the_ground_behind_it() -> None:
    scene = Scene(box, roof_white)
    mosaic = Orthomosaic(scene, M_PER_PX)
    mosaic.add(scene.view((0.0, 0.0, 30.0)))
    picture = mosaic.picture()
    x, y = np.meshgrid(picture.raster.x, picture.raster.y)
    behind = (x > 11.3) & (x < 11.0 * 30.0 / 25.0 - 0.3) & (np.abs(y) < 2.5)  # in the block's shadow of sight
    assert not picture.seen[behind].any()
    beyond = (x > 11.0 * 30.0 / 25.0 + 0.7) & (x < 14.6) & (np.abs(y) < 2.5)
    assert picture.seen[beyond].all()
    off_the_roof = picture.seen & (np.maximum(np.abs(x - 8.0), np.abs(y)) > 3.4)
    assert np.count_nonzero(picture.image[off_the_roof] > 140) < 10  # of 1200 pixels that show the roof's image
    on_the_roof = np.maximum(np.abs(x - 8.0), np.abs(y)) < 2.5
    assert picture.image[on_the_roof].min() > 200


def test_ground_hidden_in_the_best_view_comes_from_another() -> None:
    scene = Scene(box, roof_white)
    mosaic = Orthomosaic(scene, M_PER_PX)
    mosaic.add(scene.view((4.0, 0.0, 30.0)))
    mosaic.add(scene.view((21.0, 0.0, 30.0)))
    picture = mosaic.picture()
    x, y = np.meshgrid(picture.raster.x, picture.raster.y)
    behind = (x > 11.3) & (x < 12.0) & (np.abs(y) < 2.5)
    assert (picture.labels[behind] == 1).all()
    error = (picture.image - scene.truth(picture.raster))[behind]
    assert np.abs(error).max() < 25.0  # of a roof that is 190 grey levels brighter


def test_pixels_come_from_the_view_from_straight_above() -> None:
    mosaic = Orthomosaic(PLAIN, M_PER_PX)
    for view in ALONG:
        mosaic.add(view)
    picture = mosaic.picture()
    nearest = np.argmin([np.abs(picture.raster.x - view.T_map_cam.t[0]) for view in ALONG], axis=0)
    row = int(np.searchsorted(picture.raster.y, 0.0))
    assert np.mean(picture.labels[row] == nearest) > 0.95
    changes = np.count_nonzero(np.diff(picture.labels[row][picture.seen[row]]))
    assert changes == 2  # three pieces, not shattered


def test_a_view_from_higher_up_counts_less_where_the_mosaic_shows_more_than_it() -> None:
    low, high = PLAIN.view((0.0, 0.0, 30.0)), PLAIN.view((5.0, 0.0, 90.0))
    for fine, first in ((M_PER_PX, 0), (M_PER_PX, 1)):
        mosaic = Orthomosaic(PLAIN, fine)
        for view in (low, high)[:: 1 - 2 * first]:
            mosaic.add(view)
        picture = mosaic.picture()
        x, y = np.meshgrid(picture.raster.x, picture.raster.y)
        below = (np.abs(x) < 9.0) & (np.abs(y) < 6.0)  # the higher one is as straight above, on the right
        assert (picture.labels[below] == first).all()


def test_a_blurred_view_gives_way_to_sharp_ones() -> None:
    scene = Scene(colour=patches(0.3))
    views = [scene.view((x, 0.0, 30.0)) for x in (0.0, 4.0, 8.0, 12.0, 16.0)]
    views[2] = replace(views[2], image=cv2.GaussianBlur(views[2].image, (0, 0), 2.5))
    picture = blended_mosaic(lambda: views, scene, M_PER_PX).picture()
    assert not (picture.labels == 2).any()
    picture = blended_mosaic(lambda: views[2:3], scene, M_PER_PX).picture()
    assert picture.seen.any()  # better than none


@pytest.mark.parametrize("level", [0, 255])
def test_what_is_clipped_in_the_best_view_comes_from_another(level: int) -> None:
    best, other = (PLAIN.view((x, 0.0, 30.0)) for x in (0.0, 8.0))
    image = best.image.copy()
    image[60:180] = level
    mosaic = Orthomosaic(PLAIN, M_PER_PX)
    for view in (replace(best, image=image), other):
        mosaic.add(view)
    picture = mosaic.picture()
    x, y = np.meshgrid(picture.raster.x, picture.raster.y)
    assert (picture.labels[(np.abs(x) < 3.0) & (np.abs(y) < 4.0)] == 1).all()
    assert (picture.labels[(np.abs(x + 11.0) < 3.0) & (np.abs(y) < 4.0)] == 0).all()  # better than none


def test_a_frame_touches_as_many_tiles_over_a_large_map_as_over_a_small_one(tmp_path: Path) -> None:
    mosaic = Orthomosaic(PLAIN, M_PER_PX, folder=tmp_path, kept_bytes=20 * Tile.empty(1).nbytes)
    step_m = SIDE * M_PER_PX  # so that each view lies on the tiles alike
    touched = []
    for k in range(12):
        before = mosaic.tiles.touched if k else 0
        mosaic.add(moved(ALONG[0], k * step_m))
        touched.append(mosaic.tiles.touched - before)
        assert mosaic.tiles.in_memory <= 20
    assert len(set(touched)) == 1
    assert len(mosaic.tiles) > 20


def test_tiles_in_files_make_the_same_picture_as_in_memory(tmp_path: Path) -> None:
    kept = Orthomosaic(PLAIN, M_PER_PX)
    filed = Orthomosaic(PLAIN, M_PER_PX, folder=tmp_path, kept_bytes=0)
    for view in ALONG:
        kept.add(view)
        filed.add(view)
    assert list(tmp_path.iterdir())
    np.testing.assert_array_equal(kept.picture().image, filed.picture().image)
    np.testing.assert_array_equal(kept.picture().labels, filed.picture().labels)


@pytest.mark.parametrize("scene", [PLAIN, HILLS])
def test_a_view_that_is_drawn_in_blocks_makes_the_same_picture(monkeypatch: pytest.MonkeyPatch, scene: Scene) -> None:
    pictures = []
    for side in (4096, 96):
        monkeypatch.setattr("uav_vslam.mapping.orthomosaic.mosaic.BLOCK_PX", side)
        mosaic = Orthomosaic(scene, M_PER_PX)
        for x in (0.0, 9.0, 18.0):
            mosaic.add(scene.view((x, 0.0, 30.0), (2.0, -3.0, x)))
        pictures.append(mosaic.picture())
    whole, blocks = pictures
    np.testing.assert_array_equal(whole.labels, blocks.labels)
    difference = np.abs(whole.image.astype(int) - blocks.image)
    assert (difference > 0).mean() < 0.01
    inside = cv2.erode(whole.seen.astype(np.uint8), np.ones((5, 5))) > 0  # at the edge, what continues it differs
    assert difference[inside].max() <= 1  # grey levels, by rounding


def test_a_tile_that_is_cut_off_is_an_error_that_names_its_file(tmp_path: Path) -> None:
    mosaic = Orthomosaic(PLAIN, M_PER_PX, folder=tmp_path, kept_bytes=0)
    for view in ALONG:
        mosaic.add(view)
    tile = sorted(tmp_path.iterdir())[0]
    tile.write_bytes(tile.read_bytes()[:1000])
    with pytest.raises(UavVslamError, match=rf"{tile.name} of the mosaic has 1000 of \d+ bytes"):
        mosaic.picture()


def test_a_window_is_a_cut_of_the_whole_picture() -> None:
    mosaic = Orthomosaic(PLAIN, M_PER_PX)
    for view in ALONG:
        mosaic.add(view)
    whole = mosaic.picture()
    window = Raster(M_PER_PX, whole.raster.column + 37, whole.raster.row + 21, 101, 83)
    cut = mosaic.picture(window)
    np.testing.assert_array_equal(cut.image, whole.image[window.within(whole.raster)])


def test_with_gains_known_the_order_of_views_does_not_matter() -> None:
    pictures = []
    for order in (ALONG, ALONG[::-1]):
        mosaic = blended_mosaic(lambda order=order: order, PLAIN, M_PER_PX)
        pictures.append((mosaic.picture().image.astype(int), mosaic.picture().seen))
    np.testing.assert_array_equal(pictures[0][1], pictures[1][1])
    assert np.abs(pictures[0][0] - pictures[1][0]).max() <= 1


def _brightness(gains: tuple[float, ...], falloff: float) -> list[View]:
    return [
        PLAIN.view((x, 0.0, 30.0), shading=lambda r2, gain=gain: gain * np.exp(-falloff * r2))
        for x, gain in zip((0.0, 9.0, 18.0), gains, strict=True)
    ]


def _unevenness(mosaic: Orthomosaic) -> float:
    """Return the spread of the picture's brightness over the ground's, once noise is averaged out."""
    picture = mosaic.picture()
    ratio = np.where(picture.seen, picture.image / PLAIN.truth(picture.raster), 1.0)
    inside = cv2.erode(picture.seen.astype(np.uint8), np.ones((41, 41))) > 0
    smooth = cv2.GaussianBlur(ratio, (0, 0), 5.0)[inside]
    return float(smooth.std() / smooth.mean())


def test_views_of_different_brightness_join_without_a_step() -> None:
    views = _brightness((1.0, 0.7, 1.25), falloff=0.9)
    assert _unevenness(blended_mosaic(lambda: views, PLAIN, M_PER_PX)) < 0.006  # uncorrected 0.2


def test_as_views_come_their_gains_follow_the_earlier_ones() -> None:
    mosaic = Orthomosaic(PLAIN, M_PER_PX)
    for view in _brightness((1.0, 0.7, 1.25), falloff=0.0):
        mosaic.add(view)
    assert _unevenness(mosaic) < 0.006


def test_colours_stay_in_their_channels() -> None:
    scene = Scene(colour=lambda x, y: np.stack([waves(x, y), 0.5 * waves(y, x), np.full_like(x, 90.0)], axis=-1))
    mosaic = Orthomosaic(scene, M_PER_PX)
    mosaic.add(scene.view((0.0, 0.0, 30.0)))
    picture = mosaic.picture()
    assert picture.image.shape == (*picture.raster.shape, 3)
    error = (picture.image - scene.truth(picture.raster))[picture.seen]
    assert (np.sqrt(np.mean(error**2, axis=0)) < 1.5).all()
    with pytest.raises(UavVslamError, match="grey and in colour"):
        mosaic.add(ALONG[0])


def test_nothing_seen_is_an_error_that_says_what_to_check() -> None:
    unknown = Scene(lambda x, y: np.full_like(x, np.nan))
    mosaic = Orthomosaic(unknown, M_PER_PX)
    mosaic.add(ALONG[0])
    assert not mosaic.views
    with pytest.raises(UavVslamError, match="no view saw the surface"):
        mosaic.picture()
    with pytest.raises(UavVslamError, match="positive size"):
        Orthomosaic(PLAIN, 0.0)


def test_ground_of_unknown_height_is_left_out_and_disturbs_nothing() -> None:
    partly = Scene(lambda x, y: np.where((x > 4.0) | (np.hypot(x, y) < 1.0), np.nan, 0.0))
    mosaic = blended_mosaic(lambda: ALONG, partly, M_PER_PX)
    picture = mosaic.picture()
    x, y = np.meshgrid(picture.raster.x, picture.raster.y)
    assert picture.raster.bounds_m[2] == pytest.approx(4.0, abs=0.11)
    assert not picture.seen[np.hypot(x, y) < 0.6].any()
    error = (picture.image - PLAIN.truth(picture.raster))[picture.seen]
    assert np.sqrt(np.mean(error**2)) < 1.5


def test_shares_count_the_pixels_of_each_vehicle() -> None:
    mosaic = Orthomosaic(PLAIN, M_PER_PX)
    for vehicle, view in zip(("uav1", "uav2", "uav2"), ALONG, strict=True):
        mosaic.add(PLAIN.view(tuple(view.T_map_cam.t), vehicle=vehicle))
    labels = mosaic.picture().labels
    shares = mosaic.shares()
    assert shares["uav1"] == pytest.approx(np.mean(labels[labels >= 0] == 0))
    assert sum(shares.values()) == pytest.approx(1.0)


def test_gains_and_falloff_are_recovered() -> None:
    true = np.array([0.0, -0.3, 0.2, 0.1])
    exposure = Exposure()
    for k, log_gain in enumerate(true):
        view = HILLS.view((7.0 * k, 0.0, 30.0), shading=lambda r2, g=log_gain: np.exp(g - 0.6 * r2 + 0.4 * r2 * r2))
        thumb = thumbnail(view, HILLS, M_PER_PX)
        assert thumb is not None
        exposure.add(thumb, "uav1")
    exposure.solve()
    found = np.array([exposure.correction(k).log_gain[0] for k in range(len(true))])
    np.testing.assert_allclose(found - found.mean(), true.mean() - true, atol=0.01)
    r2 = np.linspace(0.0, 0.35, 20)  # up to the corners
    a, b = exposure.correction(0).falloff
    np.testing.assert_allclose(a * r2 + b * r2**2, -0.6 * r2 + 0.4 * r2**2, atol=0.015)
