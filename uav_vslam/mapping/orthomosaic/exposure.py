# SPDX-License-Identifier: Apache-2.0
"""One brightness for all views: a gain for each, and a fall-off to the corners for each camera.

On common ground, log brightness of two views i, j differs by g_j - g_i + f(r_i) - f(r_j): a gain per view and channel,
and a polynomial f(r) = a r^2 + b r^4 of the camera. Within a pair of views, differences less their mean depend on a, b
alone; these come first, from all pairs so far. Then the gains: as views come each with the earlier ones fixed, or all
together (`solve`), as in [brown07]. A weak pull towards the view's own brightness keeps a chain of gains from drifting.
"""

from collections import defaultdict
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.mapping.orthomosaic.rectification import Rectified

Array = NDArray[np.float64]
Real = NDArray[np.float32]

BLOCK_CELLS = 32  # side of a block of ground by which views are found
LEAST_SAMPLES = 12  # common cells of a pair
MOST_PAIRS = 12  # of a new view with earlier ones, so that its cost is bounded
SIGMA_LOG = 0.15  # spread of the log gains of a camera's exposures, the pull
SIGMA_PAIR_LOG = 0.01  # of a pair's median difference
OUTLIER_LOG = 0.1  # difference of a cell from its pair's from which it counts less: shadows that move, reflections
SIGMA_CELL_LOG = 0.05
DARK, BRIGHT = 8.0, 247.0  # grey levels between which a camera is taken for linear
FALLOFF_SIGMA = 1.0  # prior of a and b
SOLVE_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class Correction:
    """What makes a view as bright as the others.

    Attributes:
        log_gain: (channels,) to add to its log brightness.
        falloff: (2,) a, b of its camera: log brightness per r^2 and r^4, mostly negative.
    """

    log_gain: Array
    falloff: Array

    def applied(self, image: Real, radius2: Real) -> Real:
        """Return the (rows, columns, channels) image corrected, given (rows, columns) r^2."""
        a, b = self.falloff.astype(np.float32)
        rise = np.exp(-np.clip(a * radius2 + b * radius2 * radius2, -1.0, 1.0))
        factors = cv2.merge([gain * rise for gain in np.exp(self.log_gain).astype(np.float32)])
        return np.asarray(image * factors.reshape(image.shape))


@dataclass(frozen=True, slots=True)
class _Pair:
    """The later view `second` on the ground of the earlier `first`; median log difference (channels,), cells."""

    first: int
    second: int
    difference: Array
    cells: int


@dataclass
class _Falloff:
    """Normal equations of a camera's a and b."""

    information: Array = field(default_factory=lambda: np.eye(2) / FALLOFF_SIGMA**2)
    vector: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def value(self) -> Array:
        return np.asarray(np.linalg.solve(self.information, self.vector))


class Exposure:
    """Gains of views, learnt from small rectified pictures of them."""

    def __init__(self) -> None:
        self._thumbs: list[Rectified] = []
        self._cameras: list[str] = []
        self._falloffs: dict[str, _Falloff] = {}
        self._pairs: list[_Pair] = []
        self._log_gains: list[Array] = []
        self._blocks: defaultdict[tuple[int, int], list[int]] = defaultdict(list)  # views by the ground below them

    def add(self, thumb: Rectified, camera: str) -> Correction:
        """Take the next view and return its correction, given all before.

        Args:
            thumb: the view, rectified coarsely, on the same grid as all others.
            camera: name of the camera, by which the fall-off is shared.

        Raises:
            UavVslamError: it is grey among views in colour, or the reverse.
        """
        channels = thumb.image.shape[-1]
        if self._log_gains and self._log_gains[0].size != channels:
            raise UavVslamError("the mosaic has views in grey and in colour; convert them to one kind")
        index = len(self._thumbs)
        self._thumbs.append(thumb)
        self._cameras.append(camera)
        falloff = self._falloffs.setdefault(camera, _Falloff())
        others = self._neighbours(index)
        for other in others:
            if self._cameras[other] == camera:
                _learn_falloff(falloff, self._thumbs[other], thumb, falloff.value)
        pairs = [pair for other in others if (pair := self._pair(other, index)) is not None]
        self._pairs += pairs
        self._log_gains.append(self._next_gain(pairs, channels))
        return self.correction(index)

    def correction(self, index: int) -> Correction:
        """Return what view number `index` needs, as now known."""
        return Correction(self._log_gains[index], self._falloffs[self._cameras[index]].value)

    def solve(self) -> None:
        """Find each camera's fall-off and all gains again from all pairs of views together."""
        for _ in range(SOLVE_ROUNDS):
            self._relearn_falloffs()
        self._pairs = [pair for old in self._pairs if (pair := self._pair(old.first, old.second)) is not None]
        count = len(self._thumbs)
        if count == 0:
            return
        H = np.eye(count) / SIGMA_LOG**2
        rhs = np.zeros((count, self._log_gains[0].size))
        for pair in self._pairs:
            i, j, weight = pair.first, pair.second, _weight(pair)
            H[[i, j], [i, j]] += weight
            H[[i, j], [j, i]] -= weight
            rhs[i] += weight * pair.difference
            rhs[j] -= weight * pair.difference
        self._log_gains = list(np.linalg.solve(H, rhs))

    def _relearn_falloffs(self) -> None:
        """Learn the fall-offs from the start, what is far off judged by the present ones."""
        before = {camera: falloff.value for camera, falloff in self._falloffs.items()}
        self._falloffs = {camera: _Falloff() for camera in before}
        for pair in self._pairs:
            camera = self._cameras[pair.first]
            if self._cameras[pair.second] == camera:
                _learn_falloff(
                    self._falloffs[camera], self._thumbs[pair.first], self._thumbs[pair.second], before[camera]
                )

    def _next_gain(self, pairs: list[_Pair], channels: int) -> Array:
        total, weights = np.zeros(channels), 1.0 / SIGMA_LOG**2
        for pair in pairs:
            total += _weight(pair) * (self._log_gains[pair.first] - pair.difference)
            weights += _weight(pair)
        return np.asarray(total / weights)

    def _neighbours(self, index: int) -> list[int]:
        """Return the earlier views whose windows share most with a view's; only those nearby are looked at."""
        own = self._thumbs[index].raster
        near: set[int] = set()
        for block in own.tiles(BLOCK_CELLS):
            there = self._blocks[block.column, block.row]
            near |= set(there)
            there.append(index)
        areas = [(float(np.prod(own.intersection(self._thumbs[i].raster).shape)), i) for i in near]
        return [i for area, i in sorted(areas, reverse=True)[:MOST_PAIRS] if area >= LEAST_SAMPLES]

    def _pair(self, first: int, second: int) -> _Pair | None:
        common = _common(self._thumbs[first], self._thumbs[second])
        if common is None:
            return None
        difference, powers_1, powers_2 = common
        fall = (
            powers_2 @ self._falloffs[self._cameras[second]].value
            - powers_1 @ self._falloffs[self._cameras[first]].value
        )
        return _Pair(first, second, np.median(difference - fall[:, None], axis=0), len(difference))


def _weight(pair: _Pair) -> float:
    return min(pair.cells / 100.0, 1.0) / SIGMA_PAIR_LOG**2


def _common(first: Rectified, second: Rectified) -> tuple[Array, Array, Array] | None:
    """Return log(second / first) (N, channels) on N common cells, and (N, 2) powers of each one's radius."""
    shared = first.raster.intersection(second.raster)
    if 0 in shared.shape:
        return None
    cut_1, cut_2 = shared.within(first.raster), shared.within(second.raster)
    image_1, image_2 = first.image[cut_1], second.image[cut_2]
    usable = (first.score[cut_1] > 0) & (second.score[cut_2] > 0)
    for image in (image_1, image_2):
        usable &= ((image > DARK) & (image < BRIGHT)).all(axis=-1)
    if usable.sum() < LEAST_SAMPLES:
        return None
    difference = np.log(image_2[usable].astype(float)) - np.log(image_1[usable].astype(float))
    return difference, _powers(first.radius2[cut_1][usable]), _powers(second.radius2[cut_2][usable])


def _powers(radius2: Real) -> Array:
    r2 = radius2.astype(float)
    return np.stack([r2, r2 * r2], axis=1)


def _learn_falloff(falloff: _Falloff, first: Rectified, second: Rectified, present: Array) -> None:
    """Add a pair's differences within itself to the normal equations; those far from the present model count less."""
    common = _common(first, second)
    if common is None:
        return
    difference, powers_1, powers_2 = common
    y, A = difference.mean(axis=1), powers_2 - powers_1
    residual = y - A @ present
    residual = np.abs(residual - np.median(residual))
    weights = 1.0 / (1.0 + (residual / OUTLIER_LOG) ** 2) ** 2 / SIGMA_CELL_LOG**2
    y, A = y - np.average(y, weights=weights), A - np.average(A, axis=0, weights=weights)
    falloff.information += (A * weights[:, None]).T @ A
    falloff.vector += (A * weights[:, None]).T @ y
