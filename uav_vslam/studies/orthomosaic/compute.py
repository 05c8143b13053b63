# SPDX-License-Identifier: Apache-2.0
"""Pictures of rendered ground by every method, and their errors."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.study import Row
from uav_vslam.mapping.homography_chain import chain_homographies, chained_mosaic
from uav_vslam.mapping.orthomosaic import KeyFrames, blended_mosaic
from uav_vslam.mapping.orthomosaic.heights import GridHeights
from uav_vslam.mapping.orthomosaic.seams import Seams, seams
from uav_vslam.mapping.view import View
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.simulation.terrain import Ground, ground_of
from uav_vslam.studies.engine.kept_flights import KeptFlight, height_grid, kept_flights
from uav_vslam.studies.engine.pool import grouped, mean, median, rms
from uav_vslam.studies.orthomosaic.displacement import Displacements, displacements
from uav_vslam.studies.orthomosaic.stitcher import stitched

Array = NDArray[np.float64]

STITCHED = 12  # images for OpenCV's stitcher: with 36, its memory grew beyond 8 GB
ORTHOMOSAIC, CHAIN, STITCHER = "orthomosaic", "homography chain", f"OpenCV stitcher, {STITCHED} images"
ONE, TWO = "one vehicle", "two vehicles"
POSES = {"truth": "true poses", "smoothed": "smoothed S-SLAM", "anchored": "anchored C-SLAM"}
CELL_M = 0.5

NOTES = {
    "Pictures": "rendered farmland with relief, without objects; ground that stands out is left to the study of the "
    "surface. All methods are given the same key frames, OpenCV's stitcher "
    f"the first {STITCHED} of them alone. The chain and the stitcher are placed by the smoothed pose of "
    "the first image over level ground, for they have no place of their own",
    "Errors": "patches of 96 px against the true picture; a patch that is not found does not count, so see found_share",
    "Seams": "shift between the two views that meet, before blending, at places along all seams",
}


@dataclass(frozen=True, slots=True)
class Job:
    """One seed's flight: number of frames, side of the picture's pixel [m]."""

    seed: int
    frames: int
    m_per_px: float


@dataclass(frozen=True, slots=True)
class Measured:
    """One picture: its errors, None without a picture; seams where known; processor time for a key frame [ms]."""

    method: str
    condition: str
    seed: int
    errors: Displacements | None
    seams: Seams | None = None
    key_frames: int = 0
    ms_per_key_frame: float | None = None


def measured(job: Job) -> list[Measured]:
    """Return the pictures of one seed by all methods."""
    scenario = Scenario(seed=job.seed, frames=job.frames)
    ground = ground_of(scenario)
    flights = kept_flights(scenario, ground)
    one, found = flights[:1], []
    for kind, chosen, condition in (("truth", one, ONE), ("smoothed", one, ONE), ("anchored", flights, TWO)):
        found.append(_orthomosaic(job, ground, chosen, kind, condition))
    keys = _key_frames(one, "smoothed")
    return [*found, _chain(job, ground, keys), _stitcher(job, ground, keys[:STITCHED])]


def _orthomosaic(job: Job, ground: Ground, flights: Sequence[KeptFlight], kind: str, condition: str) -> Measured:
    grid = height_grid(flights, kind, CELL_M)
    keys = _key_frames(flights, kind)
    started = time.process_time()
    mosaic = blended_mosaic(lambda: keys, GridHeights(grid), job.m_per_px)
    ms = 1e3 * (time.process_time() - started) / len(keys)
    picture = mosaic.picture()
    start = keys[0].T_map_cam.t
    errors = displacements(picture.image, picture.seen, picture.raster, ground.grey, (start[0], start[1]))
    seam = seams(mosaic, picture, keys)
    return Measured(f"{ORTHOMOSAIC}, {POSES[kind]}", condition, job.seed, errors, seam, len(keys), ms)


def _key_frames(flights: Sequence[KeptFlight], kind: str) -> list[View]:
    found = []
    for flight in flights:
        keys = KeyFrames()
        found += [view for view in flight.views(kind) if keys.takes(view, 0.0)]
    return found


def _chain(job: Job, ground: Ground, keys: Sequence[View]) -> Measured:
    images = [view.image for view in keys]
    started = time.process_time()
    try:
        to_map = [_to_level(keys[0], ground) @ H for H in chain_homographies(images)]
    except UavVslamError:
        return Measured(CHAIN, ONE, job.seed, None, key_frames=len(keys))
    ms = 1e3 * (time.process_time() - started) / len(keys)
    return _placed(CHAIN, job, ground, keys, images, to_map, ms)


def _stitcher(job: Job, ground: Ground, keys: Sequence[View]) -> Measured:
    found = stitched([view.image for view in keys])
    if found is None:
        return Measured(STITCHER, ONE, job.seed, None, key_frames=len(keys))
    picture, affinity = found
    to_map = [_to_level(keys[0], ground) @ np.linalg.inv(affinity)]
    return _placed(STITCHER, job, ground, keys, [picture], to_map, None)


def _placed(
    method: str,
    job: Job,
    ground: Ground,
    keys: Sequence[View],
    images: list[Any],
    to_map: list[Array],
    ms: float | None,
) -> Measured:
    """Draw images on the level of the ground and measure the picture."""
    try:
        drawn = chained_mosaic(images, to_map, job.m_per_px)
    except UavVslamError:
        return Measured(method, ONE, job.seed, None, None, len(keys), ms)
    seen = drawn.seen & (drawn.image > 0)
    start = keys[0].T_map_cam.t
    errors = displacements(drawn.image, seen, drawn.raster, ground.grey, (start[0], start[1]))
    return Measured(method, ONE, job.seed, errors if len(errors.points) else None, None, len(keys), ms)


def _to_level(view: View, ground: Ground) -> Array:
    """Return the homography from a view's pixels to x, y on the level of the ground below it."""
    x, y, _ = view.T_map_cam.t
    level_m = float(ground.height(np.array([x]), np.array([y]))[0])
    T_cam_map = view.T_map_cam.inverse()
    from_map = np.column_stack([T_cam_map.R[:, 0], T_cam_map.R[:, 1], T_cam_map.R[:, 2] * level_m + T_cam_map.t])
    return np.asarray(np.linalg.inv(view.camera.K @ from_map))


def mosaic_rows(found: Sequence[Measured]) -> list[Row]:
    """Return a row for each method, over all seeds."""
    groups = grouped(found, lambda one: (one.method, one.condition))
    return [_row(method, condition, runs) for (method, condition), runs in groups.items()]


def _row(method: str, condition: str, runs: Sequence[Measured]) -> Row:
    errors = [run.errors for run in runs if run.errors is not None and run.errors.any_found]
    places = [run.seams.figures() for run in runs if run.seams is not None]
    row: Row = {"method": method, "condition": condition, "runs": len(runs), "failures": len(runs) - len(errors)}
    row |= {
        "place_rms_m": rms([e.rms_m() for e in errors]),
        "place_worst_m": max((e.rms_m() for e in errors), default=None),
        "place_start_yaw_rms_m": rms([e.start_yaw_rms_m() for e in errors]),
        "place_rigid_rms_m": rms([e.rigid_rms_m() for e in errors]),
        "place_rigid_worst_m": max((e.rigid_rms_m() for e in errors), default=None),
        "found_share": mean([len(e.points) / max(e.patches, 1) for e in errors]),
        "brightness_spread": mean([float(e.brightness.std() / e.brightness.mean()) for e in errors]),
        "seam_median_px": mean([p["median_px"] for p in places]),
        "seam_p90_px": mean([p["p90_px"] for p in places]),
        "seam_step": mean([p["median_step"] for p in places]),
        "key_frames": mean([run.key_frames for run in runs]),
        "ms_per_key_frame": median([run.ms_per_key_frame for run in runs if run.ms_per_key_frame is not None]),
    }
    return {key: value for key, value in row.items() if value is not None}


def mosaic_series(found: Sequence[Measured]) -> list[Row]:
    """Return each picture's errors over the distance from its start, those of one seed after the other."""
    series = []
    for one in sorted(found, key=lambda one: (one.method, one.seed)):
        if one.errors is not None and one.errors.any_found:
            from_start = np.linalg.norm(one.errors.points - one.errors.points[0], axis=1)
            length = np.linalg.norm(one.errors.errors, axis=1)
            series.append(
                {
                    "method": one.method,
                    "condition": one.condition,
                    "seed": one.seed,
                    "distance_m": from_start.tolist(),
                    "error_m": length.tolist(),
                }
            )
    return series
