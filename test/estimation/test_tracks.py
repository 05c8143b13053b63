# SPDX-License-Identifier: Apache-2.0
"""Tracks of points that are no landmarks: what they say about past poses, against dense least squares."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.config import RigConfig
from uav_vslam.estimation.belief import NO_ROWS
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.filters import FILTERS
from uav_vslam.estimation.past_poses import PastPoses
from uav_vslam.estimation.rig_errors import RigErrors, RigState
from uav_vslam.estimation.track_linearisation import relinearised
from uav_vslam.estimation.tracks import DRIFT, LEFT, OFFSET, TrackObservation, Tracks, observe_tracks
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.numerics import submatrix
from uav_vslam.types import NavEstimate

Array = NDArray[np.float64]

VIEWS = 4
SIGMA_PX = 0.1
RIG = RigConfig(time_offset_sigma_s=1e-3)
TURNING = Turning(np.array([0.05, -0.2, 0.1]), np.array([3.0, 1.0, -2.0]))


def past_poses(course) -> PastPoses:
    return course.past_poses(VIEWS, TURNING)


def seen_tracks(course, rng: np.random.Generator | None = None) -> Tracks:
    """Return all landmarks as tracks, some with missing views."""
    pixels = np.stack([course.pixels(frame, np.arange(len(course.landmarks))) for frame in range(VIEWS)], axis=1)
    seen = np.ones(pixels.shape[:2], bool)
    seen[0, :2], seen[1, -1], seen[2, 1] = False, False, False
    noise = 0.0 if rng is None else rng.normal(0.0, 0.5 * SIGMA_PX, pixels.shape)
    return Tracks(np.where(seen[..., None], pixels + noise, np.nan), seen)


def observed(course, tracks: Tracks, past: PastPoses | None = None, rig_state: RigState | None = None):
    errors = RigErrors(course.rig, RIG, 15)
    state = rig_state or RigState()
    shown = (past or past_poses(course)).at_exposure(state.time_offset_s)
    return observe_tracks(tracks, shown, rig=errors.rig(state), errors=errors, sigma_px=SIGMA_PX)


def misfit(seen: TrackObservation) -> Array:
    """Return (T, 4V) residuals after each track's point has been fitted: what is left for the poses."""
    return seen.residual - np.einsum("tij,tkj,tk->ti", seen.Q, seen.Q, seen.residual)


def test_points_are_found_where_they_are(course) -> None:
    tracks = seen_tracks(course)
    found = observed(course, dataclasses.replace(tracks, pixels=np.nan_to_num(tracks.pixels)))
    assert found.good.all()
    np.testing.assert_allclose(found.points, course.landmarks, atol=1e-6)
    np.testing.assert_array_equal(found.views, tracks.seen.sum(axis=1))
    np.testing.assert_allclose(found.residual, 0.0, atol=1e-6)


@pytest.mark.parametrize("detected", [False, True])
def test_jacobians_are_the_numerical_ones(course, detected: bool) -> None:
    """Move each past pose and each rig error, and fit the points again: the change of the misfit is -H."""
    tracks = seen_tracks(course, np.random.default_rng(1))
    tracks = dataclasses.replace(tracks, pixels=np.nan_to_num(tracks.pixels), detected=detected)
    at = observed(course, tracks)
    projected = at.H - at.Q @ at.of_points
    errors = RigErrors(course.rig, RIG, 15)
    step = 1e-6
    for column in range(errors.dim + POSE_DIM * VIEWS):
        ends = []
        for sign in (1.0, -1.0):
            past, delta = past_poses(course), np.zeros(15 + errors.dim)
            if column < errors.dim:
                delta[15 + column] = sign * step
            else:
                moves = np.zeros((VIEWS, POSE_DIM))
                moves[divmod(column - errors.dim, POSE_DIM)] = sign * step
                past = past.moved(moves[:, 3:], past.t + moves[:, :3])
            ends.append(misfit(observed(course, tracks, past, errors.retract(RigState(), delta))))
        slope = (ends[1] - ends[0]) / (2 * step)
        scale = np.abs(projected[..., column]).max()
        np.testing.assert_allclose(slope / scale, projected[..., column] / scale, atol=2e-3)


def test_a_track_says_nothing_about_position_and_heading_of_the_map(course) -> None:
    seen = observed(course, dataclasses.replace(t := seen_tracks(course), pixels=np.nan_to_num(t.pixels)))
    positions = past_poses(course).t
    up = np.array([0.0, 0.0, 1.0])
    for shift, turn in [(axis, np.zeros(3)) for axis in np.eye(3)] + [(np.zeros(3), up)]:
        of_poses = [np.concatenate([shift + np.cross(turn, p), turn]) for p in positions]
        gauge = np.concatenate([np.zeros(RigErrors(course.rig, RIG, 15).dim), *of_poses])
        Y = seen.of_poses().Y
        assert np.abs(Y @ gauge).max() < 1e-9 * np.abs(Y).max() * np.abs(gauge).max()


def test_poses_and_point_together_are_the_information_of_the_views(course) -> None:
    """The two parts of the split add up to the normal equations of poses and points."""
    tracks = seen_tracks(course, np.random.default_rng(2))
    seen = observed(course, dataclasses.replace(tracks, pixels=np.nan_to_num(tracks.pixels)))
    H_f = seen.Q @ seen.R
    of_poses, of_points = seen.of_poses(), seen.of_points
    whole = np.einsum("tia,tib->ab", seen.H, seen.H)
    pieces = of_poses.Y + np.einsum("tka,tkb->ab", of_points, of_points)
    np.testing.assert_allclose(pieces, whole, atol=1e-8 * np.abs(whole).max())
    cross = np.swapaxes(of_points, 1, 2) @ seen.R
    np.testing.assert_allclose(cross, np.swapaxes(seen.H, 1, 2) @ H_f, atol=1e-8 * np.abs(cross).max())


def test_noise_of_a_track_is_white_after_whitening(course) -> None:
    """Left pixels scatter about a patch that drifts as its image moves; right ones about them, with a constant."""
    count, rng = 4000, np.random.default_rng(3)
    one = seen_tracks(course)
    pixels = np.repeat(one.pixels[5:6], count, axis=0)
    moved_px = np.linalg.norm(np.diff(one.pixels[5, :, :2], axis=0), axis=1)
    steps = DRIFT * SIGMA_PX * np.sqrt(moved_px)[:, None] * rng.normal(size=(count, VIEWS - 1, 2))
    drift = np.concatenate([np.zeros((count, 1, 2)), np.cumsum(steps, axis=1)], axis=1)
    left = drift + rng.normal(0.0, LEFT * SIGMA_PX, (count, VIEWS, 2))
    match = rng.normal(0.0, SIGMA_PX, (count, VIEWS, 2)) + rng.normal(0.0, OFFSET * SIGMA_PX, (count, 1, 2))
    noisy = Tracks(pixels + np.concatenate([left, left + match], axis=-1), np.ones((count, VIEWS), bool))
    seen = observed(course, noisy)
    chi2, freedom = np.sum(misfit(seen) ** 2, axis=1), 4 * VIEWS - 3
    assert seen.of_poses().norm2 == pytest.approx(chi2.sum())
    assert seen.of_poses().dof == freedom * count
    assert abs(chi2.mean() / freedom - 1.0) < 4.0 * np.sqrt(2.0 / freedom / count)
    assert abs(chi2.var() / (2 * freedom) - 1.0) < 0.15


def test_noise_of_detected_points_is_white_and_the_same_in_both_cameras(course) -> None:
    count, rng = 4000, np.random.default_rng(3)
    pixels = np.repeat(seen_tracks(course).pixels[5:6], count, axis=0)
    noisy = pixels + rng.normal(0.0, SIGMA_PX, pixels.shape)
    seen = observed(course, Tracks(noisy, np.ones((count, VIEWS), bool), detected=True))
    chi2, freedom = np.sum(misfit(seen) ** 2, axis=1), 4 * VIEWS - 3
    assert abs(chi2.mean() / freedom - 1.0) < 4.0 * np.sqrt(2.0 / freedom / count)
    assert abs(chi2.var() / (2 * freedom) - 1.0) < 0.15


def test_a_track_that_is_used_again_and_again_says_little_more_of_a_constant_error(course) -> None:
    one = seen_tracks(course)
    disparity = RigErrors(course.rig, RIG, 15).disparity.start - 15
    information = []
    for uses in range(50):
        H = observed(course, Tracks(np.nan_to_num(one.pixels[5:6]), one.seen[5:6], uses)).H[0, :, disparity]
        information.append(float(H @ H))
    assert information[0] == pytest.approx(1.0 / (SIGMA_PX**2 * (1.0 / VIEWS + OFFSET**2)), rel=0.2)
    assert sum(information) < 3.0 * information[0]


def test_the_way_of_the_image_is_the_median_tracks_and_stops_where_none_is_followed() -> None:
    pixels = np.zeros((3, 4, 4))
    pixels[:, :, 0] = np.outer([3.0, 4.0, 90.0], [0.0, 1.0, 2.0, 3.0])
    seen = np.array([[1, 1, 0, 1], [1, 1, 0, 1], [1, 1, 0, 0]], bool)
    np.testing.assert_allclose(Tracks(pixels, seen).way_px, [0.0, 4.0, 4.0, 4.0])
    np.testing.assert_allclose(Tracks(pixels[:2], seen[:2]).way_px, [0.0, 3.5, 3.5, 3.5])
    np.testing.assert_array_equal(Tracks(pixels[:0], seen[:0]).way_px, np.zeros(4))


def test_a_track_that_slides_fails_the_gate_and_others_pass(course) -> None:
    tracks = seen_tracks(course)
    pixels = np.nan_to_num(tracks.pixels)
    pixels[4, :, [0, 2]] += np.linspace(0.0, 40 * SIGMA_PX, VIEWS) ** 2
    P = np.diag(np.full(RigErrors(course.rig, RIG, 15).dim + POSE_DIM * VIEWS, 1e-12))
    passed = observed(course, Tracks(pixels, tracks.seen)).gated(P, 0.99)[0]
    assert not passed[4]
    assert passed.sum() == len(passed) - 1


def test_no_tracks_say_nothing(course) -> None:
    tracks = seen_tracks(course)
    none = observed(course, Tracks(np.nan_to_num(tracks.pixels)[:0], tracks.seen[:0]))
    P = np.eye(none.H.shape[2])
    assert none.H.shape == (0, 4 * VIEWS, RigErrors(course.rig, RIG, 15).dim + POSE_DIM * VIEWS)
    assert [len(part) for part in none.gated(P, 0.99)] == [0, 0]
    assert none.of_poses().dof == 0


def test_points_that_cannot_be_triangulated_fail_the_gate(course) -> None:
    tracks = seen_tracks(course)
    pixels = np.nan_to_num(tracks.pixels)
    far = course.rig.project(1e6 * course.rig.left.bearings(pixels[3, :, :2]))
    pixels[3, :, 2:] = 2 * far[:, 2:] - pixels[3, :, 2:]  # beyond infinity: the rays diverge
    assert not observed(course, Tracks(pixels, tracks.seen)).good[3]


@pytest.mark.parametrize("name", ["eif", "ekf", "ukf"])
def test_all_forms_of_the_filter_use_tracks_alike(course, name: str) -> None:
    """Past poses, an update by tracks, and a track that becomes a landmark: as in the information form."""
    outcomes = []
    for form in ("eif", name):
        f = course.filter(name=form, track_sigma_px=SIGMA_PX)
        for frame in range(VIEWS):
            if frame:
                f.predict(course.increments[frame - 1])
            f.keep_pose()
        tracks = seen_tracks(course, np.random.default_rng(4))
        tracks = dataclasses.replace(tracks, pixels=np.nan_to_num(tracks.pixels))
        passed = f.observe_tracks(tracks, probability=0.9999, become_landmarks=np.arange(len(tracks)) < 3)
        f.update(np.zeros(0, np.int64), np.zeros((0, 4)))
        assert passed.mean() > 0.9
        assert len(f.landmarks) == passed[:3].sum()
        outcomes.append(f)
    first, other = outcomes
    loose = 1e-5 if name == "ekf" else 2e-2  # cubature propagates the mean otherwise
    np.testing.assert_allclose(other.nav.T_map_body.t, first.nav.T_map_body.t, atol=loose)
    sigma = np.sqrt(np.diag(first.covariance()))
    error = (other.covariance() - first.covariance()) / np.outer(sigma, sigma)
    np.testing.assert_allclose(error, 0.0, atol=1e-4 if name == "ekf" else 5e-2)


def test_a_copy_with_tracks_leaves_the_filter_alone(course) -> None:
    f = course.filter(track_sigma_px=SIGMA_PX)
    f.keep_pose()
    f.predict(course.increments[0])
    f.keep_pose()
    whole = seen_tracks(course)
    tracks = Tracks(np.nan_to_num(whole.pixels[3:, :2]), whole.seen[3:, :2])
    before = (f.nav, f.landmarks.copy(), f.covariance(), f.past)
    other, passed, innovation = f.with_tracks(tracks, probability=0.99, become_landmarks=np.ones(len(tracks), bool))
    assert passed.all()
    assert innovation.dof > 0
    assert len(other.landmarks) == len(tracks)
    assert np.trace(other.nav_estimate().covariance[6:9, 6:9]) < np.trace(f.nav_estimate().covariance[6:9, 6:9])
    assert not f.has_tracks
    assert f.nav is before[0]
    assert f.past is before[3]
    np.testing.assert_array_equal(f.landmarks, before[1])
    np.testing.assert_array_equal(f.covariance(), before[2])


@pytest.mark.parametrize("name", ["eif", "ekf", "ukf"])
def test_without_its_landmarks_a_copy_with_tracks_knows_the_same_of_the_vehicle(course, name: str) -> None:
    f = course.filter(name=name, track_sigma_px=SIGMA_PX)
    f.keep_pose()
    f.add_landmarks(course.pixels(0, np.arange(10), np.random.default_rng(5)))
    f.predict(course.increments[0])
    f.keep_pose()
    whole = seen_tracks(course)
    tracks = Tracks(np.nan_to_num(whole.pixels[3:, :2]), whole.seen[3:, :2])
    none = np.zeros(len(tracks), bool)
    (one, passed, innovation), (other, others_passed, others_innovation) = (
        some.with_tracks(tracks, probability=0.99, become_landmarks=none) for some in (f, f.without_landmarks())
    )
    assert len(f.landmarks) == 10
    assert len(other.landmarks) == 0
    np.testing.assert_array_equal(others_passed, passed)
    assert others_innovation.nis == pytest.approx(innovation.nis, rel=1e-6)
    for mine, others in ((one.nav_estimate(), other.nav_estimate()), (one.past_estimate(0), other.past_estimate(0))):
        sigma = np.sqrt(np.diag(mine.covariance))
        np.testing.assert_allclose((others.covariance - mine.covariance) / np.outer(sigma, sigma), 0.0, atol=1e-6)
    np.testing.assert_allclose(other.nav.T_map_body.t, one.nav.T_map_body.t, atol=1e-9)
    np.testing.assert_allclose(other.nav.v_map, one.nav.v_map, atol=1e-9)


def flown_at_wrong_velocity(
    course, error: Array, name: str = "eif", *, share: float = 1.0, tilt_rad: float | None = None
) -> tuple[Filter, Tracks]:
    """Return a filter over two frames with a share of that velocity's error [m/s], and their tracks.

    It has twice the variance of the whole error, and that of the tilt.
    """
    state, P = course.initial.state, course.initial.covariance.copy()
    P[3:6, 3:6] = 2.0 * np.mean(error**2) * np.eye(3)
    if tilt_rad is not None:
        P[6:8, 6:8] = tilt_rad**2 * np.eye(2)
    start = NavEstimate(dataclasses.replace(state, v_map=state.v_map - share * error), P)
    f = FILTERS[name](start, rig=course.rig, imu=course.imu, track_sigma_px=SIGMA_PX)
    f.keep_pose()
    f.predict(course.increments[0])
    f.keep_pose()
    whole = seen_tracks(course)
    return f, Tracks(np.nan_to_num(whole.pixels[3:, :2]), whole.seen[3:, :2])


@pytest.mark.parametrize("error", [(10.0, -6.0, 4.0), (-40.0, 24.0, 16.0)], ids=["near", "far"])
@pytest.mark.parametrize("name", ["eif", "ekf", "ukf"])
def test_tracks_that_move_the_estimate_far_are_linearised_where_they_lead(course, name: str, error) -> None:
    """The prediction is 1.7 and 6.8 m off; from there a whole step would leave the tracks with larger residuals."""
    f, tracks = flown_at_wrong_velocity(course, np.array(error), name)
    other, passed, innovation = f.with_tracks(tracks, probability=0.99, become_landmarks=np.ones(len(tracks), bool))
    assert passed.all()
    assert innovation.nis < innovation.dof  # the tracks have no noise
    first, last = (course.true_state(frame).T_map_body for frame in range(2))
    moved = other.past.pose(0).inverse() @ other.past.pose(1)
    truly = first.inverse() @ last
    assert np.linalg.norm(moved.t - truly.t) < 0.01
    seen_from = other.nav.T_map_body.inverse().apply(other.landmarks)
    np.testing.assert_allclose(seen_from, last.inverse().apply(course.landmarks[3:]), atol=0.1)  # 1 sigma: 0.4 m


@pytest.mark.parametrize("name", ["eif", "ekf", "ukf"])
def test_their_points_turn_with_the_vehicle_as_those_of_tracks_that_move_nothing(course, name: str) -> None:
    """A landmark that turned by another arm would tell the tilt: here 33 m of 76 if its errors were not transported."""
    turning: list[Array] = []
    for share in (1.0, 0.0):
        f, tracks = flown_at_wrong_velocity(course, np.array([10.0, -6.0, 4.0]), name, share=share, tilt_rad=0.05)
        other, _, _ = f.with_tracks(tracks, probability=0.99, become_landmarks=np.ones(len(tracks), bool))
        P, m = other.covariance(), other.vehicle
        turning.append(P[m:, 6:8] / np.diagonal(P)[6:8])
    np.testing.assert_allclose(turning[0], turning[1], atol=0.5)
    assert np.abs(turning[1]).max() > 70.0


@pytest.mark.parametrize(("wrong", "refused"), [(2, 2), (6, 9)])
def test_tracks_that_do_not_fit_where_they_lead_are_refused_and_all_if_most_do_not(course, wrong, refused) -> None:
    """About the wrong prediction the gate is so wide that a slip by 30 sigma in the image is none."""
    f, tracks = flown_at_wrong_velocity(course, np.array([10.0, -6.0, 4.0]))
    slips = np.random.default_rng(4).normal(0.0, 30.0 * SIGMA_PX, (wrong, 2))
    tracks.pixels[:wrong, 1] += np.hstack([slips, slips])
    about_prediction = f._linearised_tracks(tracks, f.mean)
    P = submatrix(f.belief.covariance(NO_ROWS), about_prediction.rows)
    assert about_prediction.seen.gated(P, 0.99)[0].all()
    other, passed, _ = f.with_tracks(tracks, probability=0.99, become_landmarks=np.zeros(len(tracks), bool))
    np.testing.assert_array_equal(passed, np.arange(len(tracks)) >= refused)
    if passed.any():
        moved = other.past.pose(0).inverse() @ other.past.pose(1)
        truly = course.true_state(0).T_map_body.inverse() @ course.true_state(1).T_map_body
        assert np.linalg.norm(moved.t - truly.t) < 0.01
    else:
        np.testing.assert_array_equal(other.nav.T_map_body.t, f.nav.T_map_body.t)


@pytest.mark.parametrize("name", ["eif", "ekf", "ukf"])
def test_points_that_become_landmarks_in_an_update_say_what_they_say_as_landmarks_from_the_start(course, name) -> None:
    """As long as a depth is known well enough to be linearised: both views of eight points, four other landmarks."""
    few, rng = np.arange(8), np.random.default_rng(8)
    views = np.stack([course.pixels(0, few), course.pixels(1, few)], axis=1) + rng.normal(0.0, 0.01, (8, 2, 4))
    others = [course.pixels(frame, np.arange(8, 12)) + rng.normal(0.0, 0.01, (4, 4)) for frame in (0, 1)]
    outcomes = []
    for again in (False, True):
        f = course.filter(name=name, sigma_px=0.01)
        f.keep_pose()
        f.add_landmarks(others[0] if again else np.vstack([others[0], views[:, 0]]))
        f.predict(course.increments[0])
        f.keep_pose()
        rows = np.arange(4)
        if again:
            points = Tracks(views, np.ones((8, 2), bool), detected=True)
            passed = f.update_with_points(
                points, rows, others[1], at=f.mean, weights=np.ones(4), probability=1.0 - 1e-9
            )
            assert passed.all()
        else:
            f.update(
                np.arange(12),
                np.vstack([others[1], views[:, 1]]),
            )
        outcomes.append(f)
    first, other = outcomes
    sigma = np.sqrt(np.diag(first.covariance()))
    np.testing.assert_allclose(other.nav.T_map_body.t, first.nav.T_map_body.t, atol=0.1 * sigma[:3].min())
    np.testing.assert_allclose(other.landmarks, first.landmarks, atol=0.2 * sigma[-24:].min())
    error = (other.covariance() - first.covariance()) / np.outer(sigma, sigma)
    np.testing.assert_allclose(error, 0.0, atol=0.02)


def test_points_whose_views_do_not_fit_are_not_used(course) -> None:
    views = np.stack([course.pixels(frame, np.arange(10)) for frame in (0, 1)], axis=1)
    views[3, 1] += [30.0, 30.0, -30.0, 30.0]
    f = course.filter()
    f.keep_pose()
    f.predict(course.increments[0])
    f.keep_pose()
    points = Tracks(views, np.ones((10, 2), bool), detected=True)
    passed = f.update_with_points(points, NO_ROWS, np.zeros((0, 4)), at=f.mean, weights=np.ones(0), probability=0.9999)
    np.testing.assert_array_equal(passed, np.arange(10) != 3)
    assert len(f.landmarks) == 9


def test_tracks_that_fit_the_prediction_are_linearised_there(course) -> None:
    f, tracks = flown_at_wrong_velocity(course, np.array([0.05, -0.05, 0.05]))
    used, first = np.ones(len(tracks), bool), f._linearised_tracks(tracks, f.mean)
    P = f.belief.covariance(NO_ROWS)
    linearised, _ = relinearised(first, used, P, lambda delta: f._linearised_tracks_at(tracks, delta))
    assert linearised is first
