# SPDX-License-Identifier: Apache-2.0
"""The ground is the same in every window, and never repeats."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.errors import ConfigError
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.simulation.terrain import Relief, ground_of
from uav_vslam.simulation.texture import TILE, GrassTexture, ImageTexture, texture_from


def test_relief_has_the_stated_height_and_precision() -> None:
    relief = Relief(2.0, np.random.default_rng(1))
    x, y = np.meshgrid(np.linspace(-2000, 2000, 300), np.linspace(-2000, 2000, 300))
    height = relief.height(x, y)
    assert height.std() == pytest.approx(2.0, rel=0.1)
    assert abs(height.mean()) < 0.2
    single = relief.height(x.astype(np.float32), y.astype(np.float32))
    np.testing.assert_allclose(single, height, atol=2e-3)


def test_overlapping_windows_agree() -> None:
    texture = GrassTexture(3)
    wide = texture.window(-300, -700, 900, 200)
    np.testing.assert_array_equal(wide[650:720, 250:340], GrassTexture(3).window(-50, -50, 40, 20))


def test_tiles_join_without_a_seam() -> None:
    texture = GrassTexture(3).window(0, 0, 2 * TILE, TILE).astype(float)
    step = np.abs(np.diff(texture, axis=1)).mean(axis=0)
    assert step[TILE - 1] < 1.5 * np.median(step)


def test_grass_does_not_repeat() -> None:
    texture = GrassTexture(7)
    template = texture.window(0, 0, 64, 64).astype(np.float32)
    around = texture.window(-1500, -1500, 1500, 1500).astype(np.float32)
    score = cv2.matchTemplate(around, template, cv2.TM_CCOEFF_NORMED)
    assert score[1500, 1500] == pytest.approx(1.0, abs=1e-3)
    score[1490:1511, 1490:1511] = 0.0
    assert score.max() < 0.7


def test_a_picture_is_laid_on_the_ground_at_its_scale(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(60, 200, (30, 40), dtype=np.uint8)
    picture = cv2.resize(picture, (800, 600), interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(tmp_path / "ground.png"), picture)
    texture = texture_from(str(tmp_path), 0, image_m_per_px=0.1)
    assert isinstance(texture, ImageTexture)
    seen = texture.window(-800, -600, 800, 600)  # 80 x 60 m around the origin
    laid = cv2.resize(picture, (1600, 1200), interpolation=cv2.INTER_CUBIC)
    noise = seen[::-1].astype(float) - laid  # row 0 of a picture is its north edge
    assert np.abs(noise.mean()) < 1.0
    assert noise.std() < 10.0


@pytest.mark.parametrize("m_per_px", [0.0, -1.0, float("nan"), float("inf"), 1e-6, 1e9])
def test_a_picture_whose_pixels_have_no_drawable_size_is_refused(tmp_path: Path, m_per_px: float) -> None:
    cv2.imwrite(str(tmp_path / "ground.png"), np.full((600, 800), 120, np.uint8))
    with pytest.raises(ConfigError, match="800 x 600 pixels of"):
        texture_from(str(tmp_path / "ground.png"), 0, image_m_per_px=m_per_px)


def test_repeated_pictures_are_not_similar(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "ground.png"), np.full((600, 800), 120, np.uint8))
    texture = texture_from(str(tmp_path / "ground.png"), 0, image_m_per_px=0.05)
    here, there = texture.window(0, 0, 200, 200), texture.window(800, 0, 1000, 200)
    assert abs(np.corrcoef(here.ravel(), there.ravel())[0, 1]) < 0.2


def test_the_ground_depends_on_the_seed_only() -> None:
    one, two = ground_of(Scenario(seed=1)), ground_of(Scenario(seed=2))
    again = ground_of(Scenario(seed=1))
    cut = (0, 0, 50, 50)
    np.testing.assert_array_equal(one.texture.window(*cut), again.texture.window(*cut))
    assert not np.array_equal(one.texture.window(*cut), two.texture.window(*cut))


def test_a_missing_texture_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        texture_from(str(tmp_path / "nowhere"), 0, image_m_per_px=0.05)
    (tmp_path / "text.png").write_text("not an image")
    with pytest.raises(ConfigError, match="not a readable image"):
        texture_from(str(tmp_path / "text.png"), 0, image_m_per_px=0.05)


def test_a_view_of_the_horizon_is_refused() -> None:
    with pytest.raises(ConfigError, match="horizon"):
        GrassTexture(0).window(0, 0, 20_000, 20_000)
