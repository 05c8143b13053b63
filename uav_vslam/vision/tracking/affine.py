# SPDX-License-Identifier: Apache-2.0
"""Finds patches of an earlier image again, though the view has changed: by affine alignment.

Optical flow moves a window without changing its shape. Where the camera turns, comes closer or looks along a surface,
the window then shows other ground, and its best place is off. Here the patch may be stretched, sheared and turned, too:
the pixel at offset o from the centre of a patch that was cut is now at pixel + shape o. All patches are aligned at
once by inverse composition [baker04], and compared without their means and contrasts. Images are grey levels, pixels
(u, v) of the raw image. All is in float32, as the samples are: a hundredth of a pixel is exact enough.
"""

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.tracking.flow import inside

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

HALF_PX = 10  # of a patch: with 7, errors are a half larger, with 14 a fifth smaller for a third more time
STEPS = 5  # with 3, errors after 16 frames are a tenth larger
LONGEST_STEP_PX = 3.0  # of the place, and at the edge
STILL_PX = 0.01  # a step, of the place and at the edge: the last one (0.05: places lean towards their guesses)
# On shape and place, of the mean curvature: a patch with edges in one direction leaves both open, and stays put.
SHAPE_DAMPING, PLACE_DAMPING = 0.05, 0.01
LEAST_CONTRAST = 1.0  # length of the grey levels without their mean: flat ones have no direction
LEAST_CORRELATION = 0.8  # 0.6 and 0.9 do as well
MOST_SCALED = 2.0  # in any direction: beyond, a patch shows other detail

_SQUARE = np.mgrid[-HALF_PX : HALF_PX + 1, -HALF_PX : HALF_PX + 1].astype(np.float32)
_V, _U = _SQUARE[:, _SQUARE.sum(axis=0) % 2 == 0]  # every second pixel: half the time, errors a tenth larger
_GRID: Floats = np.stack([_U, _V, np.ones_like(_U)])
_SHAPE_PX = np.float32(HALF_PX)  # unit of the shape's parameters: displacement at the edge of the patch


@dataclass(frozen=True, slots=True)
class Patches:
    """N patches of M pixels.

    Attributes:
        values: (N, M) of mean zero and length one.
        gain: (N, M, 6) by which a difference of values is multiplied for a step of shape (4) and place (2).
    """

    values: Floats
    gain: Floats

    @classmethod
    def none(cls) -> Self:
        """Return no patches."""
        return cls(np.zeros((0, _U.size), np.float32), np.zeros((0, _U.size, 6), np.float32))

    @classmethod
    def cut(cls, image: Floats, pixels: Array) -> Self:
        """Cut the patches around (N, 2) pixels, where they must fit in, out of an (H, W) image."""
        if len(pixels) == 0:
            return cls.none()
        shape = undeformed(len(pixels))
        by_u, by_v = (
            _sampled(image, pixels + half, shape) - _sampled(image, pixels - half, shape)
            for half in np.array([[0.5, 0.0], [0.0, 0.5]])
        )
        values, contrast = _normalised(_sampled(image, pixels, shape))
        to_edge = [each * along / _SHAPE_PX for each in (by_u, by_v) for along in (_U, _V)]
        J = np.stack([*to_edge, by_u, by_v], axis=-1) / contrast[..., None]
        J -= J.mean(axis=1, keepdims=True)
        J -= values[..., None] * (values[:, None] @ J)
        H = (np.swapaxes(J, 1, 2) @ J).astype(np.float64)
        curvature = np.trace(H, axis1=1, axis2=2)[:, None] / 6.0
        damping = np.array([SHAPE_DAMPING] * 4 + [PLACE_DAMPING] * 2)
        H[:, np.arange(6), np.arange(6)] += curvature * damping + np.finfo(np.float32).tiny
        return cls(values, np.asarray(J @ np.linalg.inv(H).astype(np.float32), np.float32))

    def __len__(self) -> int:
        return len(self.values)

    def chosen(self, rows: NDArray[np.generic]) -> "Patches":
        """Return some of the patches, by rows or mask."""
        return Patches(self.values[rows], self.gain[rows])

    def joined(self, other: "Patches") -> "Patches":
        """Return these patches and then others."""
        return Patches(np.concatenate([self.values, other.values]), np.concatenate([self.gain, other.gain]))

    def found(self, image: Floats, pixels: Array, shape: Floats, *, settled_px: float) -> tuple[Array, Floats, Mask]:
        """Find the patches in another image.

        Args:
            image: (H, W) grey levels.
            pixels: (N, 2) where they should be, within a few pixels.
            shape: (N, 2, 2) how they should be deformed.
            settled_px: largest last step of a patch that has been found.

        Returns:
            (N, 2) pixels and (N, 2, 2) shapes.
            (N,) which patches have been found.
        """
        if len(self) == 0:
            return pixels, shape, np.zeros(0, bool)
        pixels, shape = pixels.copy(), shape.copy()
        last_px, alike = np.full(len(self), np.inf), np.zeros(len(self))
        moving, patches = np.arange(len(self)), self
        for _ in range(STEPS):
            values = _normalised(_sampled(image, pixels[moving], shape[moving]))[0]
            alike[moving] = np.einsum("nm,nm->n", values, patches.values)
            step = ((values - patches.values)[:, None] @ patches.gain)[:, 0].clip(-LONGEST_STEP_PX, LONGEST_STEP_PX)
            shape[moving] = np.matmul(shape[moving], _inverse_step(step[:, :4].reshape(-1, 2, 2)))
            moved = (shape[moving] @ step[:, 4:, None])[..., 0]
            pixels[moving] -= moved
            last_px[moving] = np.linalg.norm(moved, axis=1)
            further = np.abs(step).max(axis=1) > STILL_PX
            if not further.any():
                break
            moving, patches = moving[further], patches.chosen(further)
        good = (alike >= LEAST_CORRELATION) & (_most_scaled(shape) <= MOST_SCALED)
        good &= (last_px <= settled_px) & fits(image, pixels)
        return pixels, shape, good


def undeformed(count: int) -> Floats:
    """Return the (count, 2, 2) shapes of patches as they were cut."""
    return np.tile(np.eye(2, dtype=np.float32), (count, 1, 1))


def fits(image: NDArray[np.generic], pixels: Array) -> Mask:
    """Return around which of (N, 2) pixels a patch is inside the image."""
    return inside(pixels, image.shape, HALF_PX)


def _sampled(image: Floats, pixels: Array, shape: Floats) -> Floats:
    """Return (N, M) values of the patches around (N, 2) pixels, deformed by (N, 2, 2) shapes."""
    warp = np.concatenate([shape, pixels[..., None]], axis=2, dtype=np.float32)
    u, v = np.swapaxes(warp, 0, 1) @ _GRID
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def _normalised(values: Floats) -> tuple[Floats, Floats]:
    """Return (N, M) values with mean zero and length one, flat ones shorter, and by what (N, 1) they were divided."""
    values = values - values.mean(axis=1, keepdims=True)
    length = np.linalg.norm(values, axis=1, keepdims=True).clip(LEAST_CONTRAST)
    return values / length, length


def _inverse_step(steps: Floats) -> Floats:
    """Return the (N, 2, 2) inverse changes of shape; steps are too short for singular ones."""
    (a, b), (c, d) = np.moveaxis(undeformed(len(steps)) + steps / _SHAPE_PX, 0, -1)
    return np.asarray(np.moveaxis(np.array([[d, -b], [-c, a]]) / (a * d - b * c), -1, 0), np.float32)


def _most_scaled(shapes: Floats) -> Floats:
    """Return by which factor (N, 2, 2) shapes stretch or shrink most, in any direction: their singular values."""
    total, product = np.sum(shapes**2, axis=(1, 2)), np.abs(np.linalg.det(shapes))
    largest = np.sqrt((total + np.sqrt((total**2 - 4.0 * product**2).clip(0.0))) / 2.0)
    return np.maximum(largest, largest / product)
