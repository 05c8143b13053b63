# SPDX-License-Identifier: Apache-2.0
"""Height truth, labels and pictures of the ground agree with what rays from a camera meet."""

import dataclasses

import cv2
import numpy as np
import pytest
from first_hits import first_hits
from numpy.typing import NDArray

from uav_vslam.simulation.farm_texture import LitTexture
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.simulation.shading import LUMINANCE, SHADOW, TO_SUN
from uav_vslam.simulation.solids import Label
from uav_vslam.simulation.terrain import Ground, ground_of

Array = NDArray[np.float64]

FARM = dataclasses.replace(SCENARIOS["kagaru"], seed=3, objects=True)
CAMERA = np.array([50.0, -30.0, 70.0])
EVEN_GREY = 120
HEIGHT_M = 2e-3  # to which rays meet the relief, in single precision


@pytest.fixture(scope="module")
def ground() -> Ground:
    return ground_of(FARM)


def window(side_m: float, step_m: float, middle: Array = CAMERA) -> tuple[Array, Array]:
    at = np.arange(-0.5 * side_m, 0.5 * side_m, step_m) + 0.5 * step_m
    x, y = np.meshgrid(middle[0] + at, middle[1] + at)
    return x, y


def fan(count: int, tangent: float) -> Array:
    """Return (count, 3) downward rays up to a tangent away from the vertical along each axis."""
    return np.column_stack([np.random.default_rng(1).uniform(-tangent, tangent, (count, 2)), -np.ones(count)])


def beside_barn(ground: Ground, middle: Array, direction: Array) -> Array:
    """Return the (2,) place half a metre beside a barn, in a direction from its middle."""
    at = np.arange(0.0, 15.0, 0.1)
    labels = ground.labels(middle[0] + at * direction[0], middle[1] + at * direction[1])
    return np.asarray(middle + (at[labels != Label.BARN][0] + 0.5) * direction)


def test_the_top_surface_is_where_vertical_rays_end(ground: Ground) -> None:
    x, y = window(100.0, 2.5)
    height, labels = ground.height(x, y), ground.labels(x, y)
    for place in np.ndindex(x.shape):
        above = np.array([x[place], y[place], 60.0])
        point, label = first_hits(ground, above, np.array([0.0, 0.0, -3.0]))
        assert point[2] == pytest.approx(height[place], abs=HEIGHT_M)
        assert label == labels[place]
    assert set(np.unique(labels)) >= {Label.GROUND, Label.HEDGE, Label.TREE, Label.BARN}


def test_oblique_rays_end_on_the_top_surface_or_on_a_wall_and_pass_through_air(ground: Ground) -> None:
    rays = fan(4000, 0.8)
    points, labels = first_hits(ground, CAMERA, rays)
    above = ground.height(points[:, 0], points[:, 1]) - points[:, 2]
    on_top = np.abs(above) < HEIGHT_M
    outside = (
        points + 2e-3 * np.array([1.0, 1.0, 0.0]) * (CAMERA - points) / np.linalg.norm(CAMERA - points, axis=1)[:, None]
    )
    on_wall = ground.height(outside[:, 0], outside[:, 1]) < points[:, 2] + HEIGHT_M
    assert (on_top | on_wall).all()
    assert on_top.mean() > 0.9
    assert (labels[~on_top] != Label.GROUND).all()
    for share in np.linspace(0.8, 0.998, 100):
        way = CAMERA + share * (points - CAMERA)
        assert (ground.height(way[:, 0], way[:, 1]) < way[:, 2] + HEIGHT_M).all()


def test_the_ground_behind_a_barn_is_hidden_and_in_front_of_it_is_not(ground: Ground) -> None:
    middle = ground.barns(-60.0, -90.0, 160.0, 30.0)[0].mean(axis=0)
    for angle in np.arange(0.0, 2.0 * np.pi, 0.5):
        away = np.array([np.cos(angle), np.sin(angle)])
        eye = np.append(middle + 60.0 * away, 50.0)
        seen = []
        for direction in (-away, away):
            xy = beside_barn(ground, middle, direction)
            target = np.append(xy, ground.relief.height(xy[:1], xy[1:]))
            point, label = first_hits(ground, eye, target - eye)
            seen.append((bool(np.linalg.norm(point - target) < 0.1), int(label)))
        assert seen == [(False, Label.BARN), (True, Label.GROUND)]


def test_footprints_are_where_barns_are_labelled(ground: Ground) -> None:
    step = 0.5
    x, y = window(120.0, step)
    footprints = ground.barns(x.min(), y.min(), x.max(), y.max())
    assert len(footprints) > 1
    mask = np.zeros(x.shape, np.uint8)
    for footprint in footprints:
        cells = (footprint - [x.min(), y.min()]) / step
        cv2.fillConvexPoly(mask, np.rint(cells * 256).astype(np.int32), 1, shift=8)
    barn = ground.labels(x, y) == Label.BARN
    border = cv2.dilate(mask, np.ones((3, 3), np.uint8)) - cv2.erode(mask, np.ones((3, 3), np.uint8))
    inner = np.pad(border[1:-1, 1:-1], 1, constant_values=1) == 0
    np.testing.assert_array_equal(barn[inner], (mask == 1)[inner])


def test_the_picture_is_dark_on_the_side_of_a_barn_away_from_the_sun(ground: Ground) -> None:
    assert ground.farm is not None
    even = dataclasses.replace(ground, texture=LitTexture(Even(), ground.farm))
    away = -TO_SUN[:2] / np.hypot(TO_SUN[0], TO_SUN[1])
    for footprint in ground.barns(-60.0, -90.0, 160.0, 30.0):
        middle = footprint.mean(axis=0)
        xy = np.array([beside_barn(ground, middle, direction) for direction in (away, -away)])
        np.testing.assert_allclose(even.grey(xy[:, 0], xy[:, 1]), [SHADOW * EVEN_GREY, EVEN_GREY], atol=1.0)


class Even:
    """A grey ground without texture."""

    m_per_px = 0.05

    def window(self, x0: int, y0: int, x1: int, y1: int) -> NDArray[np.uint8]:
        return np.full((y1 - y0, x1 - x0), EVEN_GREY, np.uint8)


@pytest.mark.slow
def test_the_grey_picture_is_the_luminance_of_the_coloured_one(ground: Ground) -> None:
    x, y = window(60.0, 0.2)
    colour, grey = ground.colour(x, y), ground.grey(x, y)
    np.testing.assert_allclose(colour @ LUMINANCE, grey, atol=0.6)  # texels are whole grey levels
    assert colour.max() <= 255.0 + 1e-3
    assert np.abs(colour[..., 1] - colour[..., 0]).mean() > 20.0


def test_pictures_do_not_depend_on_the_window_or_the_order_of_places(ground: Ground) -> None:
    x, y = window(50.0, 0.4)
    colour, height = ground.colour(x, y), ground.height(x, y)
    mixed = np.random.default_rng(0).permutation(x.size)[:3000]
    again = ground_of(FARM)
    np.testing.assert_allclose(
        again.colour(x.ravel()[mixed], y.ravel()[mixed]), colour.reshape(-1, 3)[mixed], atol=1e-2
    )
    np.testing.assert_array_equal(again.height(x.ravel()[mixed], y.ravel()[mixed]), height.ravel()[mixed])


def test_bare_ground_has_its_relief_and_texture() -> None:
    bare = ground_of(dataclasses.replace(FARM, objects=False))
    x, y = window(20.0, bare.texture.m_per_px * 8)
    at = np.rint(np.stack([x, y]) / bare.texture.m_per_px).astype(int)
    x, y = at * bare.texture.m_per_px
    np.testing.assert_array_equal(bare.height(x, y), bare.relief.height(x, y))
    assert not bare.labels(x, y).any()
    assert bare.barns(-100.0, -100.0, 100.0, 100.0).shape == (0, 4, 2)
    texels = bare.texture.window(int(at[0].min()), int(at[1].min()), int(at[0].max()) + 1, int(at[1].max()) + 1)
    np.testing.assert_allclose(bare.grey(x, y), texels[::8, ::8], atol=1e-3)


def test_no_places_have_no_heights_and_colours(ground: Ground) -> None:
    none = np.zeros((0, 3))
    assert ground.height(none, none).shape == ground.labels(none, none).shape == (0, 3)
    assert ground.colour(none, none).shape == (0, 3, 3)
    assert first_hits(ground, CAMERA, np.zeros((0, 3)))[0].shape == (0, 3)
