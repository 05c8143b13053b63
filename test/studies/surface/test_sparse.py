# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.mapping.raster import Raster
from uav_vslam.simulation.camera_render import CameraRenderer
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.simulation.terrain import ground_of
from uav_vslam.studies.surface.sparse import DelaunaySurface, extra_points, landmarks
from uav_vslam.types import StereoFeatures

RIG = kagaru_rig(0.375)
GROUND = ground_of(Scenario(relief_m=2.0))
POSES = {k: Pose(so3_exp([0.02 * k, 0.0, 0.1]), np.array([3.0 * k, 0.0, 70.0])) for k in range(6)}


def seen(points: np.ndarray, ids: np.ndarray, noise_px: float = 0.0) -> list[StereoFeatures]:
    rng, found = np.random.default_rng(1), []
    for stamp, T_map_body in POSES.items():
        pixels = RIG.project((T_map_body @ RIG.T_body_left).inverse().apply(points))
        pixels = pixels + rng.normal(0.0, noise_px, pixels.shape)
        found.append(StereoFeatures(stamp, pixels.astype(np.float32), np.zeros((len(ids), 0), np.uint8), ids))
    return found


def ground_points(count: int = 60) -> np.ndarray:
    x, y = np.random.default_rng(2).uniform([-10.0, -20.0], [25.0, 20.0], (count, 2)).T
    return np.column_stack([x, y, GROUND.relief.height(x, y)])


def test_rays_of_a_track_meet_in_its_landmark() -> None:
    points = ground_points()
    found = landmarks(seen(points, np.arange(1, 61, dtype=np.uint32)), POSES, RIG)
    assert found == pytest.approx(points, abs=2e-3)


def test_a_track_that_jumps_or_is_seen_rarely_or_has_no_id_is_no_landmark() -> None:
    points = ground_points(3)
    frames = seen(points, np.array([1, 2, 0], np.uint32))
    frames[3].pixels[0] += 20.0
    assert landmarks(frames, POSES, RIG) == pytest.approx(points[1:2], abs=2e-3)
    assert len(landmarks(frames[:2], POSES, RIG)) == 0
    assert landmarks(frames, {}, RIG).shape == (0, 3)


def test_lattice_points_of_a_rendered_pair_lie_on_the_ground() -> None:
    points = ground_points()
    features = seen(points, np.arange(1, 61, dtype=np.uint32))[0]
    images = [
        np.clip(CameraRenderer(camera, GROUND, supersample=2).render(POSES[0] @ T_body_cam), 0, 255).astype(np.uint8)
        for camera, T_body_cam in ((RIG.left, RIG.T_body_left), (RIG.right, RIG.T_body_right))
    ]
    found = extra_points(images[0], images[1], features, POSES[0], RIG)
    error = found[:, 2] - GROUND.relief.height(found[:, 0], found[:, 1])
    assert len(found) > 100
    assert np.median(np.abs(error)) < 1.5  # the baseline is 0.78 m, 70 m above: a pixel is 10 m
    assert len(extra_points(images[0], images[1], features.chosen(np.arange(4)), POSES[0], RIG)) == 0


def test_a_triangulation_is_exact_on_a_plane_and_unknown_outside() -> None:
    x, y = np.random.default_rng(3).uniform(0.0, 20.0, (2, 80))
    surface = DelaunaySurface(np.column_stack([x, y, 1.0 + 0.1 * x - 0.2 * y]))
    inner, outer = Raster(0.5, 12, 12, 16, 16), Raster(0.5, -20, 0, 5, 5)
    assert surface.height(inner) == pytest.approx(1.0 + 0.1 * inner.x - 0.2 * inner.y[:, None], abs=1e-5)
    assert np.isnan(surface.height(outer)).all()
    assert np.isnan(DelaunaySurface(np.zeros((0, 3))).height(inner)).all()
