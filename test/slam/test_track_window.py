# SPDX-License-Identifier: Apache-2.0
"""Tracks through the back end: each view is used once, and the present has them all."""

import copy
import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.config import BackendConfig, VehicleConfig
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.track_views import TrackViews
from uav_vslam.slam.track_window import TrackWindow
from uav_vslam.types import PoseEstimate, StereoFeatures

FRAMES = 24
SIGMA_PX = 0.1
WINDOW = 6


def settings(**changes) -> BackendConfig:
    return BackendConfig(**{"sigma_px": SIGMA_PX / 2, "track_sigma_px": SIGMA_PX, "window": WINDOW, **changes})


def backend_of(flight, **changes) -> SlamBackend:
    config = VehicleConfig(imu=flight.vehicle.scenario.imu_config, backend=settings(**changes))
    return SlamBackend(flight.vehicle.initial, rig=flight.vehicle.rig, config=config, vehicle="uav1")


def fly(flight, backend: SlamBackend) -> list[FrameReport]:
    return [backend.process(*frame) for frame in flight.frames]


@pytest.fixture(scope="module")
def flights(flown) -> list[tuple[Any, list[FrameReport]]]:
    """Twenty flights with the settings as they are, and their reports."""
    seeds = (flown(100 + seed, frames=FRAMES, tracked_px=SIGMA_PX / 2) for seed in range(20))
    return [(flight, fly(flight, backend_of(flight))) for flight in seeds]


def position_errors(flight, reports: list[FrameReport]) -> NDArray[np.float64]:
    truth = flight.vehicle.truth.position(flight.vehicle.frame_times_s)
    return np.array([report.pose.T_map_body.t for report in reports]) - truth


def turn_errors(flight, poses: list[PoseEstimate]) -> list[float]:
    """Return the angles [rad] by which the turns over three frames are wrong."""
    wrong = [flight.vehicle.true_state(pose.stamp_ns).T_map_body.R @ pose.T_map_body.R.T for pose in poses]
    return [float(np.linalg.norm(so3_log(a.T @ b))) for a, b in zip(wrong[:-3], wrong[3:], strict=True)]


def feature(track: int, u: float) -> StereoFeatures:
    return StereoFeatures(0, np.full((1, 4), u, np.float32), np.zeros((1, 8), np.uint8), np.array([track], np.uint32))


def test_the_table_keeps_each_view_at_its_frame() -> None:
    views = TrackViews()
    for features in (feature(7, 1.0), feature(3, 2.0), feature(7, 3.0), feature(0, 4.0)):
        views.add_frame(features)
    np.testing.assert_array_equal(views.tracks, [3, 7])
    np.testing.assert_array_equal(views.seen, [[False, True, False, False], [True, False, True, False]])
    np.testing.assert_array_equal(views.pixels[1, :, 0], [1.0, 0.0, 3.0, 0.0])
    np.testing.assert_array_equal(views.chosen(np.arange(2)).newest_pixels[:, 0], [2.0, 3.0])
    views.drop_frame(1)
    np.testing.assert_array_equal(views.tracks, [7])
    np.testing.assert_array_equal(views.seen, [[True, True, False]])


def test_a_frame_without_points_ends_all_tracks_whatever_the_descriptor() -> None:
    views = TrackViews()
    views.add_frame(feature(7, 1.0))  # with 8 bytes
    views.add_frame(StereoFeatures.empty(1))
    np.testing.assert_array_equal(views.seen, [[True, False]])
    assert views.descriptors.shape == (1, 8)


def test_a_view_that_was_used_as_a_landmark_is_no_tracks_any_more() -> None:
    views = TrackViews()
    views.add_frame(feature(7, 1.0))
    views.add_frame(feature(7, 2.0))
    views.forget_newest(np.array([7], np.uint32))
    np.testing.assert_array_equal(views.seen, [[True, False]])
    views.drop_frame(0)
    assert len(views) == 0


def test_uses_of_a_track_are_counted_until_it_ends() -> None:
    views, row = TrackViews(), np.zeros(1, np.intp)
    for uses in range(3):
        views.add_frame(feature(7, 1.0))
        np.testing.assert_array_equal(views.chosen(row).earlier, [uses])
        views.use(row)
        views.remove(np.ones(1, bool))
    views.add_frame(feature(3, 1.0))
    views.add_frame(feature(7, 1.0))
    np.testing.assert_array_equal(views.chosen(np.arange(2)).earlier, [0, 0])


def test_every_view_of_a_track_is_used_once(flown, monkeypatch) -> None:
    """Count the views that the filter takes for good, and those that are left at the end."""
    flight = flown(3, frames=FRAMES, tracked_px=SIGMA_PX / 2)
    used = []
    finish = TrackWindow.finish

    def counted(self, slam_filter, *rest, **how) -> int:
        before = self.views.seen.sum()
        shown = finish(self, slam_filter, *rest, **how)
        used.append(before - self.views.seen.sum())
        return shown

    monkeypatch.setattr(TrackWindow, "finish", counted)
    backend = backend_of(flight, max_new_landmarks=0)
    fly(flight, backend)
    assert len(backend.landmarks[0]) == 0
    dropped = sum(used) + backend._window.views.seen.sum()
    assert dropped == sum(len(features) for features, _ in flight.frames)
    assert len(backend._filter.past) <= WINDOW


@pytest.mark.slow
def test_tracks_alone_locate_the_vehicle_and_the_covariance_is_honest(flights) -> None:
    errors, nees = [], []
    for flight, reports in flights:
        assert not any(report.coasted for report in reports[2:])
        error = position_errors(flight, reports)
        errors.append(np.linalg.norm(error[-1]))
        nees.append(error[-1] @ np.linalg.solve(reports[-1].pose.covariance[:3, :3], error[-1]) / 3)
    assert np.sqrt(np.mean(np.square(errors))) < 1.0  # dead reckoning: 3.5 m
    assert 0.4 < np.mean(nees) < 1.7  # chi-square of 60 degrees of freedom: 0.67 to 1.39 at 95 %


def test_focal_lengths_that_differ_from_the_calibrated_ones_cost_no_tracks(flown) -> None:
    """By 0.1 %, as 0.6 px at the edges of the image, where points scatter by 0.05 px."""
    used, errors = [], []
    for bias in (0.0, 1e-3):
        flight = flown(5, frames=FRAMES, tracked_px=SIGMA_PX / 4, focal_ratio_bias=bias)
        reports = fly(flight, backend_of(flight, track_sigma_px=SIGMA_PX / 2))
        used.append(sum(report.innovation.dof for report in reports if report.innovation))
        errors.append(np.linalg.norm(position_errors(flight, reports), axis=1).mean())
    assert used[1] > 0.98 * used[0]
    assert errors[1] < 1.1 * errors[0]


@pytest.mark.parametrize("vibration_deg", [0.02, 0.05])
def test_a_rig_that_vibrates_is_noticed_and_flexes_from_then_on(flown, vibration_deg: float) -> None:
    """From the start state: what images have done to the estimate until then does not count, nor is the IMU blamed."""
    flight = flown(5, frames=3 * FRAMES, tracked_px=SIGMA_PX / 4, vibration_deg=vibration_deg)
    backend = backend_of(flight, sigma_px=SIGMA_PX, track_sigma_px=SIGMA_PX / 2)
    reports = fly(flight, backend)
    (frame,) = [k for k, report in enumerate(reports) if report.recovery]
    assert frame < 6
    assert "rig.flexing" in reports[frame].recovery
    assert [report.flexing for report in reports] == [k >= frame for k in range(len(reports))]
    assert backend.imu_fault == ""
    start, noticed = flight.vehicle.initial.covariance[:3, :3], reports[frame].pose.covariance[:3, :3]
    assert np.trace(noticed) < np.trace(start) + 3 * 0.1**2
    error = np.linalg.norm(position_errors(flight, reports), axis=1)
    assert error.max() < 2.0


def test_the_state_and_the_window_stay_bounded(flown) -> None:
    flight = flown(4, frames=FRAMES, tracked_px=SIGMA_PX / 2)
    backend = backend_of(flight)
    sizes = []
    for frame in flight.frames:
        backend.process(*frame)
        sizes.append(len(backend._filter.past))
    assert max(sizes) == WINDOW
    assert sizes[-5:] == [WINDOW] * 5


@pytest.mark.slow
def test_identifiers_of_tracks_that_have_ended_are_forgotten(flown) -> None:
    """Some end just after the full window has used their views, and are in the table no more."""
    flight = flown(1, frames=60, tracked_px=SIGMA_PX / 2)
    backend, most = backend_of(flight), 0
    for features, increment in flight.frames:
        backend.process(features, increment)
        backend.joint_information()  # gives identifiers to what is still tracked
        assert backend._window._ids.keys() <= set(features.tracks.tolist())
        most = max(most, len(backend._window._ids))
    assert most > 5


@pytest.mark.slow
def test_motion_between_poses_that_leave_the_window_is_better_than_between_present_ones(flights) -> None:
    causal, smoothed, nees = [], [], []
    for flight, reports in flights:
        leaving = [report.smoothed for report in reports if report.smoothed is not None]
        assert [pose.stamp_ns for pose in leaving] == [r.pose.stamp_ns for r in reports][: FRAMES - WINDOW]
        truth = flight.vehicle.truth.position(flight.vehicle.frame_times_s)
        causal.append(turn_errors(flight, [report.pose for report in reports[: len(leaving)]]))
        smoothed.append(turn_errors(flight, leaving))
        error = leaving[-1].T_map_body.t - truth[len(leaving) - 1]
        nees.append(error @ np.linalg.solve(leaving[-1].covariance[:3, :3], error) / 3)
    assert np.sqrt(np.mean(np.square(smoothed)) / np.mean(np.square(causal))) < 0.8  # 0.6 here
    assert 0.4 < np.mean(nees) < 1.8


def test_poses_closer_than_the_spacing_are_not_kept(flown) -> None:
    flight = flown(5, frames=FRAMES, tracked_px=SIGMA_PX / 2)
    backend = backend_of(flight, window_spacing_s=0.25)  # frames are 0.14 s apart
    reports = fly(flight, backend)
    assert np.diff(backend._filter.past.stamps_ns[:-1]).min() > 0.25e9
    assert np.linalg.norm(position_errors(flight, reports)[-1]) < 1.5


def test_points_still_tracked_are_in_the_joint_estimate_under_lasting_identifiers(flown) -> None:
    flight = flown(6, frames=FRAMES, tracked_px=SIGMA_PX / 2)
    backend = backend_of(flight)
    known: dict[int, int] = {}
    for frame in flight.frames:
        backend.process(*frame)
        joint = backend.joint_information()
        assert len(set(joint.ids.tolist())) == len(joint.ids) == len(joint.positions) == len(joint.descriptors)
        for track, identifier in backend._window._ids.items():
            assert known.setdefault(track, identifier) == identifier
        nearest = np.linalg.norm(joint.positions[:, None] - joint.positions[None], axis=-1)
        assert nearest[~np.eye(len(nearest), dtype=bool)].min(initial=np.inf) > 0.2  # no point is in it twice
    assert len(joint.ids) > len(backend.landmarks[0]) + 10
    np.testing.assert_allclose(joint.covariance[:6, :6], backend._nav.pose.covariance, rtol=0.2, atol=1e-6)


def test_a_sliding_track_that_ends_first_does_not_mislead_an_uncertain_start(flown) -> None:
    """The start's velocity is uncertain, so that the track alone fits the state well."""
    slides_px = 3.0
    for seed in range(5):
        flight = flown(400 + seed, frames=8, tracked_px=SIGMA_PX / 2)
        undisturbed = position_errors(flight, fly(flight, backend_of(flight)))
        flight = copy.deepcopy(flight)  # the fixture keeps it
        first, second = (features for features, _ in flight.frames[:2])
        track = np.intersect1d(first.tracks[first.tracks != 0], second.tracks)[0]
        second.pixels[second.tracks == track, ::2] += slides_px
        for features, _ in flight.frames[2:]:
            features.tracks[features.tracks == track] = 0
        reports = fly(flight, backend_of(flight))
        assert not any(report.coasted for report in reports[1:])
        np.testing.assert_allclose(position_errors(flight, reports), undisturbed, atol=0.02)


def test_tracks_that_are_all_refused_do_not_hide_that_landmarks_correct_the_state(flown) -> None:
    """What is tracked moves with the vehicle, as its shadow. The filter is not lost, nor is the IMU faulty."""
    flight, rng, fixed = flown(1, frames=9), np.random.default_rng(1), 30
    rig, tracks = flight.vehicle.rig, np.arange(1, fixed + 1, dtype=np.uint32)
    shadow = rig.project(60.0 * rig.left.bearings(rng.uniform([100, 100], [1100, 850], (fixed, 2))))
    backend = backend_of(flight, sigma_px=1.0, window=10)
    for features, step in flight.frames:
        seen = shadow + rng.normal(0.0, SIGMA_PX / 2, shadow.shape)
        unlike = rng.integers(0, 255, (fixed, features.descriptors.shape[1])).astype(np.uint8)
        both = StereoFeatures(
            features.stamp_ns,
            np.vstack([features.pixels, seen]).astype(np.float32),
            np.vstack([features.descriptors, unlike]),
            np.concatenate([np.zeros(len(features), np.uint32), tracks]),
        )
        report = backend.process(both, step)
    assert report.associated > 20
    assert report.innovation is not None
    assert report.innovation.dof == 4 * report.associated


@pytest.mark.parametrize("changes", [{"filter": "thesis_ukf", "model": "euler9"}, {"model": "euler9"}])
def test_the_thesiss_filters_and_states_have_no_past_poses(flown, changes) -> None:
    flight = flown(7, frames=6, tracked_px=SIGMA_PX / 2)
    backend = backend_of(flight, **changes, max_new_landmarks=10)
    fly(flight, backend)
    assert len(backend._filter.past) == 0
    assert len(backend.landmarks[0]) > 0


@pytest.mark.parametrize(("going_on", "found_by_looks"), [(0.05, True), (0.2, False)])
def test_where_hardly_a_track_goes_on_landmarks_are_as_if_long_unseen(flown, going_on, found_by_looks) -> None:
    """Found again by their looks alone, they are less exact than tracked points."""
    flight, at = flown(107, frames=12, tracked_px=SIGMA_PX / 2), 8
    backend = backend_of(flight)
    for features, increment in flight.frames[:at]:
        assert backend.process(features, increment).closures == 0
    features, increment = flight.frames[at]
    tracks = np.where(np.arange(len(features)) < going_on * len(features), features.tracks, features.tracks + 10**6)
    report = backend.process(dataclasses.replace(features, tracks=tracks.astype(np.uint32)), increment)
    assert (report.closures > 10) == found_by_looks
    assert report.associated > 10
