# SPDX-License-Identifier: Apache-2.0
"""The views get the tracks and landmarks that the folder holds."""

from pathlib import Path

import numpy as np
import pytest
from made_up_results import COVARIANCE, FRAMES, LANDMARKS, VEHICLES, write_bare, write_full

from uav_vslam.report.page.flight import read_flight
from uav_vslam.report.page.scene import scene_data


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> dict:
    folder = write_full(tmp_path_factory.mktemp("full"))
    return scene_data([read_flight(folder, "full")])["flights"][0]


def test_tracks_are_those_of_the_flight_with_time_from_its_start(scene: dict) -> None:
    for shown, vehicle in zip(scene["vehicles"], VEHICLES.values(), strict=True):
        track = shown["tracks"]["c_slam"]
        found = np.stack([track["x"], track["y"], track["z"]], axis=1)
        np.testing.assert_allclose(found, vehicle.c_slam.positions, atol=6e-4)
        np.testing.assert_allclose(track["t"], 0.1 * np.arange(FRAMES), atol=6e-4)
        np.testing.assert_allclose(track["sigma_m"], 0.5 * np.sqrt(3), atol=1e-3)
        np.testing.assert_allclose(np.reshape(track["cov_plane"], (-1, 3)), np.tile([0.25, 0.0, 0.25], (FRAMES, 1)))


@pytest.mark.parametrize(("methods", "x"), [(["given"], "East"), (["in_flight"], "x"), (["given", "static"], "x")])
def test_a_map_that_begins_where_the_vehicle_headed_has_no_north(methods: list[str], x: str, tmp_path: Path) -> None:
    flights = []
    for method in methods:
        folder = write_bare(tmp_path / method)
        (folder / "config.yaml").write_text(f"/**: {{ros__parameters: {{start: {{method: {method}}}}}}}")
        flights.append(read_flight(folder, method))
    assert scene_data(flights)["axes"][0] == x


def test_ellipsoids_have_the_covariance_of_the_landmarks(scene: dict) -> None:
    landmarks = scene["vehicles"][0]["landmarks"]
    assert landmarks["count"] == len(landmarks["x"]) == LANDMARKS
    lower = np.zeros((LANDMARKS, 3, 3))
    lower[:, [0, 1, 2, 1, 2, 2], [0, 0, 0, 1, 1, 2]] = np.reshape(landmarks["lower"], (-1, 6))
    np.testing.assert_allclose(lower @ lower.transpose(0, 2, 1), np.tile(COVARIANCE, (LANDMARKS, 1, 1)), atol=1e-3)


def test_landmarks_with_a_cell_that_is_no_number_are_left_out(tmp_path: Path) -> None:
    folder = write_full(tmp_path)
    path = folder / "uav1_landmarks.csv"
    head, first, second, *rows = path.read_text().splitlines()
    bad = [first.replace(first.split(",")[1], "nan", 1), second.rsplit(",", 1)[0] + ","]
    path.write_text("\n".join([head, *bad, *rows]) + "\n")
    landmarks = scene_data([read_flight(folder, "full")])["flights"][0]["vehicles"][0]["landmarks"]
    assert landmarks["count"] == len(landmarks["x"]) == LANDMARKS - 2
    path.write_text("\n".join([head, *bad]) + "\n")
    assert scene_data([read_flight(folder, "full")])["flights"][0]["vehicles"][0]["landmarks"] is None


def test_without_a_map_there_are_no_landmarks(tmp_path: Path) -> None:
    bare = scene_data([read_flight(write_bare(tmp_path), "bare")])["flights"][0]["vehicles"][0]
    assert bare["landmarks"] is None
    assert set(bare["tracks"]) == {"ins", "s_slam"}
