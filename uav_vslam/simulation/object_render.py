# SPDX-License-Identifier: Apache-2.0
"""Draws what stands on the ground into an image of the ground: exact rays, nearest first, smooth at edges.

A first pass casts one ray through each pixel of the rectangle around each solid. Where faces meet, and on walls, which
are seen at a flat angle, a second pass casts several rays per pixel and averages their light.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.shading import Shadows, shade, tints
from uav_vslam.simulation.solids import WALLS, Solid

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Box = tuple[slice, slice]  # rows, columns

SAMPLES = 16  # rays per pixel at edges
WALL_SAMPLES = 4  # and on walls
IN_FRONT_M = 1.0  # a solid nearer to the image plane may cover any pixel
FACES = 16  # more than there are
FLATTEST_RAY = -0.1  # greatest z in the world of a ray whose z in the camera is 1; flatter ones are clamped to it


@dataclass(slots=True)
class Hits:
    """What each ray meets first. Drops are depths below the camera [m], and parameters of rays with z = -1.

    Attributes:
        drop: (...) to the nearest surface; the ground's at first.
        which: (...) int16 index of the solid, -1 for the ground.
        face: (...) int8 face of the solid.
    """

    drop: Array
    which: NDArray[np.int16]
    face: NDArray[np.int8]

    @staticmethod
    def of_ground(drop: NDArray[np.floating]) -> "Hits":
        """Return rays that meet bare ground at given drops."""
        return Hits(np.array(drop, float), np.full(drop.shape, -1, np.int16), np.zeros(drop.shape, np.int8))

    def cast(self, k: int, solid: Solid, origin: Array, rays: Array, at: Box | NDArray[np.intp]) -> None:
        """Enter where rays from a (3,) origin, (..., 3) with z = -1 and in order of `self[at]`, meet solid `k`."""
        t_in, t_out, face = solid.interval(origin, rays.reshape(-1, 3))
        shape = rays.shape[:-1]
        nearer = ((t_in <= t_out) & (t_in > 0.0)).reshape(shape) & (t_in.reshape(shape) < self.drop[at])
        self.drop[at] = np.where(nearer, t_in.reshape(shape), self.drop[at])
        self.which[at] = np.where(nearer, k, self.which[at])
        self.face[at] = np.where(nearer, face.reshape(shape), self.face[at])


class SolidPainter:
    """Draws solids as one camera at one pose sees them."""

    def __init__(
        self,
        camera: PinholeCamera,
        T_world_cam: Pose,
        solids: list[Solid],
        *,
        samples: int = SAMPLES,
    ) -> None:
        """Prepare to draw.

        Args:
            camera: intrinsics, with lens distortion.
            T_world_cam: pose of the optical frame.
            solids: what may be in view, and all that keeps the sun away from it.
            samples: rays per pixel at edges.
        """
        self._camera, self._pose = camera, T_world_cam
        self._solids, self._shadows = solids, Shadows(solids)
        self._samples = samples
        self._boxes = [self._box(solid) for solid in solids]

    def draw(self, image: Image, ground_drop: NDArray[np.floating]) -> Image:
        """Return an image of the ground, (H, W) grey or (H, W, 3) BGR, with the solids in it.

        Args:
            image: of the ground alone.
            ground_drop: (H, W) depth of the ground below the camera at each pixel [m].
        """
        hits = Hits.of_ground(ground_drop)
        for k, (solid, box) in enumerate(zip(self._solids, self._boxes, strict=True)):
            if box is not None:
                hits.cast(k, solid, self._pose.t, self._rays(_pixels_in(box)), box)
        edge = _edges(hits)
        wall = (hits.which >= 0) & np.isin(hits.face, WALLS) & ~edge
        out = image.copy()
        for pixels, samples in ((edge, self._samples), (wall, WALL_SAMPLES), (~edge & ~wall & (hits.which >= 0), 1)):
            at = np.nonzero(pixels)
            out[at] = self._finely(at, ground_drop[at], image[at], pixel_samples(samples))
        return out

    def _finely(
        self, at: tuple[NDArray[np.intp], ...], ground_drop: NDArray[np.floating], ground: Image, offsets: Array
    ) -> Image:
        """Return the (K,) or (K, 3) light of pixels at rows and columns, averaged over rays through (n, 2) offsets."""
        n = len(offsets)
        rows, columns = at
        pixels = np.stack([columns, rows], axis=-1)[:, None] + offsets
        rays = self._rays(pixels.reshape(-1, 2)).reshape(-1, n, 3)
        hits = Hits.of_ground(np.repeat(ground_drop[:, None], n, axis=1))
        for k, (solid, box) in enumerate(zip(self._solids, self._boxes, strict=True)):
            if box is not None:
                inside = np.flatnonzero(_in_box(rows, columns, box))
                hits.cast(k, solid, self._pose.t, rays[inside], inside)
        flat = rays.reshape(-1, 3)
        under = np.repeat(ground, n, axis=0)
        light = self._light(hits.drop.ravel(), hits.which.ravel(), hits.face.ravel(), flat, under)
        return np.asarray(light.reshape(-1, n, *ground.shape[1:]).mean(axis=1))

    def _light(
        self, drop: Array, which: NDArray[np.int16], face: NDArray[np.int8], rays: Array, ground: Image
    ) -> Image:
        """Return the (N,) or (N, 3) light that comes along rays; `ground` is what they would show of the ground."""
        out = ground.copy()
        order = np.argsort(which, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(which[order])) + 1):
            if len(rows) and (k := int(which[rows[0]])) >= 0:
                solid, points = self._solids[k], self._pose.t + drop[rows, None] * rays[rows]
                grey = shade(solid, points, face[rows], self._shadows)
                out[rows] = grey if ground.ndim == 1 else grey[:, None] * tints(solid, face[rows])
        return out

    def _rays(self, pixels: Array) -> Array:
        """Return (..., 3) world rays with z = -1 through (..., 2) raw pixels."""
        rays = self._camera.bearings(self._camera.undistort(pixels)) @ self._pose.R.T
        return np.asarray(rays / -np.minimum(rays[..., 2:], FLATTEST_RAY) * [1.0, 1.0, 0.0] - [0.0, 0.0, 1.0])

    def _box(self, solid: Solid) -> Box | None:
        """Return a rectangle of the image that contains a solid, None if it is out of view."""
        west, south, east, north = solid.bounds
        heights = solid.foot_z, solid.highest_z
        corners = np.array([[x, y, z] for x in (west, east) for y in (south, north) for z in heights])
        in_cam = self._pose.inverse().apply(corners)
        width, height = self._camera.size
        if in_cam[:, 2].min() < IN_FRONT_M:
            return slice(0, height), slice(0, width)
        seen = self._camera.distort(self._camera.project(in_cam))
        low, high = np.floor(seen.min(axis=0)).astype(int) - 1, np.ceil(seen.max(axis=0)).astype(int) + 2
        low, high = np.maximum(low, 0), np.minimum(high, [width, height])
        return None if (low >= high).any() else (slice(low[1], high[1]), slice(low[0], high[0]))


def pixel_samples(count: int) -> Array:
    """Return (count, 2) places inside a pixel, evenly spread along each axis and over it; a power of two."""
    k = np.arange(count)
    bits = count.bit_length() - 1
    mirrored = sum(((k >> b) & 1) << (bits - 1 - b) for b in range(bits))
    return (np.stack([k, mirrored + np.zeros_like(k)], axis=-1) + 0.5) / count - 0.5


def _edges(hits: Hits) -> NDArray[np.bool_]:
    """Return which pixels are beside another face."""
    key = np.where(hits.which >= 0, hits.which.astype(np.int32) * FACES + hits.face, -1)
    out = np.zeros(key.shape, bool)
    across, down = key[:, 1:] != key[:, :-1], key[1:] != key[:-1]
    out[:, 1:] |= across
    out[:, :-1] |= across
    out[1:] |= down
    out[:-1] |= down
    return out


def _pixels_in(box: Box) -> Array:
    """Return the (rows, columns, 2) pixels of a box."""
    u, v = np.arange(box[1].start, box[1].stop, dtype=float), np.arange(box[0].start, box[0].stop, dtype=float)
    return np.stack(np.meshgrid(u, v), axis=-1)


def _in_box(rows: NDArray[np.intp], columns: NDArray[np.intp], box: Box) -> NDArray[np.bool_]:
    return (rows >= box[0].start) & (rows < box[0].stop) & (columns >= box[1].start) & (columns < box[1].stop)
