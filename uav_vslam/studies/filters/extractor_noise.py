# SPDX-License-Identifier: Apache-2.0
"""Accuracy of an extractor's stereo points on rendered images, where the truth is known."""

from dataclasses import dataclass

import numpy as np

from uav_vslam.config import FrontendConfig, VehicleConfig
from uav_vslam.numerics import robust_sigma
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.extracted_flights import rendered_flight, shown_at
from uav_vslam.vision.matching import match_descriptors

FRAMES = 6
WRONG_PX = 8.0  # a match farther from its true position is an outlier
SQRT2 = float(np.sqrt(2.0))  # an error between two images has the noise of both


@dataclass(frozen=True, slots=True)
class ExtractorNoise:
    """Quality of an extractor behind the stereo front end.

    Attributes:
        points: stereo points of an image pair, before any are left out to spread them.
        sigma_px: standard deviation of a pixel coordinate [px], robust.
        wrong_share: of the matches between one pair and the next, by descriptor with ratio and mutual check.
    """

    points: float
    sigma_px: float
    wrong_share: float


def measure(extractor: str, seed: int, *, frames: int = FRAMES) -> ExtractorNoise:
    """Measure an extractor on the first frames of the default flight, full-size images searched at half resolution."""
    every = FrontendConfig(extractor=extractor, max_matches=10_000)
    scenario = Scenario(frames=frames, vehicles=1, seed=seed)
    flight = rendered_flight(extractor, scenario, VehicleConfig(frontend=every), keep=set())
    seen = [features for features, _ in flight.steps]
    errors = []
    for frame in range(1, frames):
        before, now = seen[frame - 1], seen[frame]
        matches = match_descriptors(before.descriptors, now.descriptors, flight.config.backend.min_descriptor_ratio)
        expected = shown_at(flight.T_world_left[frame], flight.rig.left, flight.points[frame - 1][matches[:, 0]])
        errors.append(now.pixels[matches[:, 1], :2] - expected)
    error = np.concatenate(errors)
    right = np.linalg.norm(error, axis=1) <= WRONG_PX
    return ExtractorNoise(
        points=float(np.mean([len(features) for features in seen])),
        sigma_px=robust_sigma(error[right]) / SQRT2,
        wrong_share=float(1.0 - right.mean()),
    )
