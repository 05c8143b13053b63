# SPDX-License-Identifier: Apache-2.0
"""GLB and PLY of the model.

PLY has the map's axes (x east, y north, z up) and a colour per vertex. glTF prescribes y up: GLB has x east, y up,
z south, which three.js and other viewers show upright as it is. Coordinates are metres from the map's origin in both.
Both hold single precision, half a metre at the northings of UTM: far from the map's origin vertices are relative to a
point near them, to which GLB's nodes move them; of PLY, which has none, it is stated.
"""

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image as PillowImage

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.georeference import naming
from uav_vslam.mapping.model.triangles import Mesh, mesh_of, simplified
from uav_vslam.mapping.model.walls import wall_colours
from uav_vslam.mapping.orthomosaic.heights import Heights
from uav_vslam.mapping.orthomosaic.mosaic import Picture
from uav_vslam.mapping.orthomosaic.pyramid import fill
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.view import View
from uav_vslam.vision.images import to_bgr8

Array = NDArray[np.float64]

HIDDEN_M = 6.0  # width of hidden ground that still belongs to the model
LARGEST_GLB_BYTES = 3_000_000
TEXTURE_SHARE = 0.68  # of these
TRIANGLES = 30_000  # of GLB, about 22 bytes each
PLY_TRIANGLES = 200_000
LONGEST_TEXTURE_PX = 4096  # that every graphics card takes
FAR_M = 20_000.0  # from the map's origin, where single precision resolves 2 mm
Y_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def write_model(
    surface: Heights, picture: Picture, folder: Path, *, views: Iterable[View], cell_m: float
) -> dict[str, Any]:
    """Write `model.glb` and `model.ply`.

    Args:
        surface: heights in the map frame.
        picture: of the same ground, the whole mosaic.
        folder: to write to.
        views: for the colours of walls; without any, these are a shade of what is above them.
        cell_m: side of a cell of the mesh [m].

    Returns:
        "triangles" and "bytes" of the GLB; where it is not zero "ply_origin_m" (x, y, z), to which the PLY is relative.

    Raises:
        UavVslamError: no height is known under the picture, or a file can't be written.
    """
    raster = picture.raster.with_cells(cell_m)
    heights = np.where(_shown(picture, raster), surface.height(raster), np.float32(np.nan))
    mesh = mesh_of(heights, raster)
    if len(mesh.faces) == 0:
        raise UavVslamError(
            "the model has no triangle: no height is known under the mosaic; are cells (--cell) too large?"
        )
    colour = _closed(picture)
    coarse = simplified(mesh, TRIANGLES)
    walls = coarse.part(coarse.steep)
    shades = wall_colours(walls, _inside(walls, colour, picture.raster, cell_m), views, heights, raster)
    origin, glb, ply = _origin(picture.raster), folder / "model.glb", folder / "model.ply"
    scene = _scene(coarse.part(~coarse.steep), colour, picture.raster, walls, shades, origin)
    with naming(glb):
        glb.write_bytes(scene.export(file_type="glb"))
    coloured = _coloured(simplified(mesh, PLY_TRIANGLES), colour, picture.raster).apply_translation(-origin)
    with naming(ply):
        ply.write_bytes(coloured.export(file_type="ply"))
    moved = {"ply_origin_m": origin.tolist()} if origin.any() else {}
    return {"triangles": len(coarse.faces), "bytes": glb.stat().st_size} | moved


def _origin(raster: Raster) -> Array:
    """Return what the files' vertices are relative to: the map's origin, if that is not too far."""
    west, south, east, north = raster.bounds_m
    centre = np.array([0.5 * (west + east), 0.5 * (south + north), 0.0])
    return np.rint(centre) if np.abs(centre).max() > FAR_M else np.zeros(3)


def _shown(picture: Picture, raster: Raster) -> NDArray[np.bool_]:
    """Return (rows, columns) which cells the picture shows, or hides behind what stands among them."""
    centres = np.stack(np.meshgrid(raster.x, raster.y), axis=-1)
    seen = _looked_up(picture.seen, picture.raster, centres).astype(np.uint8)
    side = 2 * round(0.5 * HIDDEN_M / raster.cell_m) + 1
    return cv2.morphologyEx(seen, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)) > 0


def _closed(picture: Picture) -> NDArray[np.uint8]:
    """Return (rows, columns, 3) BGR in which ground that no view shows continues its surroundings."""
    filled = fill(to_bgr8(picture.image).astype(np.float32), picture.seen)
    return np.clip(np.rint(filled), 0, 255).astype(np.uint8)


def _inside(walls: Mesh, colour: NDArray[np.uint8], raster: Raster, cell_m: float) -> Array:
    """Return (F, 3) colours of what is above each wall, one cell behind its face."""
    centres = walls.vertices[walls.faces].mean(axis=1) - cell_m * walls.normals
    return _looked_up(colour, raster, centres)


def _looked_up(values: NDArray[np.generic], raster: Raster, points: Array) -> Array:
    """Return the values of the cells that are nearest to points."""
    row, column = (np.rint(k).astype(int) for k in raster.index(points))
    found = values[np.clip(row, 0, raster.rows - 1), np.clip(column, 0, raster.columns - 1)]
    return np.asarray(found, dtype=float)


def _scene(
    ground: Mesh, colour: NDArray[np.uint8], raster: Raster, walls: Mesh, shades: Array, origin: Array
) -> trimesh.Scene:
    scene, place = trimesh.Scene(), trimesh.transformations.translation_matrix(origin)
    if len(ground.faces):
        made = _textured(ground, colour, raster).apply_translation(-origin)
        scene.add_geometry(made, geom_name="ground", node_name="ground", transform=place)
    if len(walls.faces):
        corners = Mesh(walls.vertices[walls.faces].reshape(-1, 3), np.arange(walls.faces.size).reshape(-1, 3))
        rgba = _rgba(np.repeat(shades, 3, axis=0))
        made = trimesh.Trimesh(corners.vertices, corners.faces, vertex_colors=rgba, process=False)
        made.apply_translation(-origin)
        scene.add_geometry(made, geom_name="walls", node_name="walls", transform=place)
    scene.apply_transform(Y_UP)
    return scene


def _textured(mesh: Mesh, colour: NDArray[np.uint8], raster: Raster) -> trimesh.Trimesh:
    west, south, east, north = raster.bounds_m
    uv = (mesh.vertices[:, :2] - [west, south]) / [east - west, north - south]
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=_texture(colour), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
    )
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, visual=visual, process=False)


def _texture(colour: NDArray[np.uint8]) -> PillowImage.Image:
    """Return the picture with north first, as large as its share of the file allows once trimesh writes it as JPEG."""
    rgb = np.ascontiguousarray(colour[::-1, :, ::-1])
    scale = min(1.0, LONGEST_TEXTURE_PX / max(rgb.shape[:2]))
    while True:
        size = max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale))
        data = io.BytesIO()
        PillowImage.fromarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)).save(data, format="JPEG", quality=95)
        made = PillowImage.open(data)
        again = io.BytesIO()
        made.save(again, format="JPEG")
        if again.tell() <= TEXTURE_SHARE * LARGEST_GLB_BYTES:
            return made
        scale *= 0.85


def _coloured(mesh: Mesh, colour: NDArray[np.uint8], raster: Raster) -> trimesh.Trimesh:
    rgba = _rgba(_looked_up(colour, raster, mesh.vertices))
    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=rgba, process=False)


def _rgba(bgr: Array) -> NDArray[np.uint8]:
    opaque = np.full((len(bgr), 1), 255.0)
    return np.clip(np.rint(np.hstack([bgr[:, ::-1], opaque])), 0, 255).astype(np.uint8)
