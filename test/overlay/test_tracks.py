# SPDX-License-Identifier: Apache-2.0
"""Points and trails are where the camera saw them."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import BackendConfig, VehicleConfig
from uav_vslam.offline.track import track_vehicle
from uav_vslam.overlay.tracks import TRAIL_FRAMES, evenly, overlays
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.landmarks import LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.types import StereoFeatures

FRAMES = 12
DARK = 7  # the frame without features
SIGMA_PX = 0.04


@pytest.fixture(scope="module")
def vehicle() -> SimulatedVehicle:
    return simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, vehicles=1), 0)


def fly(vehicle: SimulatedVehicle, *, tracked: bool, keep: bool = True) -> tuple[VehicleTrack, list[StereoFeatures]]:
    """Fly with true identities as feature tracks, which end in the dark, or with none."""
    features = []
    noise = LandmarkNoise(sigma_px=SIGMA_PX)
    for k, (seen, ids) in enumerate(observe(vehicle, scatter_landmarks([vehicle]), noise=noise)):
        tracks = (ids + 1 + 10_000 * (k > DARK)).astype(np.uint32) if tracked else seen.tracks
        features.append(StereoFeatures.empty(seen.stamp_ns) if k == DARK else dataclasses.replace(seen, tracks=tracks))
    source = SimulatedSource(vehicle, features=tuple(features))
    config = VehicleConfig(imu=vehicle.scenario.imu_config, backend=BackendConfig(sigma_px=SIGMA_PX))
    return track_vehicle(source, config, keep_features=keep), features


def test_points_are_drawn_where_the_lens_imaged_them(vehicle: SimulatedVehicle) -> None:
    track, features = fly(vehicle, tracked=True)
    lens = dataclasses.replace(vehicle.rig.left, distortion=np.array([-0.2, 0.05, 1e-3, 0.0, 0.0]))
    drawn = list(overlays(track, lens, range(FRAMES)))
    for overlay, seen, output in zip(drawn, features, track.outputs, strict=True):
        assert overlay.stamp_ns == seen.stamp_ns
        np.testing.assert_allclose(lens.undistort(overlay.points), seen.pixels[:, :2], atol=1e-2)
        assert overlay.associated.sum() == output.report.associated
    assert np.abs(drawn[3].points - features[3].pixels[:, :2]).max() > 1.0
    assert [overlay.coasted for overlay in drawn] == [k == DARK for k in range(FRAMES)]
    assert "coasted" in drawn[DARK].caption


@pytest.mark.parametrize("tracked", [True, False])
def test_trails_lead_through_the_same_point_of_earlier_frames(vehicle: SimulatedVehicle, tracked: bool) -> None:
    """Known by their feature track, or without one by their landmark."""
    track, features = fly(vehicle, tracked=tracked)
    (overlay,) = overlays(track, vehicle.rig.left, [5])
    assert len(overlay.trails) >= 10
    for trail in overlay.trails:
        assert 2 <= len(trail) <= TRAIL_FRAMES + 1
        for pixel, seen in zip(trail[::-1], features[5::-1], strict=False):
            assert np.abs(seen.pixels[:, :2] - pixel).max(axis=1).min() < 1e-3
    motion = [np.linalg.norm(np.diff(trail, axis=0), axis=1) for trail in overlay.trails]
    speeds = np.concatenate(motion)
    assert np.percentile(speeds, 90) < 3 * np.percentile(speeds, 10)  # nothing jumps to another point


def test_a_trail_does_not_bridge_a_frame_that_lacks_the_point(vehicle: SimulatedVehicle) -> None:
    track, _ = fly(vehicle, tracked=True)
    at_dark, after, later = overlays(track, vehicle.rig.left, [DARK, DARK + 1, DARK + 2])
    assert at_dark.trails == after.trails == []
    assert {len(trail) for trail in later.trails} == {2}


def test_features_are_kept_only_if_asked_for(vehicle: SimulatedVehicle) -> None:
    assert fly(vehicle, tracked=True, keep=False)[0].features == {}
    kept = fly(vehicle, tracked=True)[0].features
    assert list(kept) == vehicle.frame_stamps_ns.tolist()
    assert all(features.descriptors.size == 0 for features in kept.values())


def test_frames_are_chosen_evenly_from_first_to_last() -> None:
    assert evenly(4, 100).tolist() == [0, 33, 66, 99]
    assert evenly(12, 3).tolist() == [0, 1, 2]
    assert evenly(5, 0).tolist() == []
