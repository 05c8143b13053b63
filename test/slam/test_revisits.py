# SPDX-License-Identifier: Apache-2.0
"""Loop closure: a jointly compatible group closes the loop, a look-alike does not."""

import dataclasses
import functools
import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.special import chdtri

from uav_vslam.association.consensus import consensus
from uav_vslam.config import BackendConfig, VehicleConfig
from uav_vslam.estimation.filter import Filter
from uav_vslam.simulation.flight_path import PATTERNS, racetrack_pattern
from uav_vslam.simulation.landmarks import LandmarkField, observe, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.landmark_map import LandmarkMap
from uav_vslam.slam.revisits import MIN_GROUP, expected_by_chance, recognise
from uav_vslam.studies.engine.own_only import dead_reckon
from uav_vslam.types import ImuIncrement, StereoFeatures

ANY = 1e9  # chance_revisits: all groups are used
HOME_M = 120.0  # radius around the start of all ground seen on return, and of none seen half way


@pytest.fixture(scope="module")
def vehicle() -> Iterator[SimulatedVehicle]:
    """A vehicle that returns over its start after 0.67 km and flies on briefly."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PATTERNS, "small", functools.partial(racetrack_pattern, leg_m=60.0))
        yield simulate_vehicle(Scenario(seed=4, vehicles=1, frames=114, frame_rate_hz=3.0, pattern="small"), 0)


@pytest.fixture(scope="module")
def increments(vehicle: SimulatedVehicle) -> list[ImuIncrement | None]:
    stamps = [int(stamp_ns) for stamp_ns in vehicle.frame_stamps_ns]
    return dead_reckon(vehicle.initial, vehicle.scenario.imu_config, vehicle.imu.samples(), stamps)[0]


def observed(vehicle: SimulatedVehicle, field: LandmarkField) -> list[StereoFeatures]:
    return [features for features, _ in observe(vehicle, field)]


def fly(
    vehicle: SimulatedVehicle, increments: list[ImuIncrement | None], frames: list[StereoFeatures], **options
) -> list[FrameReport]:
    config = VehicleConfig(imu=vehicle.scenario.imu_config, backend=BackendConfig(**options))
    backend = SlamBackend(vehicle.initial, rig=vehicle.rig, config=config, vehicle="uav1")
    return [backend.process(features, moved) for features, moved in zip(frames, increments, strict=True)]


def end_error_m(vehicle: SimulatedVehicle, reports: list[FrameReport]) -> float:
    pose = reports[-1].pose
    return float(np.linalg.norm(pose.T_map_body.t - vehicle.true_state(pose.stamp_ns).T_map_body.t))


@pytest.mark.slow
def test_a_loop_closes_over_retained_landmarks(vehicle, increments) -> None:
    frames = observed(vehicle, scatter_landmarks([vehicle], twin_share=0.2))
    kept = fly(vehicle, increments, frames)
    without = fly(vehicle, increments, frames, retention="none")
    late = len(frames) - 25
    assert sum(report.closures for report in kept[late:]) >= MIN_GROUP
    assert sum(report.closures for report in without) == 0
    assert end_error_m(vehicle, kept) < 0.5 * end_error_m(vehicle, without)


@pytest.mark.slow
def test_a_redetection_offset_is_down_weighted(vehicle, increments) -> None:
    """Each feature of the second visit is 1.4 px off the first visit's track, in both images alike."""
    frames = observed(vehicle, scatter_landmarks([vehicle]))
    late = len(frames) - 25
    rng = np.random.default_rng(4)
    for k, frame in enumerate(frames):
        shift = rng.normal(0.0, 1.0 if k >= late else 0.0, (len(frame), 2)).astype(np.float32)
        frames[k] = dataclasses.replace(frame, pixels=frame.pixels + np.tile(shift, 2))
    trusting, cautious = (fly(vehicle, increments, frames, sigma_px=1.0, redetection_px=px) for px in (0.0, 1.0))
    assert sum(report.closures for report in cautious[late:]) >= MIN_GROUP
    first = next(k for k, report in enumerate(trusting) if report.closures)
    size = [np.trace(reports[first + 2].pose.covariance[:3, :3]) for reports in (trusting, cautious)]
    assert size[1] > 1.2 * size[0]


@pytest.mark.slow
def test_look_alike_ground_at_the_place_closes_no_loop(vehicle, increments) -> None:
    """Two of a few agree, as they may by chance in the gates that half a metre of uncertainty leaves."""
    field = scatter_landmarks([vehicle])
    rng = np.random.default_rng(3)
    home = np.linalg.norm(field.points_world[:, :2], axis=1) < HOME_M
    angle, distance = rng.uniform(0.0, 2.0 * np.pi, home.sum()), rng.uniform(0.4, 1.4, home.sum())
    moved = field.points_world.copy()
    moved[home, :2] += distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    away = len(vehicle.frame_stamps_ns) // 2
    before, after = (observed(vehicle, dataclasses.replace(field, points_world=p)) for p in (field.points_world, moved))
    frames = before[:away] + after[away:]
    assert sum(report.closures for report in fly(vehicle, increments, frames)) == 0
    assert sum(report.closures for report in fly(vehicle, increments, frames, chance_revisits=ANY)) > 0


@dataclasses.dataclass(frozen=True)
class Meeting:
    """Landmarks revisited by a vehicle of uncertain speed; names are true identities."""

    slam_filter: Filter
    landmark_map: LandmarkMap
    names: np.ndarray
    features: StereoFeatures
    feature_names: np.ndarray

    def recognise(self, rows: np.ndarray, features: StereoFeatures | None = None, **options) -> np.ndarray:
        config = BackendConfig(**{"redetection_px": 0.0} | options)  # they are seen exactly where they were
        return recognise(
            self.slam_filter, self.landmark_map, self.features if features is None else features, rows, config=config
        )

    @property
    def seen_again(self) -> np.ndarray:
        return np.flatnonzero(np.isin(self.names, self.feature_names))


@pytest.fixture(scope="module")
def meeting(vehicle, increments) -> Meeting:
    (first, names), (second, feature_names) = itertools.islice(observe(vehicle, scatter_landmarks([vehicle])), 2)
    sigma = np.sqrt(np.diag(vehicle.initial.covariance))
    start = dataclasses.replace(vehicle.initial, covariance=np.diag(np.r_[sigma[:3], 3.0, 3.0, 3.0, sigma[6:]] ** 2))
    slam_filter = Filter(start, rig=vehicle.rig, imu=vehicle.scenario.imu_config)
    slam_filter.add_landmarks(first.pixels.astype(float))
    slam_filter.predict(increments[1])
    landmark_map = LandmarkMap()
    landmark_map.append(first.descriptors, 0, first.tracks)
    return Meeting(slam_filter, landmark_map, names, second, feature_names)


def test_a_group_is_recognised_in_wide_gates(meeting: Meeting) -> None:
    pairs = meeting.recognise(meeting.seen_again)
    assert len(pairs) > 0.8 * len(meeting.seen_again)
    np.testing.assert_array_equal(meeting.names[pairs[:, 0]], meeting.feature_names[pairs[:, 1]])


def test_a_match_that_is_incompatible_with_the_group_is_left_out(meeting: Meeting) -> None:
    pairs = meeting.recognise(meeting.seen_again)
    row, feature = pairs[0]
    pixels = meeting.features.pixels.copy()
    pixels[feature] += 25.0
    nu, S = meeting.slam_filter.joint_innovation(pairs[:1, 0], pixels[[feature]].astype(float))
    assert nu[0] @ np.linalg.solve(S, nu[0]) < chdtri(4, 0.01)  # within its own gate
    elsewhere = dataclasses.replace(meeting.features, pixels=pixels)
    assert row not in meeting.recognise(meeting.seen_again, elsewhere)[:, 0]


def test_a_group_agrees_within_the_redetection_offsets(meeting: Meeting) -> None:
    """Each feature is off the track's first one by 4 px, in both images alike."""
    shift = np.random.default_rng(5).normal(0.0, 4.0, (len(meeting.features), 2))
    pixels = (meeting.features.pixels + np.tile(shift, 2)).astype(np.float32)
    off = dataclasses.replace(meeting.features, pixels=pixels)
    strict, tolerant = (meeting.recognise(meeting.seen_again, off, redetection_px=px) for px in (0.0, 4.0))
    assert len(tolerant) > 0.8 * len(meeting.seen_again)
    assert len(strict) < len(tolerant)


def test_a_match_alone_is_no_group(meeting: Meeting) -> None:
    two = meeting.recognise(meeting.seen_again)[:2]
    assert meeting.recognise(two[:, 0], chance_revisits=ANY).tolist() == two.tolist()
    assert meeting.recognise(two[:1, 0], chance_revisits=ANY).shape == (0, 2)


def test_a_group_that_chance_explains_is_not_used(meeting: Meeting) -> None:
    two = meeting.recognise(meeting.seen_again)[:2]
    _, S = meeting.slam_filter.joint_innovation(two[:, 0], meeting.features.pixels[two[:, 1]].astype(float))
    chance = expected_by_chance(S, np.arange(2))
    assert 0.0 < chance < 0.1
    assert len(meeting.recognise(two[:, 0], chance_revisits=1.01 * chance)) == 2
    assert len(meeting.recognise(two[:, 0], chance_revisits=0.99 * chance)) == 0


@pytest.mark.parametrize(("common_px", "size"), [(5.0, 3), (8.0, 2), (12.0, 2)])
def test_wrong_matches_form_fewer_groups_than_expected_but_not_far_fewer(common_px: float, size: int) -> None:
    """Each match is as far off as its own gate allows, in any direction; all gates share the drift."""
    tried, draws, limit = 3, 4000, chdtri(4, 0.01)
    S = np.kron(np.ones((tried, tried)), common_px**2 * np.eye(4)) + 16.0 * np.eye(4 * tried)
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(draws, tried, 4))
    radius = np.sqrt(limit * (common_px**2 + 16.0)) * rng.uniform(size=(draws, tried, 1)) ** 0.25
    matches = radius * direction / np.linalg.norm(direction, axis=2, keepdims=True)
    formed = sum(len(consensus(nu, S, probability=0.99)) >= size for nu in matches)
    expected = draws * expected_by_chance(S, np.arange(size))
    assert 0.1 * expected < formed < 0.5 * expected


def test_without_landmarks_or_features_nothing_is_recognised(meeting: Meeting) -> None:
    dark = StereoFeatures.empty(meeting.features.stamp_ns)
    assert meeting.recognise(meeting.seen_again, dark).shape == (0, 2)
    assert meeting.recognise(meeting.seen_again[:0], chance_revisits=ANY).shape == (0, 2)
