# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.mapping.raster import Raster
from uav_vslam.studies.orthomosaic.displacement import Displacements, displacements

RASTER = Raster(0.1, -300, 50, 800, 300)
SEEN = np.ones(RASTER.shape, bool)
WAVES = np.random.default_rng(3).normal(size=(300, 4)) * [3.0, 3.0, 1.0, 1.0]  # kx, ky, phase, amplitude


def ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    grey = np.full(x.shape, 128.0)
    for kx, ky, phase, amplitude in WAVES[:40]:
        grey += 6.0 * amplitude * np.sin(kx * x + ky * y + 3.0 * phase)
    return grey


def picture(shift_x, shift_y, gain: float = 1.0) -> np.ndarray:
    """Return a picture in which ground is displaced by functions of x, y."""
    x, y = np.meshgrid(RASTER.x, RASTER.y)
    return np.clip(gain * ground(x - shift_x(x), y - shift_y(x)), 0, 255).astype(np.uint8)


def test_a_shifted_picture_has_its_shift_as_error_and_none_after_a_rigid_fit() -> None:
    image = picture(lambda x: 0.33, lambda x: -0.21, gain=0.8)
    found = displacements(image, SEEN, RASTER, ground, (-30.0, 5.0))
    assert len(found.points) == found.patches == 8 * 3
    np.testing.assert_allclose(found.errors, np.tile([0.33, -0.21], (24, 1)), atol=0.01)
    assert found.rms_m() == pytest.approx(np.hypot(0.33, 0.21), abs=0.01)
    assert found.rigid_rms_m() < 0.01
    assert found.brightness == pytest.approx(0.8, abs=0.01)


def test_the_heading_is_removed_about_the_start_and_a_shift_is_not() -> None:
    start, yaw = np.array([200.0, -50.0]), 0.004
    points = np.random.default_rng(1).uniform(0.0, 100.0, (20, 2))
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    turned = (points - start) @ R.T + start - points
    for shift_m in (0.0, 1.0):
        outward = shift_m * (points - start) / np.linalg.norm(points - start, axis=1)[:, None]
        found = Displacements(points, turned + outward @ R.T, np.ones(20), 20, start)
        assert found.start_yaw_rms_m() == pytest.approx(shift_m, abs=1e-9)
        assert found.rms_m() > 0.5


@pytest.mark.slow
def test_errors_that_grow_slowly_are_followed_far() -> None:
    image = picture(lambda x: 0.08 * (x + 30.0), lambda x: 0.0 * x)
    found = displacements(image, SEEN, RASTER, ground, (-30.0, 5.0))
    assert len(found.points) >= 0.8 * found.patches
    true_x = found.points[:, 0]
    np.testing.assert_allclose(found.errors[:, 0], 0.08 * (true_x + found.errors[:, 0] + 30.0), atol=0.08)
    assert found.errors[:, 0].max() > 4.0  # nearly half of a patch


def test_what_is_not_in_the_truth_is_not_found() -> None:
    noise = np.random.default_rng(0).integers(0, 255, RASTER.shape).astype(np.uint8)
    part = Raster(0.1, -300, 50, 300, 200)
    found = displacements(noise[:200, :300], SEEN[:200, :300], part, ground, (0.0, 0.0))
    assert found.patches == 6
    assert len(found.points) == 0
    assert displacements(noise, ~SEEN, RASTER, ground, (0.0, 0.0)).patches == 0
