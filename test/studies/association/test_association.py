# SPDX-License-Identifier: Apache-2.0
"""Associations are scored by what the features truly show, and the matchers by their keypoints."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.association import ASSOCIATORS
from uav_vslam.config import FrontendConfig, VehicleConfig
from uav_vslam.simulation.scenario import SCENARIOS, simulate_vehicle
from uav_vslam.studies.association.compute import Found, Job, TruePoints, associate_all, fly, map_rows, score_pairs
from uav_vslam.studies.association.image_matching import image_rows, kept_frames, score_matchers
from uav_vslam.studies.engine.association_stages import Score
from uav_vslam.studies.engine.extracted_flights import ExtractedFlight, recorded_flight, rendered_flight, shown_at
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.engine.own_only import INS
from uav_vslam.studies.engine.recorded_flights import RecordedFlight
from uav_vslam.vision.matching import MATCHERS

FRAMES = 7
CONFIG = VehicleConfig(frontend=FrontendConfig(scale=1.0, max_features=500))


@pytest.fixture(scope="module")
def flight() -> ExtractedFlight:
    scenario = dataclasses.replace(SCENARIOS["sample"], frames=FRAMES, vehicles=1)
    return rendered_flight("sample", scenario, CONFIG, keep=kept_frames(FRAMES))


def in_frame(flight: ExtractedFlight, frame: int, pairs: np.ndarray) -> Found:
    """Return pairs of landmarks that are the features of frame 0."""
    rows = np.arange(len(flight.points[0]))
    return Found(rows, flight.steps[frame][0], pairs, 0.0)


def test_a_feature_shows_the_point_that_projects_onto_it(flight: ExtractedFlight) -> None:
    for frame in (0, FRAMES - 1):
        shown = shown_at(flight.T_world_left[frame], flight.rig.left, flight.points[frame])
        np.testing.assert_allclose(shown, flight.steps[frame][0].pixels[:, :2], atol=0.01)


def test_a_landmarks_own_feature_is_right_and_any_other_is_wrong(flight: ExtractedFlight) -> None:
    count = len(flight.points[0])
    same = np.column_stack([np.arange(count), np.arange(count)])
    score = score_pairs(in_frame(flight, 0, same), flight.points[0], flight.T_world_left[0], flight)
    assert score == Score(count, count, count, count)
    other = np.column_stack([np.arange(count), np.roll(np.arange(count), 1)])
    assert (
        score_pairs(in_frame(flight, 0, other), flight.points[0], flight.T_world_left[0], flight).right < 0.05 * count
    )


def test_landmarks_of_unknown_origin_count_neither_way(flight: ExtractedFlight) -> None:
    points = flight.points[0].copy()
    points[:10] = np.nan
    same = np.column_stack([np.arange(len(points)), np.arange(len(points))])
    score = score_pairs(in_frame(flight, 0, same), points, flight.T_world_left[0], flight)
    assert score.left == score.findable == len(points) - 10


def test_what_is_behind_the_camera_is_not_shown(flight: ExtractedFlight) -> None:
    T = flight.T_world_left[0]
    assert np.isnan(shown_at(T, flight.rig.left, T.apply(np.array([[0.0, 0.0, -5.0]])))).all()


def test_a_landmark_shows_for_ever_what_it_began_as(flight: ExtractedFlight) -> None:
    truth = TruePoints(flight)
    T_map_body = flight.T_world_left[0] @ flight.rig.T_body_left.inverse()
    ids = np.array([4, 9], np.uint32)
    truth.note(0, ids, flight.points[0][[3, 7]], T_map_body)
    np.testing.assert_array_equal(truth.of(ids), flight.points[0][[3, 7]])
    truth.note(1, ids, flight.points[0][[5, 6]], T_map_body)
    np.testing.assert_array_equal(truth.of(ids[::-1]), flight.points[0][[7, 3]])
    nowhere = flight.points[0][:1] + np.array([2.0, 0.0, 0.0])
    truth.note(1, np.array([11], np.uint32), nowhere, flight.T_world_left[1] @ flight.rig.T_body_left.inverse())
    assert np.isnan(truth.of(np.array([11, 12], np.uint32))).all()


def test_a_recording_is_scored_by_its_true_poses_and_its_stereo_points(flight: ExtractedFlight) -> None:
    """The same flight as a recording, whose first frame is older than its start."""
    vehicle = simulate_vehicle(dataclasses.replace(SCENARIOS["sample"], frames=FRAMES, vehicles=1), 0)
    features = [seen for seen, _ in flight.steps]
    early = dataclasses.replace(features[0], stamp_ns=features[0].stamp_ns - 50_000_000)
    events = sorted([*vehicle.imu.samples(), early, *features], key=lambda event: event.stamp_ns)
    recording = RecordedFlight(
        "uav1", flight.rig, vehicle.initial, tuple(events), true_trajectory(vehicle), np.zeros((FRAMES, 3))
    )
    found = recorded_flight("recorded", recording, dataclasses.replace(CONFIG, imu=vehicle.scenario.imu_config))
    assert len(found.steps) == len(found.truth) == FRAMES
    for T, other in zip(found.T_world_left, flight.T_world_left, strict=True):
        np.testing.assert_allclose(T.t, other.t, atol=1e-6)
    shown = shown_at(found.T_world_left[0], found.rig.left, found.points[0])
    np.testing.assert_allclose(shown, features[0].pixels[:, :2], atol=1.0)  # four pixels that three numbers explain
    np.testing.assert_allclose(found.ins.positions, flight.ins.positions, atol=1e-6)
    score = fly(found, "gated").score
    assert score.right > 0.9 * score.left > 0


@pytest.mark.parametrize("name", ["gated", "nn", "hgtm"])
def test_on_clear_images_most_of_what_is_found_is_right(flight: ExtractedFlight, name: str) -> None:
    found = fly(flight, name)
    assert found.score.right > 0.95 * found.score.left
    assert found.score.left > 20 * (FRAMES - 1)
    assert len(found.ms) == FRAMES - 1
    assert not found.run.track.failure


def test_a_row_tells_precision_and_recall_of_each_associator_and_errors_of_the_ins(flight: ExtractedFlight) -> None:
    rows = map_rows(associate_all(flight, ["gated"]))
    assert [row["method"] for row in rows] == [INS, "gated"]
    assert rows[0]["precision"] is None
    assert 0.9 < rows[1]["precision"] <= 1.0
    assert rows[1]["runs"] == 1
    assert set(ASSOCIATORS) >= set(Job("clear", 1, 5, ("gated",)).names)


def test_every_matcher_is_scored_on_pairs_and_in_time(flight: ExtractedFlight) -> None:
    rows = image_rows(score_matchers(flight, ratio=0.8))
    assert {(row["condition"], row["method"]) for row in rows} == {
        (f"{flight.condition}, {kind}", name) for kind in ("left and right", "in time") for name in MATCHERS
    }
    by_name = {row["method"]: row for row in rows if row["condition"].endswith("left and right")}
    assert by_name["nn_mutual"]["precision"] > 0.9
    assert by_name["gtm"]["precision"] >= by_name["nn_mutual"]["precision"]
    assert by_name["cds_nn"]["matches"] < 0.5 * by_name["nn_mutual"]["matches"]


def test_kept_frames_are_those_that_are_judged() -> None:
    assert kept_frames(26) == {0, 5, 10, 15, 20, 25}
    assert kept_frames(5) == set()
