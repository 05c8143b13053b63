# SPDX-License-Identifier: Apache-2.0
"""Precision of the matches that the front end's own extractor and matchers accept."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import SCENARIOS, simulate_vehicle
from uav_vslam.simulation.terrain import ground_of
from uav_vslam.studies.engine.extracted_flights import ground_points, shown_at
from uav_vslam.studies.features.compute import CORRECT_PX
from uav_vslam.studies.features.sets import ImageSet, spaced_pairs
from uav_vslam.vision.features import make_extractor
from uav_vslam.vision.matching import MATCHERS
from uav_vslam.vision.stereo_points import StereoFrontend

Errors = NDArray[np.floating]

ACCEPTED = "Front end: accepted matches"
MATCHER_NAMES = ("nn", "nn_mutual", "ransac_fundamental", "ransac_homography")
STEREO_FRAMES = 3


def accepted_rows(sets: Sequence[ImageSet], seeds: Sequence[int]) -> list[Row]:
    """Return the precision per set with truth and matcher, and that of the stereo front end on rendered pairs."""
    config = FrontendConfig()
    known = [images for images in sets if images.truth is not None]
    rows = [row for images in known for row in _between_frames(images, config)]
    return [*rows, *(_across_rig(seed, config) for seed in seeds)]


def _between_frames(images: ImageSet, config: FrontendConfig) -> list[Row]:
    """Match the first image of each band with those at all distances, with the front end's points and ratio."""
    extractor = make_extractor(config)
    errors: dict[tuple[str, str], list[Errors]] = {}
    for pair in spaced_pairs(images):
        a, b = (extractor.detect(view.image) for view in (pair.first, pair.second))
        for name in MATCHER_NAMES:
            rows = MATCHERS[name](a, b, config.ratio)
            found = pair.errors(a.pixels[rows[:, 0]], b.pixels[rows[:, 1]])
            errors.setdefault((pair.first.band, name), []).append(np.zeros(0) if found is None else found)
    return [_row(f"{images.name} {band}", name, np.concatenate(found)) for (band, name), found in errors.items()]


def _across_rig(seed: int, config: FrontendConfig) -> Row:
    """Match the rendered pairs of a flight as the stereo front end does."""
    scenario = replace(SCENARIOS["kagaru"], seed=seed, vehicles=1, frames=STEREO_FRAMES)
    vehicle = simulate_vehicle(scenario, 0)
    flight, relief, rig = RenderedFlight(vehicle), ground_of(scenario).relief, vehicle.rig
    frontend, errors = StereoFrontend(rig, config), []
    for number, t in enumerate(vehicle.frame_times_s):
        pixels = frontend.process(flight.frame(number)).pixels
        T_world_body = vehicle.truth.pose(float(t))
        points = ground_points(relief, T_world_body @ rig.T_body_left, rig.left, pixels[:, :2])
        expected = shown_at(T_world_body @ rig.T_body_right, rig.right, points)
        errors.append(np.linalg.norm(pixels[:, 2:] - expected, axis=1))
    return _row(f"flight {seed}, left and right", "stereo front end", np.concatenate(errors))


def _row(images: str, matcher: str, errors: Errors) -> Row:
    right = errors[errors < CORRECT_PX]
    return {
        TABLE: ACCEPTED,
        "method": matcher,
        "condition": images,
        "matches": len(errors),
        "precision": len(right) / len(errors) if len(errors) else float("nan"),
        "error_median_px": float(np.median(right)) if len(right) else float("nan"),
    }
