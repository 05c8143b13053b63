# SPDX-License-Identifier: Apache-2.0
"""From views in flight to the height grid: chooses pairs, matches them, adds them.

Views come one at a time, as soon as their pose is known, offline or live; memory and time for one don't depend on the
length of the flight.
"""

import time
from collections import Counter, defaultdict, deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.surface.ground_search import LEAST_BASELINE_M, search_ground
from uav_vslam.mapping.surface.prepared import PreparedView
from uav_vslam.mapping.surface.rectification import Depths, rectify
from uav_vslam.mapping.surface.samples import sample
from uav_vslam.mapping.surface.settings import SurfaceSettings
from uav_vslam.mapping.surface.stereo import SPARSE, PairPoints, match
from uav_vslam.mapping.view import View

Array = NDArray[np.float64]

FLATTEST_RAY = 0.3  # least fall of a ray of depth one that is followed to the ground
FOOTPRINT = (16, 12)  # points across and down an image that stand for its footprint
FOOTPRINT_POINTS = FOOTPRINT[0] * FOOTPRINT[1]
MOST_VIEWS = 64  # kept as partners of later ones
CELL_PIXELS = 2.0  # side of a cell in pixels on the ground that gives `samples.LEAST_POINTS`
FEWEST_PIXELS = 1.5  # below it hardly a cell has so many
# Reasons to refuse a pair; docs/mapping.md says what to do.
TURNED = "turned apart"
NOT_BELOW = "no common ground below"
SMALL_CELLS = "cells smaller than pixels"
FEW_MATCHES = "few matches"
LEAST_SHARE = 0.25  # of the common ground that a good pair matches
RANGE_PERCENTILES = (1.0, 50.0, 99.0)
SEARCHED_VIEWS = 8  # kept while the ground is not found
FARTHEST_SEARCHED_M = 100.0  # of them from the newest


@dataclass(slots=True)
class _Lane:
    """The latest views of one vehicle, where it last saw the ground, and the view of the latest pair."""

    views: deque[PreparedView] = field(default_factory=deque)
    ground: Depths | None = None
    last_pair: PreparedView | None = None


class SurfaceMapper:
    """Adds views of any number of vehicles to one height grid.

    Attributes:
        grid: what is mapped so far.
        views: taken, by vehicle.
        pairs: matched.
        refused: pairs that were not, by reason.
        least_cell_m: side of cells with which no pair would have been refused for `SMALL_CELLS`; 0 if none was [m].
        seconds: processor time by stage.
    """

    def __init__(self, grid: HeightGrid, settings: SurfaceSettings | None = None) -> None:
        self.grid = grid
        self.views: Counter[str] = Counter()
        self.pairs = 0
        self.refused: Counter[str] = Counter()
        self.least_cell_m = 0.0
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._settings = settings or SurfaceSettings()
        self._lanes: defaultdict[str, _Lane] = defaultdict(_Lane)

    def add_view(self, view: View) -> None:
        """Add a view; those of one vehicle come in stamp order."""
        started = time.process_time()
        prepared = PreparedView.of(view, self._settings.scale)
        self._count("prepare", started)
        self.views[view.vehicle] += 1
        lane = self._lanes[view.vehicle]
        if lane.ground is None:
            self._find_ground(lane, prepared)
        if lane.ground is None:
            lane.views.append(prepared)
        else:
            self._keep(lane, prepared, lane.ground)
            self._pair_up(lane, prepared, lane.ground)

    def ground_m(self, vehicle: str) -> float | None:
        """Return the median height of the ground that a vehicle saw last [m]; None while it is not found."""
        ground = self._lanes[vehicle].ground if vehicle in self._lanes else None
        return None if ground is None else ground.middle_m

    def finish(self) -> None:
        """End all flights: map what only their last views show."""
        for lane in self._lanes.values():
            for view in lane.views:
                self._complete(lane, view)
            lane.views.clear()
            lane.last_pair = None

    def _find_ground(self, lane: _Lane, view: PreparedView) -> None:
        started = time.process_time()
        for earlier in reversed(lane.views):
            lane.ground = search_ground(earlier, view, self._settings)
            if lane.ground is not None:
                break
        if lane.ground is None and len(lane.views) >= SEARCHED_VIEWS:
            del lane.views[most_dispensable([_apart(earlier, view) for earlier in lane.views])]
        self._count("search", started)

    def _keep(self, lane: _Lane, view: PreparedView, ground: Depths) -> None:
        """Keep a view as a partner of later ones, unless the last one kept is nearly where it is.

        So `MOST_VIEWS` reach as far as pairs do, however slow the flight is.
        """
        spacing_m = self._settings.longest_ratio * _above(view, ground) / MOST_VIEWS
        if lane.views and _apart(lane.views[-1], view) < spacing_m:
            return
        lane.views.append(view)
        while len(lane.views) > MOST_VIEWS:
            self._complete(lane, lane.views[0])
            lane.views.popleft()

    def _pair_up(self, lane: _Lane, view: PreparedView, ground: Depths) -> None:
        settings, height_m = self._settings, _above(view, ground)
        while len(lane.views) > 1 and _apart(lane.views[0], view) > settings.longest_ratio * height_m:
            self._complete(lane, lane.views[0])
            lane.views.popleft()
        if (
            lane.last_pair is not None
            and _moved_m(lane.last_pair, view, ground.middle_m) < settings.step_ratio * height_m
        ):
            return
        partner = self._partner(lane, view, settings.baseline_ratio * height_m)
        if partner is not None:
            self._add_pair(lane, partner, view, ground)
            lane.last_pair = view

    def _partner(self, lane: _Lane, view: PreparedView, baseline_m: float) -> PreparedView | None:
        """Return the latest view that is at least so far away; None if there is none."""
        return next((earlier for earlier in reversed(lane.views) if _apart(earlier, view) >= baseline_m), None)

    def _complete(self, lane: _Lane, view: PreparedView) -> None:
        """Map what else a view shows over shorter baselines: it was banked, or is the first or last to show it."""
        ground = lane.ground
        if ground is None:
            return
        for ratio in self._settings.short_ratios:
            missing = self._missing(view, ground)
            if len(missing) <= self._settings.missing_share * FOOTPRINT_POINTS:
                return
            baseline_m = ratio * _above(view, ground)
            partners = [other for other in lane.views if _apart(other, view) >= baseline_m]
            partner = min(partners, key=lambda other: _apart(other, view), default=None)
            if partner is not None and _showing(partner, missing) > self._settings.missing_share * FOOTPRINT_POINTS:
                self._add_pair(lane, partner, view, ground, region=missing)

    def _missing(self, view: PreparedView, ground: Depths) -> Array:
        """Return (N, 3) points of a view's footprint that are not mapped yet [m]."""
        points = _footprint(view, ground.middle_m)
        return points[~self.grid.known(points[:, :2])]

    def _add_pair(
        self, lane: _Lane, left: PreparedView, right: PreparedView, ground: Depths, region: Array | None = None
    ) -> None:
        """Match a pair and add it to the grid if it is good.

        Only the surroundings of a region are matched, if there is one: (N, 3) points in the map frame.
        """
        settings, started = self._settings, time.process_time()
        if _turn_deg(left, right) > settings.largest_turn_deg:
            self.refused[TURNED] += 1
            return
        searched = self._searched(ground, min(left.T_map_cam.t[2], right.T_map_cam.t[2]))
        pair = rectify(
            left, right, searched, most=settings.most_disparities, overlap=settings.least_overlap, region=region
        )
        if pair is None:
            self.refused[NOT_BELOW] += 1
            return
        pixel_m = _above(right, ground) / pair.focal_px
        if self.grid.cell_m < FEWEST_PIXELS * pixel_m:
            self.refused[SMALL_CELLS] += 1
            self.least_cell_m = max(self.least_cell_m, CELL_PIXELS * pixel_m)
            return
        points = match(pair, settings).above(searched.low_m)  # whole steps of disparities reach further
        started = self._count("match", started)
        if points.share < LEAST_SHARE:
            self.refused[FEW_MATCHES] += 1
            return
        samples = sample(points, self.grid.cell_m)
        if samples is not None:
            self.grid.add(samples)
        lane.ground = _ground_of(points)
        self.pairs += 1
        self._count("fuse", started)

    def _searched(self, ground: Depths, camera_m: float) -> Depths:
        """Return the heights to search: beyond the surface last seen, but well below cameras at a height [m]."""
        settings = self._settings
        highest_m = ground.middle_m + settings.highest_ratio * (camera_m - ground.middle_m)
        high_m = min(ground.high_m + settings.above_m, highest_m)
        return Depths(ground.low_m - settings.below_m, ground.middle_m, high_m)

    def _count(self, stage: str, started: float) -> float:
        now = time.process_time()
        self.seconds[stage] += now - started
        return now


def most_dispensable(distances_m: list[float]) -> int:
    """Return which of some views, oldest first, to give up, by their distances from the newest.

    Those that are left are the farther apart the farther away they are: whatever baseline the ground needs, some pair
    comes near it.
    """
    far_m, *_ = distances_m = [max(distance, LEAST_BASELINE_M) for distance in distances_m]
    if far_m > FARTHEST_SEARCHED_M:
        return 0
    ratios = [before / after for before, after in zip(distances_m, [*distances_m[2:], LEAST_BASELINE_M], strict=False)]
    return 1 + int(np.argmin(ratios[: len(distances_m) - 1]))


def _ground_of(points: PairPoints) -> Depths:
    return Depths(*np.percentile(points.points_map[::SPARSE, 2], RANGE_PERCENTILES).tolist())


def _above(view: PreparedView, ground: Depths) -> float:
    """Return the height above ground [m], at least a metre."""
    return max(float(view.T_map_cam.t[2]) - ground.middle_m, 1.0)


def _apart(a: PreparedView, b: PreparedView) -> float:
    return float(np.linalg.norm(a.T_map_cam.t - b.T_map_cam.t))


def _moved_m(a: PreparedView, b: PreparedView, ground_m: float) -> float:
    """Return the largest displacement in the footprint [m]: unlike the cameras', it grows with a bank too."""
    return float(np.linalg.norm(_footprint(a, ground_m) - _footprint(b, ground_m), axis=1).max())


def _footprint(view: PreparedView, ground_m: float) -> Array:
    """Return (N, 3) points of the ground that are seen at even distances in the image [m]; cut before the horizon."""
    columns, rows = (np.linspace(0.02, 0.98, count) for count in FOOTPRINT)
    u, v = np.meshgrid(columns * view.camera.width, rows * view.camera.height)
    rays = view.camera.bearings(np.stack([u, v], axis=-1).reshape(-1, 2)) @ view.T_map_cam.R.T
    far = (view.T_map_cam.t[2] - ground_m) / np.maximum(-rays[:, 2], FLATTEST_RAY)
    points = view.T_map_cam.t + far[:, None] * rays
    points[:, 2] = ground_m
    return np.asarray(points)


def _showing(view: PreparedView, points_map: Array) -> int:
    """Return how many points a view shows."""
    points = view.T_map_cam.inverse().apply(points_map)
    points = points[points[:, 2] > 0.0]
    pixels, size = view.camera.project(points), [view.camera.width - 1, view.camera.height - 1]
    return int(np.count_nonzero(((pixels >= 0.0) & (pixels <= size)).all(axis=1)))


def _turn_deg(a: PreparedView, b: PreparedView) -> float:
    cosine = float(a.T_map_cam.R[:, 2] @ b.T_map_cam.R[:, 2])
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
