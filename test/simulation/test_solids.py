# SPDX-License-Identifier: Apache-2.0
"""Where lines meet solids agrees with where the solids' top surface is."""

import numpy as np
import pytest
from numpy.typing import NDArray
from ridged_roof import roof_corners

from uav_vslam.simulation.dome import Dome
from uav_vslam.simulation.ridged import Ridged
from uav_vslam.simulation.solids import Face, Label, Solid

BARN = Ridged(Label.BARN, 1, -3.0, 12.0, -7.0, 0.6, 14.0, 8.0, 6.0, pitch=0.4, climb=0.05)
POST = Ridged(Label.POST, 2, -3.0, 3.0, 4.0, 0.2, 0.3, 0.3, 5.0, pitch=0.0)
CROWN = Dome(Label.TREE, 3, -3.0, -5.0, 8.0, 2.5, rim_z=3.0, rise_m=4.0)
SOLIDS = pytest.mark.parametrize("solid", [BARN, POST, CROWN], ids=["barn", "post", "crown"])
DOWN = np.array([0.0, 0.0, -1.0])
STEP_M = 1e-6


def around(solid: Solid, count: int, seed: int = 0) -> NDArray[np.float64]:
    """Return (count, 3) random points in and around a solid above z = 0."""
    west, south, east, north = solid.bounds
    margin = 0.15 * (east - west)
    low, high = np.array([west, south, 0.0]) - [margin, margin, 0.0], np.array([east, north, solid.highest_z]) + margin
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def inside(solid: Solid, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(points[:, 2] < solid.top(points[:, 0], points[:, 1]))


def lines(solid: Solid, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return origins outside, and directions up, down and sideways that mostly point at the solid."""
    directions = np.random.default_rng(5).normal(size=(count, 3))
    return around(solid, count, seed=1) - 30.0 * directions, directions


@SOLIDS
def test_a_vertical_line_enters_at_the_top_surface(solid: Solid) -> None:
    points = around(solid, 2000) * [1.0, 1.0, 0.0] + [0.0, 0.0, 50.0]
    t_in, t_out, _ = solid.interval(points, DOWN)
    top = solid.top(points[:, 0], points[:, 1])
    np.testing.assert_array_equal(t_in <= t_out, np.isfinite(top))
    np.testing.assert_allclose(50.0 - t_in[np.isfinite(top)], top[np.isfinite(top)], atol=1e-6)
    assert 0.2 < np.isfinite(top).mean() < 0.9


@SOLIDS
def test_a_line_is_inside_exactly_between_where_it_enters_and_leaves(solid: Solid) -> None:
    origins, directions = lines(solid, 3000)
    t_in, t_out, _ = solid.interval(origins, directions)
    for t in np.linspace(20.0, 40.0, 101):
        points = origins + t * directions
        clear = (np.abs(t - t_in) > STEP_M) & (np.abs(t - t_out) > STEP_M)
        np.testing.assert_array_equal(inside(solid, points)[clear], ((t > t_in) & (t < t_out))[clear])
    assert (t_in < t_out).mean() > 0.3


@SOLIDS
def test_normals_point_out_of_the_face_that_is_entered(solid: Solid) -> None:
    origins, directions = lines(solid, 3000)
    t_in, t_out, faces = solid.interval(origins, directions)
    hit = t_in < t_out - 1e-3
    points = (origins + t_in[:, None] * directions)[hit]
    normals = solid.normals(points, faces[hit])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert (np.einsum("ij,ij->i", normals, directions[hit]) < 0.0).all()
    off_edges = inside(solid, points - 1e-4 * normals) & ~inside(solid, points + 1e-4 * normals)
    assert off_edges.mean() > 0.98  # within 0.1 mm of an edge the step may leave through another face
    assert len(np.unique(faces[hit])) > 1


def test_a_barns_corners_lie_on_its_roof() -> None:
    corners = roof_corners(BARN)
    inwards = corners + 1e-9 * ([BARN.x, BARN.y, 0.0] - corners)
    np.testing.assert_allclose(BARN.top(inwards[:, 0], inwards[:, 1]), corners[:, 2], atol=1e-6)
    assert corners[:, 2].max() == pytest.approx(BARN.highest_z)
    sides = np.linalg.norm(np.diff(BARN.footprint, axis=0, append=BARN.footprint[:1]), axis=1)
    np.testing.assert_allclose(sides, [14.0, 8.0, 14.0, 8.0])
    x, y = BARN.footprint.T
    assert 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)) == pytest.approx(14.0 * 8.0)  # counter-clockwise


def test_a_level_line_beside_a_wall_misses() -> None:
    along = np.array([np.cos(BARN.heading_rad), np.sin(BARN.heading_rad), 0.0])
    across = np.array([-along[1], along[0], 0.0])
    beside = np.array([BARN.x, BARN.y, 1.0]) + np.array([[4.01], [3.99]]) * across - 50.0 * along
    t_in, t_out, faces = BARN.interval(beside, along)
    np.testing.assert_array_equal(t_in <= t_out, [False, True])
    assert t_in[1] == pytest.approx(50.0 - 7.0)
    assert faces[1] == Face.WEST_A


def test_the_northern_side_of_a_roof_faces_north_of_its_ridge() -> None:
    across = np.array([-np.sin(BARN.heading_rad), np.cos(BARN.heading_rad), 0.0])
    eyes = np.array([BARN.x, BARN.y, 20.0]) + np.array([[1.0], [-1.0]]) * across
    _, _, faces = BARN.interval(eyes, DOWN)
    np.testing.assert_array_equal(faces, [Face.ROOF_NORTH, Face.ROOF_SOUTH])
    np.testing.assert_array_equal(np.sign(BARN.normals(eyes, faces) @ across), [1.0, -1.0])
