# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.mapping.orthomosaic.exposure import Exposure
from uav_vslam.mapping.orthomosaic.rectification import Rectified
from uav_vslam.mapping.raster import Raster

SIDE, STEP = 20, 6  # cells of a thumbnail, and from one to the next
GROUND = np.random.default_rng(0).uniform(60.0, 140.0, (SIDE, 40000)).astype(np.float32)


def thumb(k: int, gain: float, rng: np.random.Generator, *, noise: float = 0.02) -> Rectified:
    raster = Raster(1.6, STEP * k, 0, SIDE, SIDE)
    x, y = np.meshgrid(*[(np.arange(SIDE) - 9.5) / 40.0] * 2)
    grey = GROUND[:, STEP * k : STEP * k + SIDE] * gain * np.exp(rng.normal(0.0, noise, (SIDE, SIDE)))
    score = np.ones((SIDE, SIDE), np.float32)
    return Rectified(raster, grey[..., None].astype(np.float32), score, (x**2 + y**2).astype(np.float32))


def test_a_long_chain_of_gains_does_not_drift_away() -> None:
    rng, exposure = np.random.default_rng(1), Exposure()
    found = np.array([exposure.add(thumb(k, 1.0, rng), "uav1").log_gain[0] for k in range(400)])
    assert np.abs(found).max() < 0.06
    assert np.abs(np.diff(found)).max() < 0.02  # between neighbours nothing is seen


def test_a_step_of_exposure_is_undone_at_once_and_forgotten_slowly() -> None:
    rng, exposure = np.random.default_rng(1), Exposure()
    gains = np.where(np.arange(40) < 20, 1.0, 1.4)
    found = np.array([exposure.add(thumb(k, gain, rng), "uav1").log_gain[0] for k, gain in enumerate(gains)])
    assert found[20] == pytest.approx(-np.log(1.4), abs=0.02)
    together = found + np.log(gains)
    assert np.abs(np.diff(together)).max() < 0.02


def test_outliers_such_as_moving_shadows_do_not_count() -> None:
    rng, exposure = np.random.default_rng(1), Exposure()
    exposure.add(thumb(0, 1.0, rng), "uav1")
    second = thumb(1, 0.8, rng)
    second.image[:, :5] *= 0.4
    assert exposure.add(second, "uav1").log_gain[0] == pytest.approx(-np.log(0.8), abs=0.03)


def test_views_far_apart_keep_their_own_brightness() -> None:
    rng, exposure = np.random.default_rng(1), Exposure()
    exposure.add(thumb(0, 1.0, rng), "uav1")
    assert exposure.add(thumb(50, 2.0, rng), "uav1").log_gain[0] == 0.0
    exposure.solve()
    assert exposure.correction(1).log_gain[0] == pytest.approx(0.0)
    Exposure().solve()  # nothing to solve
