# SPDX-License-Identifier: Apache-2.0
"""The model has the shape of the surface and the colours of the ground, in the axes that each format prescribes."""

import dataclasses
import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from flown_scene import Scene, waves

from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.model import write_model
from uav_vslam.mapping.model.files import LARGEST_GLB_BYTES
from uav_vslam.mapping.model.triangles import mesh_of, simplified
from uav_vslam.mapping.orthomosaic import Orthomosaic
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.view import View

SPOT = (6.0, -4.0)  # x, y of a red square of 1.6 m
BLOCK = (-5.0, 3.0)  # of a block of 4 x 4 x 3 m
ROOF, WALL = (200.0, 60.0, 60.0), (30.0, 220.0, 220.0)  # BGR


def block(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    inside = (np.abs(x - BLOCK[0]) < 2.0) & (np.abs(y - BLOCK[1]) < 2.0)
    return np.where(inside, 3.0, 0.05 * x)


def colours(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    grey = np.repeat(60.0 + 0.2 * waves(x, y)[..., None], 3, axis=-1)
    away = np.maximum(np.abs(x - BLOCK[0]), np.abs(y - BLOCK[1]))
    spot = np.maximum(np.abs(x - SPOT[0]), np.abs(y - SPOT[1])) < 0.8
    grey[spot] = 20.0, 20.0, 230.0
    grey[away < 2.0] = WALL  # rays meet walls just inside the block
    grey[away < 1.85] = ROOF
    return grey


SCENE = Scene(block, colours)
EAST, NORTH = 500_000.0, 6_900_000.0


@pytest.fixture(scope="module")
def views() -> list[View]:
    """Four from above, and one that looks at the block's western wall."""
    above = [SCENE.view((x, y, 25.0)) for x in (-6.0, 2.0) for y in (-3.0, 3.0)]
    return [*above, SCENE.view((-20.0, 3.0, 20.0), (0.0, -35.0, 0.0))]


@pytest.fixture(scope="module")
def made(views: list[View], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    mosaic = Orthomosaic(SCENE, 0.1)
    for view in views:
        mosaic.add(view)
    written = write_model(SCENE, mosaic.picture(), folder, views=views, cell_m=0.5)
    assert written["bytes"] == (folder / "model.glb").stat().st_size <= LARGEST_GLB_BYTES
    return folder


def baked(path: Path) -> dict[str, trimesh.Trimesh]:
    """Return the geometries of a GLB in the file's own axes, transforms applied."""
    scene = trimesh.load(path)
    return {
        name: scene.geometry[geometry].copy().apply_transform(T)
        for name in scene.graph.nodes_geometry
        for T, geometry in [scene.graph[name]]
    }


def test_glb_is_y_up_and_has_the_extent_of_what_was_seen(made: Path) -> None:
    ground = baked(made / "model.glb")["ground"]
    x, y, z = ground.vertices.T
    tops = ground.vertices[y > 2.8]
    np.testing.assert_allclose(tops[:, [0, 2]].mean(axis=0), [BLOCK[0], -BLOCK[1]], atol=0.3)  # z points south
    assert y.max() == pytest.approx(3.0, abs=0.1)
    assert x.max() > 12.0
    assert -z.min() > 12.0


def test_a_coloured_spot_is_at_its_place_in_the_texture(made: Path) -> None:
    ground = baked(made / "model.glb")["ground"]
    picture = np.asarray(ground.visual.material.baseColorTexture.convert("RGB")).astype(int)
    row, column = np.argwhere((picture[..., 0] > 180) & (picture[..., 1] < 90)).mean(axis=0)
    uv = np.array([(column + 0.5) / picture.shape[1], 1.0 - (row + 0.5) / picture.shape[0]])
    plane = np.column_stack([ground.visual.uv, np.ones(len(ground.vertices))])
    to_place, *_ = np.linalg.lstsq(plane, ground.vertices, rcond=None)  # x and z are linear in u, v
    x, _, z = np.array([*uv, 1.0]) @ to_place
    assert (x, -z) == pytest.approx(SPOT, abs=0.15)


def test_the_texture_is_a_jpeg_and_both_sides_are_drawn(made: Path) -> None:
    content = (made / "model.glb").read_bytes()
    tree = json.loads(content[20 : 20 + struct.unpack("<I", content[12:16])[0]])
    assert [image["mimeType"] for image in tree["images"]] == ["image/jpeg"]
    assert tree["materials"][0]["doubleSided"]


def test_walls_are_upright_and_have_the_colour_of_the_oblique_view(made: Path) -> None:
    walls = baked(made / "model.glb")["walls"]
    assert np.abs(walls.face_normals[:, 1]).max() < 0.4
    western = walls.face_normals[:, 0] < -0.9
    assert walls.area_faces[western].sum() == pytest.approx(4.0 * 3.2, rel=0.1)
    centres = walls.triangles_center[western]
    assert centres[:, 0] == pytest.approx(BLOCK[0] - 2.0, abs=0.3)
    found = np.average(walls.visual.face_colors[western][:, :3], axis=0, weights=walls.area_faces[western])
    assert np.abs(found - WALL[::-1]).max() < 50.0


def test_ply_is_z_up_with_colours_of_vertices(made: Path) -> None:
    ply = trimesh.load(made / "model.ply")
    spot = np.maximum(np.abs(ply.vertices[:, 0] - SPOT[0]), np.abs(ply.vertices[:, 1] - SPOT[1])) < 0.55
    assert spot.any()
    red, green, blue, _ = ply.visual.vertex_colors[spot].astype(int).T
    assert (red > 180).all()
    assert (np.maximum(green, blue) < 90).all()
    np.testing.assert_allclose(ply.vertices[spot][:, 2], 0.05 * ply.vertices[spot][:, 0], atol=0.05)


def test_the_model_of_a_map_in_utm_is_as_exact(made: Path, views: list[View], tmp_path: Path) -> None:
    """Single precision has steps of 0.5 m at its northings."""
    scene = Scene(lambda x, y: block(x - EAST, y - NORTH), lambda x, y: colours(x - EAST, y - NORTH))
    mosaic = Orthomosaic(scene, 0.1)
    for view in views:
        moved = Pose(view.T_map_cam.R, view.T_map_cam.t + np.array([EAST, NORTH, 0.0]))
        mosaic.add(dataclasses.replace(view, T_map_cam=moved))
    written = write_model(scene, mosaic.picture(), tmp_path, views=(), cell_m=0.5)
    near, far = (baked(folder / "model.glb")["ground"] for folder in (made, tmp_path))
    np.testing.assert_allclose(far.vertices - [EAST, 0.0, -NORTH], near.vertices, atol=1e-3)
    near, far = (trimesh.load(folder / "model.ply") for folder in (made, tmp_path))
    moved_m = np.array(written["ply_origin_m"]) - [EAST, NORTH, 0.0]
    np.testing.assert_allclose(far.vertices + moved_m, near.vertices, atol=1e-3)


def test_an_even_surface_needs_few_triangles_and_keeps_its_heights() -> None:
    raster = Raster(0.5, 0, 0, 60, 60)
    x, y = np.meshgrid(raster.x, raster.y)
    mesh = mesh_of(0.1 * x + 2.0 * (np.abs(x - 15.0) < 4.0) * (np.abs(y - 15.0) < 4.0), raster)
    few = simplified(mesh, 400)
    assert len(few.faces) <= 400 < len(mesh.faces)
    rays = np.column_stack([x[5:55:9, 5:55:9].ravel(), y[5:55:9, 5:55:9].ravel(), np.full(36, 50.0)])
    hit = _heights_below(few, rays)
    expected = 0.1 * rays[:, 0] + 2.0 * (np.abs(rays[:, 0] - 15.0) < 4.0) * (np.abs(rays[:, 1] - 15.0) < 4.0)
    np.testing.assert_allclose(hit, expected, atol=0.08)


def _heights_below(mesh, points: np.ndarray) -> np.ndarray:
    """Return the highest triangle's height at each x, y."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    found = np.full(len(points), -np.inf)
    for i, (x, y, _) in enumerate(points):
        area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        with np.errstate(divide="ignore", invalid="ignore"):
            s = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
            t = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
            inside = (s >= 0) & (t >= 0) & (s + t <= 1) & (np.abs(area) > 1e-9)
            height = a[:, 2] + s * (b[:, 2] - a[:, 2]) + t * (c[:, 2] - a[:, 2])
        found[i] = height[inside].max(initial=-np.inf)
    return found


def test_walls_stand_where_heights_jump_and_gaps_stay_open() -> None:
    heights = np.zeros((6, 8))
    heights[2:4, 3:5] = 4.0
    heights[0, 7] = np.nan
    mesh = mesh_of(heights, Raster(1.0, 10, 20, 8, 6))
    walls = mesh.part(mesh.steep)
    a, b, c = (walls.vertices[walls.faces[:, k]] for k in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert areas.sum() == pytest.approx(4 * 2.0 * 4.0)
    outward = walls.normals[:, :2] * (walls.vertices[walls.faces].mean(axis=1)[:, :2] - [14.0, 23.0])
    assert (outward.sum(axis=1) > 0).all()  # away from the middle of the block
    tops = mesh.part(~mesh.steep)
    assert (tops.normals[:, 2] > 0.99).all()
    assert len(tops.faces) == 2 * (6 * 8 - 1)
    assert mesh.vertices.min(axis=0) == pytest.approx([10.0, 20.0, 0.0])
    assert len(mesh_of(np.full((3, 3), np.nan), Raster(1.0, 0, 0, 3, 3)).faces) == 0


def test_a_surface_that_is_not_known_under_the_mosaic_is_an_error(views: list[View], tmp_path: Path) -> None:
    mosaic = Orthomosaic(SCENE, 0.1)
    mosaic.add(views[0])
    with pytest.raises(UavVslamError, match="no height is known"):
        write_model(Scene(lambda x, y: np.full_like(x, np.nan)), mosaic.picture(), tmp_path, views=(), cell_m=0.5)
