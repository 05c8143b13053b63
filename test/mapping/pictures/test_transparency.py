# SPDX-License-Identifier: Apache-2.0
"""What is transparent is no part of a picture: neither its outline is matched nor its colour drawn."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from picture_folder import flight, render
from PIL import Image

from uav_vslam.cli.main import main
from uav_vslam.mapping.pictures.features import detect_all
from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.mapping.pictures.reading import read_folder

WHITE = 255  # brighter than the ground
EDGE_PX = 16.0


def ellipse(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    v, u = np.mgrid[-1.0 : 1.0 : image.shape[0] * 1j, -1.0 : 1.0 : image.shape[1] * 1j]
    return np.asarray(u**2 + v**2 < 1.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of ground within an ellipse; all around is white and transparent."""
    flown, folder = flight(1, 3, along_m=12.0), tmp_path_factory.mktemp("pictures")
    for image, name in zip(render(flown), flown.names(), strict=True):
        inside = ellipse(image)
        grey = np.where(inside, image, np.uint8(WHITE))
        cv2.imwrite(str(folder / name), np.dstack([grey] * 3 + [np.where(inside, 255, 0).astype(np.uint8)]))
    return folder


def test_points_are_away_from_what_is_transparent(folder: Path) -> None:
    detected = detect_all(read_folder(folder).pictures, on_picture=int)
    for picture, features in zip(detected.pictures, detected.features, strict=True):
        opaque = picture.opaque()
        assert opaque is not None
        np.testing.assert_array_equal(opaque, ellipse(picture.read()))
        u, v = np.rint(features.pixels).astype(int).T
        away_px = cv2.distanceTransform(opaque.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        assert away_px[v, u].min() > EDGE_PX
        assert len(u) > 100


@pytest.mark.slow
@pytest.mark.parametrize("method", ["bundle", "homography"])
def test_the_mosaic_shows_the_ground_alone(method: str, folder: Path, tmp_path: Path) -> None:
    assert main(["mosaic", str(folder), "--method", method, "--results", str(tmp_path)]) == 0
    mosaic = cv2.imread(str(tmp_path / "latest" / "map" / "orthomosaic.png"), cv2.IMREAD_UNCHANGED)
    seen = mosaic[..., 3] > 0
    assert 0.6 < seen.mean() < 0.95
    assert mosaic[seen, :3].max() < WHITE - 20


def picture_of(path: Path) -> Picture:
    for copy in ("a", "b"):
        (path.parent / f"{copy}{path.suffix}").write_bytes(path.read_bytes() + copy.encode() * (copy == "b"))
    path.unlink()
    return read_folder(path.parent).pictures[0]


@pytest.mark.parametrize(
    ("mode", "suffix"), [("RGBA", ".png"), ("RGBA", ".tif"), ("LA", ".png"), ("LA", ".tif"), ("P", ".png")]
)
def test_each_kind_of_transparency_is_read(mode: str, suffix: str, tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(0, 200, (60, 80, 4), np.uint8)
    values[..., 3] = np.where(np.arange(80) < 30, 0, 255)
    image = Image.fromarray(values)
    if mode == "P":
        image = image.convert("RGB").quantize(255)
        image.putpalette([*image.getpalette()[: 3 * 255], 0, 0, 0])
        image.paste(255, (0, 0, 30, 60))
        image.save(tmp_path / "x.png", transparency=255)
    else:
        image.convert(mode).save(tmp_path / f"x{suffix}")
    opaque = picture_of(tmp_path / f"x{suffix}").opaque()
    assert opaque is not None
    np.testing.assert_array_equal(opaque, values[..., 3] > 0)


def test_an_alpha_channel_that_hides_nothing_is_none(tmp_path: Path) -> None:
    Image.new("RGBA", (80, 60), (1, 2, 3, 255)).save(tmp_path / "x.png")
    assert picture_of(tmp_path / "x.png").opaque() is None
