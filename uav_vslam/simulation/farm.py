# SPDX-License-Identifier: Apache-2.0
"""What stands on a farm: barns, hedges, trees and posts, field by field, without end and the same in any order."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from uav_vslam.simulation.dome import Dome
from uav_vslam.simulation.fields import FIELD_M, JITTER, corner, is_track, outline
from uav_vslam.simulation.ridged import Ridged
from uav_vslam.simulation.solids import Bounds, Label, Solid

Array = NDArray[np.float64]
Heights = Callable[[NDArray[np.floating], NDArray[np.floating]], NDArray[np.floating]]  # [m] at x, y [m]

FOOT_M = 3.0  # by which solids reach below the ground at their centre
BEYOND_FIELD_M = 12.0  # nothing stands farther outside its field

BARNS_PER_FIELD = (0.2, 0.35, 0.3, 0.15)  # probability of 0, 1, ... barns: 2 % of the ground
BARN_LENGTH_M, BARN_WIDTH_M = (9.0, 20.0), (6.0, 10.0)
BARN_EAVES_M, BARN_PITCH = (3.0, 4.5), (0.3, 0.5)
BARN_TRIES = 8
HEDGED = 0.75  # share of the borders
HEDGE_WIDTH_M, HEDGE_PITCH = 2.0, 0.25
HEDGE_HEIGHT_M = (1.5, 3.0)
HEDGE_PIECE_M, HEDGE_INSET_M, GATE_M = 5.0, 4.0, 6.0
TREES_PER_FIELD = 6.0
TREE_HEIGHT_M = (4.0, 9.0)
LOBES = 4
POST_SPACING_M, POST_BESIDE_TRACK_M, POST_WIDTH_M, POST_HEIGHT_M = 30.0, 3.0, 0.3, (4.0, 6.0)


class Farm:
    """The solids of an unbounded farm, made field by field on first use."""

    def __init__(self, seed: int, ground_z: Heights) -> None:
        """Prepare a farm.

        Args:
            seed: of everything on it.
            ground_z: height of the bare ground.
        """
        self.seed = seed
        self.ground_z = ground_z
        self._fields: dict[tuple[int, int], tuple[list[Solid], Array]] = {}

    def solids(self, bounds: Bounds) -> list[Solid]:
        """Return what stands, in part at least, in a rectangle (west, south, east, north) [m]."""
        found = []
        for field in _fields_near(bounds):
            solids, boxes = self._field(field)
            touching = (boxes[:, :2] <= bounds[2:]).all(axis=1) & (boxes[:, 2:] >= bounds[:2]).all(axis=1)
            found += [solids[k] for k in np.flatnonzero(touching)]
        return found

    def _field(self, field: tuple[int, int]) -> tuple[list[Solid], Array]:
        """Return the solids of one field and their (N, 4) bounds."""
        if field not in self._fields:
            rng = np.random.default_rng(np.random.SeedSequence([self.seed, *(2**31 + v for v in field)]))
            barns = self._barns(field, rng)
            trees = self._trees(field, barns, rng)
            solids: list[Solid] = [*barns, *self._borders(field, rng), *trees]
            self._fields[field] = solids, np.array([solid.bounds for solid in solids]).reshape(-1, 4)
        return self._fields[field]

    def _ground_z(self, xy: Array) -> float:
        return float(self.ground_z(xy[:1].astype(float), xy[1:].astype(float))[0])

    def _barns(self, field: tuple[int, int], rng: np.random.Generator) -> list[Ridged]:
        """Return barns inside the field, apart from each other, roughly along or across its southern border."""
        corners = outline(*field, self.seed)
        border = corners[1] - corners[0]
        built: list[Ridged] = []
        for _ in range(rng.choice(len(BARNS_PER_FIELD), p=BARNS_PER_FIELD)):
            heading = np.arctan2(border[1], border[0]) + 0.5 * np.pi * rng.integers(2) + rng.normal(0.0, 0.1)
            length, width = rng.uniform(*BARN_LENGTH_M), rng.uniform(*BARN_WIDTH_M)
            place = _free_place(corners, 0.5 * length, built, rng)
            if place is not None:
                built.append(self._barn(place, float(heading), (length, width), rng))
        return built

    def _barn(self, xy: Array, heading: float, size: tuple[float, float], rng: np.random.Generator) -> Ridged:
        """Return a barn of some height at (2,) x, y [m], `size` along and across its ridge [m]."""
        x, y = map(float, xy)
        z, pitch, seed = self._ground_z(xy), rng.uniform(*BARN_PITCH), int(rng.integers(2**31))
        ridge_z = z + rng.uniform(*BARN_EAVES_M) + 0.5 * pitch * size[1]
        return Ridged(Label.BARN, seed, z - FOOT_M, x, y, heading, *size, ridge_z, pitch)

    def _borders(self, field: tuple[int, int], rng: np.random.Generator) -> Iterator[Ridged]:
        """Yield what stands along the southern and the western border."""
        i, j = field
        start = corner(i, j, self.seed)
        if is_track(j):
            yield from self._posts(start, corner(i + 1, j, self.seed), rng)
        elif rng.random() < HEDGED:
            yield from self._hedge(start, corner(i + 1, j, self.seed), rng)
        if rng.random() < HEDGED:
            yield from self._hedge(start, corner(i, j + 1, self.seed), rng)

    def _hedge(self, start: Array, end: Array, rng: np.random.Generator) -> Iterator[Ridged]:
        """Yield a hedge in pieces whose ridge follows the ground and the hedge's own varying height, with one gate."""
        length = float(np.hypot(*(end - start)))
        along = (end - start) / length
        gate, seed = rng.uniform(0.2, 0.8) * length, int(rng.integers(2**31))
        for low, high in ((HEDGE_INSET_M, gate - 0.5 * GATE_M), (gate + 0.5 * GATE_M, length - HEDGE_INSET_M)):
            at = np.linspace(low, high, max(1, round((high - low) / HEDGE_PIECE_M)) + 1)
            height = np.clip(rng.uniform(1.8, 2.7) + rng.normal(0.0, 0.2, len(at)), *HEDGE_HEIGHT_M)
            nodes = start + at[:, None] * along
            ground = self.ground_z(nodes[:, 0], nodes[:, 1])
            for k in range(len(at) - 1):
                ends = slice(k, k + 2)
                yield _piece(nodes[ends], (ground + height)[ends], float(ground[ends].min()) - FOOT_M, seed)

    def _posts(self, start: Array, end: Array, rng: np.random.Generator) -> Iterator[Ridged]:
        """Yield the posts beside a stretch of track."""
        length = float(np.hypot(*(end - start)))
        along = (end - start) / length
        beside = POST_BESIDE_TRACK_M * np.array([-along[1], along[0]])
        heading, side = float(np.arctan2(along[1], along[0])), POST_WIDTH_M
        for at in np.arange(rng.uniform(8.0, 14.0), length - 6.0, POST_SPACING_M):
            x, y = map(float, start + at * along + beside)
            z, height, seed = self._ground_z(np.array([x, y])), rng.uniform(*POST_HEIGHT_M), int(rng.integers(2**31))
            yield Ridged(Label.POST, seed, z - FOOT_M, x, y, heading, side, side, z + height, pitch=0.0)

    def _trees(self, field: tuple[int, int], barns: list[Ridged], rng: np.random.Generator) -> Iterator[Dome]:
        """Yield the crowns of the field's trees: a third along its western border, none at a barn or on a track."""
        corners = outline(*field, self.seed)
        for _ in range(rng.poisson(TREES_PER_FIELD)):
            across = 0.0 if rng.random() < 0.33 else rng.uniform(0.1, 0.9)
            xy = _inside(corners, np.array([across, rng.uniform(0.1, 0.9)]))
            height, seed = rng.uniform(*TREE_HEIGHT_M), int(rng.integers(2**31))
            shape = np.random.default_rng(seed)  # its own stream: a tree left out changes no other
            if all(np.hypot(*(xy - [b.x, b.y])) > 0.5 * np.hypot(b.length_m, b.width_m) + 5.0 for b in barns):
                yield from self._crown(xy, height, seed, shape)

    def _crown(self, xy: Array, height: float, seed: int, rng: np.random.Generator) -> Iterator[Dome]:
        """Yield the dome of a tree and lower lobes around it."""
        z, radius = self._ground_z(xy), 0.3 * height * rng.uniform(0.85, 1.15)
        yield Dome(Label.TREE, seed, z - FOOT_M, float(xy[0]), float(xy[1]), radius, z + 0.4 * height, 0.6 * height)
        turn = rng.uniform(0.0, 2.0 * np.pi)
        for k in range(LOBES):
            angle = turn + 2.0 * np.pi * (k + rng.uniform(-0.25, 0.25)) / LOBES
            at = xy + 0.65 * radius * np.array([np.cos(angle), np.sin(angle)])
            size, rim_z = radius * rng.uniform(0.45, 0.65), z + height * rng.uniform(0.3, 0.45)
            yield Dome(Label.TREE, seed, z - FOOT_M, float(at[0]), float(at[1]), size, rim_z, 0.35 * height)


def _piece(nodes: Array, ridge_z: Array, foot_z: float, seed: int) -> Ridged:
    """Return one piece of hedge between (2, 2) nodes [m] with (2,) heights of the ridge [m]."""
    (dx, dy), (x, y) = (nodes[1] - nodes[0]).tolist(), nodes.mean(axis=0).tolist()
    length, heading = float(np.hypot(dx, dy)), float(np.arctan2(dy, dx))
    climb = float(ridge_z[1] - ridge_z[0]) / length
    middle_z = float(ridge_z.mean())
    return Ridged(Label.HEDGE, seed, foot_z, x, y, heading, length, HEDGE_WIDTH_M, middle_z, HEDGE_PITCH, climb)


def _free_place(corners: Array, reach_m: float, built: list[Ridged], rng: np.random.Generator) -> Array | None:
    """Return a place well inside a field and away from other barns, None if there seems to be none."""
    for _ in range(BARN_TRIES):
        xy = _inside(corners, rng.uniform(0.25, 0.75, 2))
        if all(np.hypot(*(xy - [b.x, b.y])) > reach_m + 0.5 * b.length_m + 8.0 for b in built):
            return xy
    return None


def _inside(corners: Array, share: Array) -> Array:
    """Return the point of a field at (2,) shares of its breadth and height."""
    u, v = share
    return np.asarray([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v] @ corners)


def _fields_near(bounds: Bounds) -> list[tuple[int, int]]:
    """Return the fields whose solids may touch a rectangle."""
    low = np.ceil((np.array(bounds[:2]) - BEYOND_FIELD_M) / FIELD_M - 1.0 - JITTER).astype(int)
    high = np.floor((np.array(bounds[2:]) + BEYOND_FIELD_M) / FIELD_M + JITTER).astype(int)
    return [(i, j) for j in range(low[1], high[1] + 1) for i in range(low[0], high[0] + 1)]
