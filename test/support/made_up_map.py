# SPDX-License-Identifier: Apache-2.0
"""A made-up map of a flight, as mapping writes it: pictures, figures, and a textured model with z up."""

import json
import struct
from pathlib import Path

import cv2
import numpy as np

SUMMARY = {
    "cell_m": 0.5,
    "gsd_m": 0.05,
    "bounds_m": [-20.0, -60.0, 180.0, 40.0],
    "vehicles": {"uav1": {"views": 64, "share": 0.52}, "uav2": {"views": 60, "share": 0.48}},
    "surface": {"cells": 80000, "coverage": 0.97, "filled": 0.01, "median_sigma_m": 0.034, "height_m": [-2.0, 7.5]},
    "orthomosaic": {"m_per_px": 0.1, "width": 2000, "height": 1000, "seam_px": 1200},
    "model": {"triangles": 1800, "bytes": 1},
    "accuracy": {"ce90_m": 0.21, "le90_m": 0.33, "claimed": True},
    "frame": "world",
    "north_up": True,
}
SIDE = 30  # cells of the model's surface


def write_map(folder: Path) -> Path:
    """Write a map into RESULT/map/ and return its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "map.json").write_text(json.dumps(SUMMARY))
    picture = ground(2000, 1000)
    relief = cv2.applyColorMap(picture[:, :, 1], cv2.COLORMAP_VIRIDIS)
    for name, image in (("orthomosaic.jpg", picture), ("height.png", relief), ("overlap.png", relief[::2, ::2])):
        assert cv2.imwrite(str(folder / name), image)
    (folder / "model.glb").write_bytes(model(cv2.imencode(".jpg", picture)[1].tobytes()))
    return folder


def ground(width: int, height: int) -> np.ndarray:
    """Return a coloured picture (H, W, 3) with fields and noise."""
    rng = np.random.default_rng(3)
    fields = cv2.resize(rng.uniform(60, 200, (6, 12, 3)), (width, height), interpolation=cv2.INTER_NEAREST)
    noise = cv2.resize(rng.normal(0, 12, (height // 4, width // 4, 3)), (width, height))
    return np.clip(fields + noise, 0, 255).astype(np.uint8)


def model(texture_jpeg: bytes) -> bytes:
    """Return a wavy surface of 200 x 100 m with a texture as binary glTF."""
    u, v = (values.ravel() for values in np.meshgrid(np.linspace(0, 1, SIDE + 1), np.linspace(0, 1, SIDE + 1)))
    height = 4.0 * np.sin(9.0 * u) * np.cos(7.0 * v)
    places = np.stack([200.0 * u - 20.0, 100.0 * v - 60.0, height], axis=1).astype("<f4")
    texels = np.stack([u, 1.0 - v], axis=1).astype("<f4")
    row, column = (cells.ravel() for cells in np.indices((SIDE, SIDE)))
    corner = row * (SIDE + 1) + column
    corners = np.stack([corner, corner + 1, corner + SIDE + 2, corner, corner + SIDE + 2, corner + SIDE + 1], axis=1)
    return _glb(places, texels, corners.astype("<u2"), texture_jpeg)


def _glb(places: np.ndarray, texels: np.ndarray, corners: np.ndarray, texture_jpeg: bytes) -> bytes:
    parts = [places.tobytes(), texels.tobytes(), corners.tobytes(), texture_jpeg]
    views, body = [], b""
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(part)})
        body += part + bytes(-len(part) % 4)
    low, high = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0}}],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 3, "mimeType": "image/jpeg"}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(places), "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": 5126, "count": len(texels), "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": corners.size, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
