# SPDX-License-Identifier: Apache-2.0
"""A smoothed map has the same landmarks in better places, with a covariance that covers their errors."""

import functools

import numpy as np
import pytest

from uav_vslam.config import VehicleConfig
from uav_vslam.offline.track import track_vehicle
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.landmarks import LandmarkField, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.saved_map import MapSection, SavedMap
from uav_vslam.vision.matching.nn_ratio import squared_distances

pytestmark = pytest.mark.slow

SEEDS = (1, 2, 3)
FRAMES = 48


@functools.cache
def mapped(seed: int, *, smoothing: bool = True) -> tuple[VehicleTrack, SavedMap, LandmarkField]:
    vehicle = simulate_vehicle(Scenario(vehicles=1, seed=seed, frames=FRAMES), 0)
    field = scatter_landmarks([vehicle])
    config = VehicleConfig(imu=vehicle.scenario.imu_config)
    track = track_vehicle(SimulatedSource(vehicle, field), config, keep_map=True, smoothing=smoothing)
    assert track.saved_map is not None
    return track, track.saved_map, field


def errors_m(section: MapSection, field: LandmarkField) -> np.ndarray:
    """Return (N, 3) position errors: the nearest descriptor tells which landmark each is."""
    nearest = squared_distances(section.descriptors, field.descriptors).argmin(axis=1)
    return section.positions - field.points_world[nearest]


def normalised(error: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Return the squared error per axis over the covariance."""
    return np.einsum("...i,...i->...", error, np.linalg.solve(P, error[..., None])[..., 0]) / error.shape[-1]


def test_it_has_the_landmarks_of_the_filter_s_map() -> None:
    (_, causal, _), (track, smoothed, _) = mapped(1, smoothing=False), mapped(1)
    before, after = ({i for section in each.sections for i in section.ids.tolist()} for each in (causal, smoothed))
    assert after <= before
    assert len(after) > 0.9 * len(before)
    assert smoothed.origin.sources == causal.origin.sources
    assert smoothed.origin.stamp_ns == track.outputs[-1].report.pose.stamp_ns


def test_its_landmarks_are_in_better_places_relative_to_each_other() -> None:
    def spread_m(**options: bool) -> float:
        maps = [mapped(seed, **options)[1:] for seed in SEEDS]
        errors = [errors_m(section, field) for saved, field in maps for section in saved.sections]
        apart = np.vstack([error - error.mean(axis=0) for error in errors])
        return float(np.sqrt(np.mean(apart**2)))

    causal_m, smoothed_m = spread_m(smoothing=False), spread_m()
    assert smoothed_m < 0.5 * causal_m, (smoothed_m, causal_m)


@pytest.mark.parametrize("of", ["section", "landmark"])
def test_positions_err_as_the_covariance_of_their_section_says(of: str) -> None:
    found = []
    for seed in SEEDS:
        _, saved, field = mapped(seed)
        for section in saved.sections:
            error, P = errors_m(section, field), section.covariance
            if of == "section":
                found.append(normalised(error.ravel(), P))
            else:
                rows = np.arange(len(error))
                own = P.reshape(len(error), 3, len(error), 3)[rows, :, rows]
                found.append(normalised(error, own).mean())
    if of == "section":
        assert max(found) < 1.0  # a bound of the exact covariance is cautious
        assert np.mean(found) > 0.03  # but not vague
    else:
        assert 0.2 < np.mean(found) < 1.2
