# SPDX-License-Identifier: Apache-2.0
"""Where a picture of the ground shows what is elsewhere: patches of it against the true picture.

A patch's displacement is found against the truth, which is drawn again where the patch seems to belong, until the rest
is less than a tenth of a pixel. Each patch begins with the displacement of its nearest neighbour, so that
errors much larger than a patch are followed as long as they grow slowly.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.alignment import align_start_yaw, align_yaw
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.raster import Raster
from uav_vslam.vision.patch_shift import patch_shift

Array = NDArray[np.float64]
TruePicture = Callable[[Array, Array], NDArray[np.floating]]  # x, y [m] to grey levels

PATCH_PX = 96
SPACING_PX = 96
SUBSAMPLES = 3  # of the truth, along each side of a pixel
ROUNDS = 8
SETTLED_PX = 0.1


@dataclass(frozen=True, slots=True)
class Displacements:
    """Patches of a picture that were found in the truth.

    Attributes:
        points: (N, 2) true x, y [m].
        errors: (N, 2) of the picture's x, y [m].
        brightness: (N,) mean of the patch over the truth's.
        patches: number of all patches.
        start: (2,) x, y of the flight's start, as the picture has it [m].
    """

    points: Array
    errors: Array
    brightness: Array
    patches: int
    start: Array

    @property
    def any_found(self) -> bool:
        """Whether there are any errors to average: a picture that shows nothing of the truth has failed."""
        return len(self.points) > 0

    def rms_m(self) -> float:
        """Return the root mean square distance [m]."""
        return float(np.sqrt(np.mean(np.sum(self.errors**2, axis=1))))

    def rigid_rms_m(self) -> float:
        """Return the root mean square distance after the best rigid motion in the plane [m]."""
        return self._rms_m(align_yaw(_in_space(self.points + self.errors), _in_space(self.points)))

    def start_yaw_rms_m(self) -> float:
        """Return the root mean square distance after the best rotation about the start [m]."""
        with_start = [np.vstack([self.start, points]) for points in (self.points + self.errors, self.points)]
        return self._rms_m(align_start_yaw(*map(_in_space, with_start)))

    def _rms_m(self, T_truth_drawn: Pose) -> float:
        rest = T_truth_drawn.apply(_in_space(self.points + self.errors)) - _in_space(self.points)
        return float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))


def _in_space(points: Array) -> Array:
    """Return (N, 3) points of height zero."""
    return np.pad(points, ((0, 0), (0, 1)))


def displacements(
    image: NDArray[np.uint8], seen: NDArray[np.bool_], raster: Raster, truth: TruePicture, start: tuple[float, float]
) -> Displacements:
    """Measure a picture.

    Args:
        image: (rows, columns) grey or (rows, columns, 3) BGR, south first.
        seen: (rows, columns).
        raster: its window of the map.
        truth: the true picture.
        start: x, y [m] from which patches are searched outwards.
    """
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    corners = [
        (row, column)
        for row in range(0, raster.rows - PATCH_PX + 1, SPACING_PX)
        for column in range(0, raster.columns - PATCH_PX + 1, SPACING_PX)
        if seen[row : row + PATCH_PX, column : column + PATCH_PX].all()
    ]
    windows = [Raster(raster.cell_m, raster.column + c, raster.row + r, PATCH_PX, PATCH_PX) for r, c in corners]
    middles = np.array([[w.x.mean(), w.y.mean()] for w in windows]).reshape(-1, 2)
    points: list[Array] = []
    errors: list[Array] = []
    brightness: list[float] = []
    for k in np.argsort(np.linalg.norm(middles - start, axis=1), kind="stable"):
        guess = np.zeros(2)
        if points:
            guess = errors[int(np.argmin(np.linalg.norm(np.array(points) - middles[k], axis=1)))]
        row, column = corners[k]
        patch = grey[row : row + PATCH_PX, column : column + PATCH_PX].astype(np.float32)
        found = _displacement(patch, windows[k], truth, guess)
        if found is not None:
            points.append(middles[k])
            errors.append(found[0])
            brightness.append(found[1])
    moved = np.array(errors).reshape(-1, 2)
    points_true = np.array(points).reshape(-1, 2) - moved
    return Displacements(points_true, moved, np.array(brightness), len(corners), np.array(start))


def _displacement(
    patch: NDArray[np.float32], window: Raster, truth: TruePicture, guess: Array
) -> tuple[Array, float] | None:
    """Return the patch's error [m] and brightness over the truth's; None where it is not found."""
    error = np.asarray(guess, float).copy()
    for _ in range(ROUNDS):
        true = _drawn(truth, window, error)
        shift = patch_shift(true, patch)
        if shift is None:
            return None
        error = error + shift * window.cell_m
        if np.hypot(*shift) < SETTLED_PX:
            return error, float(patch.mean() / max(true.mean(), 1.0))
    return None


def _drawn(truth: TruePicture, window: Raster, error: Array) -> NDArray[np.float32]:
    """Return the true picture that a patch shows if the picture is displaced by `error` there."""
    n = SUBSAMPLES
    fine = Raster(window.cell_m / n, window.column * n, window.row * n, window.columns * n, window.rows * n)
    grey = np.asarray(truth(*np.meshgrid(fine.x - error[0], fine.y - error[1])), np.float32)
    return np.asarray(cv2.resize(grey, (window.columns, window.rows), interpolation=cv2.INTER_AREA))
