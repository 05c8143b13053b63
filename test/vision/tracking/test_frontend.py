# SPDX-License-Identifier: Apache-2.0
"""The live front end over rendered flights at a quarter of the size."""

import dataclasses
import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.camera_render import RenderedFlight, intersect
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.terrain import relief_of
from uav_vslam.types import StereoFeatures, StereoFrame
from uav_vslam.vision.tracking.frontend import TrackingFrontend

FRAMES = 8
CONFIG = FrontendConfig(search_scale=1.0, max_tracks=120)
FLIGHT = Scenario(frames=FRAMES, scale=0.25, noise_sigma=1.0)
LARGEST_SIGMA_PX = 0.15
LARGEST_WRONG_SHARE = 0.01

Array = NDArray[np.float64]
Flown = tuple[SimulatedVehicle, list[StereoFrame]]


def flown(scenario: Scenario) -> Flown:
    vehicle = simulate_vehicle(scenario, 0)
    return vehicle, list(RenderedFlight(vehicle))


@pytest.fixture(scope="module")
def flight() -> Flown:
    return flown(FLIGHT)


def process(rig: StereoRig, frames: list[StereoFrame]) -> list[StereoFeatures]:
    frontend = TrackingFrontend(rig, CONFIG)
    return [frontend.process(frame) for frame in frames]


def right_errors(vehicle: SimulatedVehicle, k: int, features: StereoFeatures) -> np.ndarray:
    """Return (N, 2) right pixel minus the true projection of the left pixel's surface point [px]."""
    pose = vehicle.truth.pose(float(vehicle.frame_times_s[k]))
    rig = vehicle.true_rig(k)
    T_world_left = pose @ rig.T_body_left
    rays = rig.left.bearings(features.pixels[:, :2]) @ T_world_left.R.T
    points = intersect(relief_of(vehicle.scenario), T_world_left.t, rays)
    return features.pixels[:, 2:] - rig.right.project((pose @ rig.T_body_right).inverse().apply(points))


def test_points_are_precise_and_wrong_ones_rare(flight: Flown) -> None:
    vehicle, frames = flight
    errors = np.vstack([right_errors(vehicle, k, found) for k, found in enumerate(process(vehicle.rig, frames))])
    assert len(errors) > 0.5 * CONFIG.max_tracks * FRAMES
    assert (errors.std(axis=0) < LARGEST_SIGMA_PX).all()
    assert np.mean(np.linalg.norm(errors, axis=1) > 1.0) <= LARGEST_WRONG_SHARE


def drifts_px(vehicle: SimulatedVehicle, first: tuple[int, StereoFeatures], last: tuple[int, StereoFeatures]) -> Array:
    """Return the drift over the ground of the tracks common to two frames [px]."""
    _, *rows = np.intersect1d(first[1].tracks, last[1].tracks, return_indices=True)
    places = []
    for (k, features), chosen in zip((first, last), rows, strict=True):
        T_world_left = vehicle.truth.pose(float(vehicle.frame_times_s[k])) @ vehicle.rig.T_body_left
        rays = vehicle.rig.left.bearings(features.pixels[chosen, :2]) @ T_world_left.R.T
        places.append(intersect(relief_of(vehicle.scenario), T_world_left.t, rays))
    return np.linalg.norm(places[1] - places[0], axis=1) * vehicle.rig.left.fx / 70.0


def test_tracks_do_not_drift(flight: Flown) -> None:
    vehicle, frames = flight
    first, *later = process(vehicle.rig, frames)
    drifts = drifts_px(vehicle, (0, first), (4, later[3]))
    assert len(drifts) >= 20
    assert np.median(drifts) < 0.3
    _, rows, same = np.intersect1d(first.tracks, later[3].tracks, return_indices=True)
    np.testing.assert_array_equal(first.descriptors[rows], later[3].descriptors[same])


@pytest.mark.slow
def test_tracks_that_leave_the_image_in_a_long_gap_do_not_mislead_the_others() -> None:
    drifts = []
    for seed in (1, 2, 3, 4):
        vehicle, frames = flown(dataclasses.replace(FLIGHT, frames=11, seed=seed))
        before, after = process(vehicle.rig, [*frames[:4], frames[10]])[3:]  # 17 px a frame: half of 240 in the gap
        drifts.extend(drifts_px(vehicle, (3, before), (10, after)))
    assert len(drifts) >= 100
    assert np.mean(np.array(drifts) < 0.5) > 0.9


def test_every_point_has_a_track_and_ids_are_never_reused(flight: Flown) -> None:
    vehicle, frames = flight
    gone: set[int] = set()
    before: set[int] = set()
    for features in process(vehicle.rig, frames):
        tracks = set(features.tracks.tolist())
        assert len(tracks) == len(features) <= CONFIG.max_tracks
        assert 0 not in tracks
        gone |= before - tracks
        assert not gone & tracks
        before = tracks


def test_cameras_of_different_gain_and_vignette_keep_their_points(flight: Flown) -> None:
    counts = []
    for scenario in (FLIGHT, dataclasses.replace(FLIGHT, right_gain=1.15, right_vignette=0.35)):
        vehicle, frames = flown(dataclasses.replace(scenario, frames=4))
        counts.append(sum(map(len, process(vehicle.rig, frames))))
    assert counts[1] >= 0.95 * counts[0]


def test_a_jump_in_brightness_and_a_lost_frame_keep_most_tracks(flight: Flown) -> None:
    vehicle, frames = flight
    brighter = [np.clip(1.4 * image, 0, 255).astype(np.uint8) for image in (frames[5].left, frames[5].right)]
    jumped = StereoFrame(frames[5].stamp_ns, *brighter)
    before, after = process(vehicle.rig, [frames[2], frames[3], jumped])[1:]
    still_in_view = before.pixels[:, 1] < vehicle.rig.left.height - 2 * 17 - 15  # 17 px a frame along v
    kept = np.isin(before.tracks[still_in_view], after.tracks)
    assert kept.mean() > 0.6


def test_black_images_end_the_tracks_and_new_ones_start_at_once(flight: Flown) -> None:
    vehicle, frames = flight
    frontend = TrackingFrontend(vehicle.rig, CONFIG)
    seen = [frontend.process(frame) for frame in frames[:2]]
    black = np.zeros_like(frames[2].left)
    assert len(frontend.process(StereoFrame(frames[2].stamp_ns, black, black))) == 0
    assert "shows nothing" in frontend.alarms["left camera"]
    again = frontend.process(frames[3])
    assert len(again) > 0.5 * len(seen[0])
    assert not set(again.tracks.tolist()) & set(seen[1].tracks.tolist())
    assert frontend.alarms == {}


def test_when_few_tracks_are_left_new_ones_start_at_once(flight: Flown) -> None:
    """Another place is in view, but for a patch."""
    vehicle, frames = flight
    _, elsewhere = flown(dataclasses.replace(FLIGHT, frames=2, seed=FLIGHT.seed + 1))
    images = [elsewhere[1].left.copy(), elsewhere[1].right.copy()]
    for image, before in zip(images, (frames[0].left, frames[0].right), strict=True):
        image[90:150, 120:180] = before[90:150, 120:180]
    first, second = process(vehicle.rig, [frames[0], StereoFrame(frames[1].stamp_ns, *images)])
    assert 0 < np.isin(second.tracks, first.tracks).sum() < 20
    assert len(second) > 0.5 * len(first)


def test_frames_share_tracks_where_a_third_of_the_ground_is_new_in_each() -> None:
    """Points seen for two frames only must not wait for every third frame's detection."""
    vehicle, frames = flown(dataclasses.replace(FLIGHT, altitude=30.0, speed=40.0))
    found = process(vehicle.rig, frames)
    shared = [len(np.intersect1d(a.tracks, b.tracks)) for a, b in itertools.pairwise(found[3:])]
    assert min(shared) >= 20


def test_points_of_the_first_pair_are_found_near_the_ground() -> None:
    """At 8 m their disparity is 159 px, far from that of half the largest depth."""
    vehicle, frames = flown(Scenario(frames=2, altitude=8.0, speed=2.0, relief_m=0.2))
    features = TrackingFrontend(vehicle.rig, FrontendConfig()).process(frames[0])
    assert len(features) > 100
    errors = np.linalg.norm(right_errors(vehicle, 0, features), axis=1)
    assert np.median(errors) < 1.0  # the finest texture, 5 cm, is 10 px wide there


def test_after_a_long_gap_all_tracks_are_new(flight: Flown) -> None:
    vehicle, frames = flight
    late = dataclasses.replace(frames[1], stamp_ns=frames[0].stamp_ns + 2_000_000_000)
    first, second = process(vehicle.rig, [frames[0], late])
    assert len(second) > 0
    assert not set(first.tracks.tolist()) & set(second.tracks.tolist())


def test_swapped_images_are_reported_and_give_no_points(flight: Flown) -> None:
    vehicle, frames = flight
    frontend = TrackingFrontend(vehicle.rig, CONFIG)
    frontend.process(frames[0])
    swapped = frontend.process(StereoFrame(frames[1].stamp_ns, frames[1].right, frames[1].left))
    assert len(swapped) < 10
    assert "swapped" in frontend.alarms["image order"]
