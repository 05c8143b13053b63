# SPDX-License-Identifier: Apache-2.0
"""Which landmarks make room for others, and how much those count that have come back."""

import dataclasses
import itertools

import numpy as np
import pytest
from fed_stage import feed

from uav_vslam.config import BackendConfig, ImuConfig, VehicleConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.landmark_map import LONG_FRAMES
from uav_vslam.slam.local_map import VISIT_FRAMES, visit_weights
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, NavState, StereoFeatures

HEIGHT_M, POINTS, LOST = 30.0, 40, 0.05


def test_the_frames_of_a_visit_weigh_as_measurements_with_one_common_error() -> None:
    """Dense reference: the redetection error of a landmark that came back is the same in all its frames."""
    S = 0.5**2 * np.eye(VISIT_FRAMES) + 1.5**2 * np.ones((VISIT_FRAMES, VISIT_FRAMES))
    information = np.linalg.solve(S, np.ones(VISIT_FRAMES)).sum()
    back, other = visit_weights(np.array([True, False]), BackendConfig(sigma_px=0.5, redetection_px=1.5))
    np.testing.assert_allclose(VISIT_FRAMES * back / 0.5**2, information, rtol=1e-12)
    assert other == 1.0


def changing_points(stamps_ns: list[int], rng: np.random.Generator) -> list[StereoFeatures]:
    """Return what a vehicle sees that stands still: in each frame, other points replace a share of those before."""
    rig, frames = kagaru_rig(), []
    pixels, descriptors = np.zeros((0, 4)), np.zeros((0, 128))
    for stamp_ns in stamps_ns:
        stays = rng.random(len(pixels)) >= LOST
        pixels, descriptors = pixels[stays], descriptors[stays]
        rays = rig.left.bearings(rng.uniform([200, 200], [1080, 500], (POINTS - len(pixels), 2)))
        pixels = np.vstack([pixels, rig.project(HEIGHT_M * rays)])
        descriptors = np.vstack([descriptors, rng.uniform(0.0, 80.0, (len(rays), 128))])
        seen = (pixels + rng.normal(0.0, 1.0, pixels.shape)).astype(np.float32)
        frames.append(StereoFeatures(stamp_ns, seen, descriptors.astype(np.uint8)))
    return frames


@pytest.mark.slow
def test_landmarks_that_are_gone_make_room_for_those_that_hover_shows() -> None:
    """None leaves the image in hover. Gone ones that fill it would leave nothing to observe."""
    rng, imu = np.random.default_rng(1), ImuConfig()
    stamps_ns = [k * NS_PER_S // 7 for k in range(1, 5 * LONG_FRAMES)]
    rest = [ImuSample(k * NS_PER_S // 200, np.zeros(3), np.array([0.0, 0.0, imu.gravity])) for k in range(200 * 25)]
    zero = np.zeros(3)
    steps = [
        preintegrate(rest, a, b, gyro_bias=zero, accel_bias=zero, imu=imu) for a, b in itertools.pairwise(stamps_ns)
    ]
    start = NavState(stamps_ns[0], Pose(np.eye(3), np.array([0.0, 0.0, HEIGHT_M])), zero, zero, zero)
    config = VehicleConfig(imu=imu, backend=BackendConfig(max_in_view=POINTS, max_landmarks=2 * POINTS))
    initial = NavEstimate(start, np.diag(np.repeat([0.05, 0.1, 0.003, 5e-4, 0.05], 3) ** 2))
    backend = SlamBackend(initial, rig=kagaru_rig(), config=config, vehicle="uav1")
    frames = zip(changing_points(stamps_ns, rng), [None, *steps], strict=True)
    reports = [backend.process(features, increment) for features, increment in frames]
    assert not any(report.recovery for report in reports)
    assert min(report.associated for report in reports[1:]) >= 0.2 * POINTS


def test_landmarks_without_a_track_are_observed_beside_tracks(flown) -> None:
    """A front end need not track all points: that two have no track does not make it the same track."""
    flight = flown(1, tracked_px=0.3)
    frames = [
        (dataclasses.replace(features, tracks=features.tracks * (features.tracks % 2)), step)
        for features, step in flight.frames
    ]
    observed: list[set[int]] = []
    for output, (features, _) in zip(feed(flight.tracking_stage(0.3), frames), frames, strict=True):
        sightings = output.report.sightings
        observed.append(set(sightings[features.tracks[sightings[:, 1]] == 0, 0].tolist()))
    again = [len(now & before) for before, now in itertools.pairwise(observed)]
    assert min(again[2:]) >= 10  # of some twenty; the first frames' landmarks wait for the angular rate
