# SPDX-License-Identifier: Apache-2.0
"""The contract of every extractor, and the position accuracy of its keypoints."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.config import FrontendConfig
from uav_vslam.errors import ConfigError, InvalidMessage
from uav_vslam.types import StereoFrame
from uav_vslam.vision.features import EXTRACTORS, detect_chosen, make_extractor
from uav_vslam.vision.features.dense import grid
from uav_vslam.vision.features.surf import INSTALL
from uav_vslam.vision.matching import match_gated
from uav_vslam.vision.stereo_points import StereoFrontend

CONFIG = FrontendConfig(max_features=200)
ON_A_GRID = {"dsift", "phow_rgb", "phow_hsv", "phow_opponent"}
SEES_COLOUR = ON_A_GRID - {"dsift"}
POSITION_TOLERANCE_PX = {  # of a blob's centre
    "sift": 0.07,  # OpenCV's default upscaling is off by 0.25
    "asift": 0.07,
    "surf": 0.1,  # uncorrected mahotas is off by up to a pixel
    "orb": 1.5,  # a corner detector, without subpixel steps
}
SMALL = 80, 96  # (height, width) [px]
SHIFT_TOLERANCE_PX = {"asift": 0.15}  # OpenCV tilts a view by subsampling; the others: 0.02


@pytest.fixture(params=sorted(EXTRACTORS))
def name(request):
    return request.param


@pytest.fixture
def extractor(name):
    return EXTRACTORS[name](CONFIG)


def size_for(name: str) -> tuple[int, int]:
    """Return (height, width) [px]: affine SIFT uses 43 views, so smaller ones."""
    return SMALL if name == "asift" else (240, 321)


def blob(u: float, v: float, sigma: float):
    rows, columns = np.mgrid[:100, :100]
    return np.rint(60 + 150 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2 * sigma**2))).astype(np.uint8)


def assert_same(first, second) -> None:
    assert first.pixels.tobytes() == second.pixels.tobytes()
    assert first.responses.tobytes() == second.responses.tobytes()
    assert first.descriptors.tobytes() == second.descriptors.tobytes()


def test_points_are_sorted_by_strength_and_limited(name, texture_image):
    few = FrontendConfig(max_features=30)
    found = EXTRACTORS[name](few).detect(texture_image(*size_for(name)))
    assert few.max_features * (0.5 if name in ON_A_GRID else 1.0) <= len(found) <= few.max_features
    assert (np.diff(found.responses) <= 0).all()
    assert found.pixels.shape == (len(found), 2)
    assert found.pixels.dtype == found.responses.dtype == np.float32
    assert found.descriptors.dtype == np.uint8
    assert len(found.descriptors) == len(found.responses) == len(found)
    assert ((found.pixels >= -0.5) & (found.pixels <= [320.5, 239.5])).all()


def test_a_single_wrong_candidate_is_rejected_and_a_correct_one_accepted(name, texture_image):
    found = EXTRACTORS[name](CONFIG).detect(texture_image(*size_for(name)))
    apart = np.linalg.norm(found.pixels[:, None] - found.pixels[None], axis=2)
    wrong = np.argmax(apart > 40.0, axis=1)
    alone = np.eye(len(found), dtype=bool)
    accepted = match_gated(found.descriptors, found.descriptors[wrong], alone, 0.8)
    assert len(accepted) <= 0.05 * len(found)
    assert len(match_gated(found.descriptors, found.descriptors, alone, 0.8)) == len(found)


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (1, 500), (17, 17), (64, 64), (64, 64, 3)])
def test_an_image_without_texture_has_no_points(extractor, shape):
    found = extractor.detect(np.full(shape, 77, np.uint8))
    assert found.pixels.shape == (0, 2)
    assert found.responses.shape == (0,)
    assert found.descriptors.shape[0] == 0
    assert found.descriptors.shape[1] > 0


@pytest.mark.parametrize("shape", [(0, 0), (0, 8), (8, 0), (0, 8, 3), (8, 8, 2)])
def test_an_empty_image_is_rejected_with_the_reason(extractor, shape):
    with pytest.raises(InvalidMessage) as caught:
        extractor.detect(np.zeros(shape, np.uint8))
    assert caught.value.reason == "image_shape"


@pytest.mark.parametrize("kind", ["mono8", "mono16", "bgr8", "bgr16"])
def test_detection_is_deterministic_and_does_not_modify_the_image(extractor, name, texture_image, kind):
    image = texture_image(*size_for(name))
    if kind.startswith("bgr"):
        image = np.dstack([image, np.roll(image, 7, axis=0), 255 - image])
    if kind.endswith("16"):
        image = image.astype(np.uint16) * 11 + 500
    before = image.copy()
    first = extractor.detect(image)
    np.testing.assert_array_equal(image, before)
    assert len(first) > 0
    assert_same(extractor.detect(image), first)
    assert_same(EXTRACTORS[name](CONFIG).detect(image), first)


@pytest.mark.parametrize("step", [0, 3])
def test_chosen_keypoints_are_those_of_the_whole_image(extractor, name, texture_image, step):
    image = texture_image(*size_for(name))
    everything = extractor.detect(image)
    rows = np.arange(len(everything))[::-step] if step else np.zeros(0, np.intp)
    assert_same(detect_chosen(extractor, image, lambda pixels: rows[rows < len(pixels)]), everything.chosen(rows))


def test_only_colour_extractors_depend_on_colour(extractor, name, texture_image):
    grey = texture_image(*SMALL)
    equal = np.dstack([grey] * 3)
    assert_same(extractor.detect(equal), extractor.detect(grey))
    tinted = np.dstack([grey, grey, 255 - grey])
    as_grey = np.asarray(cv2.cvtColor(tinted, cv2.COLOR_BGR2GRAY))
    same = extractor.detect(tinted).descriptors.tobytes() == extractor.detect(as_grey).descriptors.tobytes()
    assert same == (name not in SEES_COLOUR)


@pytest.mark.parametrize("sigma", [3.0, 5.0])
@pytest.mark.parametrize("name", sorted(POSITION_TOLERANCE_PX))
def test_a_blob_is_found_at_its_centre(name, sigma):
    extractor, errors = EXTRACTORS[name](FrontendConfig()), []
    centres = [(50.3, 45.8), (49.0, 51.4), (53.2, 54.7)]
    for centre in centres:
        found = extractor.detect(blob(*centre, sigma))
        errors.append(min(np.abs(found.pixels - np.array(centre)).max(axis=1), default=np.inf))
    # SURF loses some points: mahotas drops those half-way between two samples.
    assert sorted(errors)[1 if name == "surf" else 2] < POSITION_TOLERANCE_PX[name]


@pytest.mark.parametrize("name", sorted(POSITION_TOLERANCE_PX))
def test_keypoints_rotate_with_the_image(name, texture_image):
    """Position errors at larger scales, from a level's resizing or a quarter-pixel bias, show as a shift."""
    height, width = size_for(name)
    image = texture_image(height, width)
    extractor = EXTRACTORS[name](FrontendConfig(max_features=1000))
    upright, turned = extractor.detect(image), extractor.detect(np.ascontiguousarray(image[::-1, ::-1]))
    shifts = 0.5 * (upright.pixels[:, None] + turned.pixels[None] - [width - 1, height - 1])
    nearest = np.abs(shifts).max(axis=2).argmin(axis=1)
    shifts = shifts[np.arange(len(upright)), nearest]
    close = np.abs(shifts).max(axis=1) < 1.0
    assert close.mean() > 0.5
    np.testing.assert_allclose(np.mean(shifts[close], axis=0), 0.0, atol=SHIFT_TOLERANCE_PX.get(name, 0.02))


@pytest.mark.parametrize("sigma", [2.0, 12.0])
def test_sift_finds_the_smallest_and_largest_blobs_too(sigma):
    found = EXTRACTORS["sift"](FrontendConfig()).detect(blob(50.3, 45.8, sigma))
    np.testing.assert_allclose(found.pixels[0], [50.3, 45.8], atol=0.05)


def test_sift_descriptors_equal_opencvs_float_ones(texture_image):
    image = texture_image(240, 320)
    found = EXTRACTORS["sift"](CONFIG).detect(image)
    reference = cv2.SIFT_create(200, 3, CONFIG.contrast_threshold, 10, 1.6, cv2.CV_32F, True)
    points, descriptors = reference.detectAndCompute(image, None)
    expected = {tuple(row) for row in descriptors}
    assert (descriptors == np.rint(descriptors)).all()
    assert {tuple(row) for row in found.descriptors.astype(np.float32)} <= expected
    assert len(points) >= len(found)


def test_affine_sift_contains_sifts_points_and_more(texture_image):
    image = texture_image(*SMALL)
    config = FrontendConfig(max_features=100_000)
    plain, affine = (EXTRACTORS[name](config).detect(image) for name in ("sift", "asift"))
    assert len(affine) > 5 * len(plain)
    assert {tuple(row) for row in plain.pixels} <= {tuple(row) for row in affine.pixels}


def test_surf_separates_dark_and_bright_blobs_by_a_descriptor_length():
    bright, dark = blob(50.0, 50.0, 5.0), 255 - blob(50.0, 50.0, 5.0)
    signs = [EXTRACTORS["surf"](CONFIG).detect(image).descriptors[0, -1] for image in (bright, dark)]
    assert sorted(signs) == [0, 255]


def test_surf_is_invariant_to_brightness(texture_image):
    """Uncorrected mahotas depends on brightness at about half of the scales."""
    image = texture_image(240, 321) // 2
    dark, bright = (EXTRACTORS["surf"](CONFIG).detect(image + np.uint8(offset)) for offset in (0, 100))
    np.testing.assert_array_equal(bright.pixels, dark.pixels)
    assert np.abs(bright.descriptors.astype(int) - dark.descriptors).max() <= 1


def test_orb_distances_count_the_bits_that_differ(texture_image):
    image = texture_image(240, 320)
    found = EXTRACTORS["orb"](FrontendConfig(max_features=500)).detect(image)
    _, packed = cv2.ORB_create(500).detectAndCompute(image, None)
    assert set(np.unique(found.descriptors)) == {0, 1}
    assert {row.tobytes() for row in np.packbits(found.descriptors, axis=1)} <= {row.tobytes() for row in packed}


@pytest.mark.parametrize("count", [1, 7, 100, 1500])
def test_a_grid_is_the_densest_within_the_limit(count):
    pixels = grid((96, 130), margin_px=16.5, count=count)
    assert 0 < len(pixels) <= count
    assert ((pixels >= 17) & (pixels < [113, 79])).all()
    assert len(grid((96, 130), margin_px=16.5, count=10**9)) == 62 * 96
    assert len(grid((33, 130), margin_px=16.5, count=count)) == 0


@pytest.mark.parametrize("shift", [(8, 0), (-5, 12)])
def test_dense_descriptors_move_with_the_image(shift, texture_image):
    """Every pixel is a grid point here, so the same patches are described at shifted positions."""
    everything = FrontendConfig(max_features=100_000)
    image = texture_image(120, 140)
    moved = image[20 : 20 + 80, 20 : 20 + 80], image[20 + shift[1] : 100 + shift[1], 20 + shift[0] : 100 + shift[0]]
    first, second = (EXTRACTORS["dsift"](everything).detect(np.ascontiguousarray(part)) for part in moved)
    there = {tuple(pixel): row for pixel, row in zip(second.pixels, second.descriptors, strict=True)}
    pairs = [
        (row, there[tuple(pixel - shift)])
        for pixel, row in zip(first.pixels, first.descriptors, strict=True)
        if tuple(pixel - shift) in there
    ]
    differences = np.array([np.linalg.norm(a.astype(float) - b) for a, b in pairs])
    assert len(pairs) > 500
    assert np.median(differences) < 10  # of a length of 512: only smoothing at the border differs


def test_surf_without_mahotas_names_the_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "mahotas.features", None)
    with pytest.raises(ConfigError, match=r"needs the package mahotas; install it: pip install mahotas==\d"):
        make_extractor(FrontendConfig(extractor="surf"))


def test_the_install_command_has_the_tested_version():
    root = Path(__file__).parents[2]
    wanted = INSTALL.split()[-1]
    assert f"\n{wanted} " in (root / "requirements/lock.txt").read_text()
    assert f'"{wanted}"' in (root / "setup.py").read_text()


def test_the_front_end_runs_with_each(name, flight_scene):
    """Sparse extractors give correct points; grid extractors match to half a step and so give few or none."""
    scale = 0.125 if name == "asift" else 0.5
    frontend = StereoFrontend(flight_scene.rig, FrontendConfig(extractor=name, max_features=400, scale=scale))
    found = frontend.process(flight_scene.frame)
    assert found.pixels.shape[1] == 4
    assert len(found.descriptors) == len(found)
    if name not in ON_A_GRID:
        assert len(found) > 10
        assert flight_scene.wrong(found.pixels, 1.5 / scale).mean() < 0.1


@pytest.mark.parametrize("name", ["sift", "phow_rgb"])
def test_the_front_end_accepts_colour(name, flight_scene):
    frontend = StereoFrontend(flight_scene.rig, FrontendConfig(extractor=name, max_features=400))
    frame = flight_scene.frame
    colour = StereoFrame(frame.stamp_ns, *(np.dstack([image] * 3) for image in (frame.left, frame.right)))
    np.testing.assert_array_equal(frontend.detect(colour).left.pixels, frontend.detect(frame).left.pixels)
    tinted = StereoFrame(frame.stamp_ns, colour.left * np.array([1, 0, 1], np.uint8), colour.right)
    same = np.array_equal(frontend.detect(tinted).left.descriptors, frontend.detect(frame).left.descriptors)
    assert not same
