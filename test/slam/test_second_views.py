# SPDX-License-Identifier: Apache-2.0
"""Landmarks initialised again with their second view, where images are far apart."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from position_nees import position_nees

from uav_vslam.config import BackendConfig, VehicleConfig
from uav_vslam.slam import second_views
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.types import StereoFeatures

FRAMES = 24
FAR_HZ = 2.0  # 10 m from image to image


def backend_of(flight, **changes) -> SlamBackend:
    config = VehicleConfig(imu=flight.vehicle.scenario.imu_config, backend=BackendConfig(**changes))
    return SlamBackend(flight.vehicle.initial, rig=flight.vehicle.rig, config=config, vehicle="uav1")


def fly(flight, **changes) -> tuple[SlamBackend, list[Any]]:
    backend = backend_of(flight, **changes)
    return backend, [backend.process(*frame) for frame in flight.frames]


def past_poses(backend: SlamBackend) -> int:
    return len(backend._filter.past)


def mean_nees(flown) -> float:
    """Return the mean position NEES per axis of four flights."""
    nees = []
    for seed in range(1, 5):
        flight = flown(seed, frames=FRAMES, frame_rate_hz=FAR_HZ)
        _, reports = fly(flight)
        poses = [report.pose for report in reports[5:]]
        nees += [position_nees(pose, flight.vehicle.true_state(pose.stamp_ns)) for pose in poses]
    return float(np.mean(nees))


@pytest.mark.slow
def test_images_far_apart_leave_the_filter_consistent(flown, monkeypatch) -> None:
    """It is over-confident where landmarks stay linearised about their first view."""
    nees = mean_nees(flown)
    assert 0.5 < nees < 1.4
    monkeypatch.setattr(second_views, "FAR", np.inf)
    assert mean_nees(flown) > 1.5 * nees


def test_where_images_are_close_no_pose_is_kept(flown) -> None:
    backend, _ = fly(flown(1, frames=FRAMES))
    assert past_poses(backend) == 0


def test_the_newest_pose_alone_is_kept(flown) -> None:
    flight = flown(1, frames=FRAMES, frame_rate_hz=FAR_HZ)
    backend = backend_of(flight)
    for k, frame in enumerate(flight.frames):
        backend.process(*frame)
        assert past_poses(backend) == (k > 0)  # the angular rate at the first frame is not known yet


def test_a_landmark_keeps_its_identifier_and_its_history(flown) -> None:
    flight = flown(1, frames=FRAMES, frame_rate_hz=FAR_HZ)
    backend, seen = backend_of(flight), {}
    before = flight.frames[0][0]
    for features, increment in flight.frames:
        report = backend.process(features, increment)
        for frame, sightings in ((before, report.late_sightings), (features, report.sightings)):
            for identifier, row in sightings.tolist():
                seen.setdefault(identifier, []).append(frame.descriptors[row])
        before = features
    landmarks = backend._map
    known = [k for k, identifier in enumerate(landmarks.ids.tolist()) if len(seen[identifier]) > 1]
    assert len(known) > 20
    for k in known:
        views = seen[int(landmarks.ids[k])]
        assert landmarks.observations[k] == len(views)
        np.testing.assert_array_equal(landmarks.descriptors[k], views[-1])
        np.testing.assert_allclose(landmarks.statistics.mean[k], np.mean(views, axis=0), atol=1e-3)


@pytest.mark.parametrize("name", ["eif", "ekf", "ukf", "uhf"])
def test_every_filter_can(flown, name: str) -> None:
    flight = flown(2, frames=8, frame_rate_hz=FAR_HZ)
    _, reports = fly(flight, filter=name)
    assert not any(report.recovery for report in reports)
    assert all(report.associated > 10 for report in reports[1:])


def test_a_landmark_whose_views_contradict_each_other_is_removed(flown, monkeypatch) -> None:
    monkeypatch.setattr(second_views, "GATE_PROBABILITY", 1e-12)
    flight = flown(1, frames=2, frame_rate_hz=FAR_HZ)
    _, reports = fly(flight)
    assert reports[1].associated == 0  # all of them were seen for the second time
    monkeypatch.undo()
    _, reports = fly(flight)
    assert reports[1].associated > 10


def test_a_frame_without_points_ends_it(flown) -> None:
    flight = flown(1, frames=FRAMES, frame_rate_hz=FAR_HZ)
    backend = backend_of(flight)
    for k, (features, increment) in enumerate(flight.frames):
        shown = StereoFeatures.empty(features.stamp_ns) if k == 10 else features
        backend.process(shown, increment)
        assert past_poses(backend) == (k not in (0, 10))


def test_tracks_that_appear_later_begin_a_window_of_their_own(flown) -> None:
    flight = flown(1, frames=FRAMES, frame_rate_hz=FAR_HZ, tracked_px=0.5)
    backend = backend_of(flight, sigma_px=0.5, track_sigma_px=1.0, window=4)
    kept = []
    for k, (features, increment) in enumerate(flight.frames):
        without = dataclasses.replace(features, tracks=np.zeros_like(features.tracks))
        report = backend.process(without if k < 6 else features, increment)
        assert not report.recovery
        kept.append(past_poses(backend))
    assert kept == [0] + [1] * 6 + [2, 3] + [4] * (FRAMES - 9)
