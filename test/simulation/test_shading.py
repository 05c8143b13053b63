# SPDX-License-Identifier: Apache-2.0
"""Shadows fall away from the sun, as long as their cause is high; colours have the luminance of the grey values."""

import numpy as np
import pytest

from uav_vslam.simulation.ridged import Ridged
from uav_vslam.simulation.shading import (
    BRIGHTEST,
    LEAVES,
    LUMINANCE,
    ROOFS,
    SHADOW,
    TO_SUN,
    Shadows,
    light,
    shade,
    sunward,
    tint,
    tints,
)
from uav_vslam.simulation.solids import Face, Label

HIGH_M = 5.0
POST = Ridged(Label.POST, 2, -3.0, 30.0, 40.0, 0.0, 0.4, 0.4, HIGH_M, pitch=0.0)
BARN = Ridged(Label.BARN, 9, -3.0, 0.0, 0.0, 0.3, 14.0, 8.0, 6.0, pitch=0.4)


def test_the_shadow_lies_on_the_side_away_from_the_sun_and_is_as_long_as_the_sun_is_low() -> None:
    length = HIGH_M * np.hypot(TO_SUN[0], TO_SUN[1]) / TO_SUN[2]
    away = -TO_SUN[:2] / np.hypot(TO_SUN[0], TO_SUN[1])
    at = np.linspace(-2.0, 2.0, 401) * length
    points = np.column_stack([[30.0, 40.0] + at[:, None] * away, np.zeros_like(at)])
    dark = Shadows([POST]).fall_on(points)
    assert not dark[at < -0.3].any()
    assert dark[(at > 0.3) & (at < length - 0.3)].all()
    assert not dark[at > length + 0.3].any()


def test_shadows_agree_with_marching_towards_the_sun() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack(
        [rng.uniform(-12.0, 6.0, 1000), rng.uniform(-6.0, 12.0, 1000), rng.uniform(0.0, 4.0, 1000)]
    )
    points = points[points[:, 2] > BARN.top(points[:, 0], points[:, 1])]
    steps = points[:, None] + np.linspace(0.0, 12.0, 1201)[:, None] * TO_SUN
    depth = (BARN.top(steps[..., 0].ravel(), steps[..., 1].ravel()).reshape(steps.shape[:2]) - steps[..., 2]).max(
        axis=1
    )
    clear = np.abs(depth) > 0.02
    np.testing.assert_array_equal(Shadows([BARN]).fall_on(points)[clear], (depth > 0.0)[clear])
    assert 0.1 < (depth > 0.0).mean() < 0.9


def test_a_solid_is_in_the_shade_on_faces_away_from_the_sun_and_behind_another() -> None:
    assert light(np.array([[0.0, 0.0, 1.0], -TO_SUN]))[0] == pytest.approx(1.0)
    assert light(-TO_SUN[None])[0] == pytest.approx(SHADOW)
    point, face = np.array([[1.0, 1.0, float(BARN.top(np.ones(1), np.ones(1))[0])]]), np.array([Face.ROOF_NORTH])
    tower = Ridged(Label.BARN, 1, -3.0, 1.0 + 4.0, 1.0 - 4.0, 0.0, 4.0, 4.0, 30.0, pitch=0.0)
    alone = shade(BARN, point, face, Shadows([BARN]))
    behind = shade(BARN, point, face, Shadows([BARN, tower]))
    sunny = light(BARN.normals(point, face))[0]
    assert behind[0] / alone[0] == pytest.approx(SHADOW / sunny, rel=1e-5)


def test_all_that_shades_a_rectangle_is_looked_for() -> None:
    bounds = sunward((0.0, 0.0, 10.0, 10.0), HIGH_M)
    cause = np.array([[0.0, 0.0], [10.0, 10.0]])[:, None] + [[0.0, 0.0], HIGH_M * TO_SUN[:2] / TO_SUN[2]]
    np.testing.assert_allclose(bounds, [*cause.min(axis=(0, 1)), *cause.max(axis=(0, 1))])


def test_a_tint_has_luminance_one_and_leaves_room_for_the_brightest_grey() -> None:
    for one in (*ROOFS, *LEAVES, *tints(BARN, np.arange(6))):
        assert one @ LUMINANCE == pytest.approx(1.0, abs=1e-6)
        assert one.max() * BRIGHTEST <= 255.0 + 1e-3
    with pytest.raises(ValueError, match="weaker"):
        tint(255.0, 0.0, 0.0)
