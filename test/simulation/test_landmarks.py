# SPDX-License-Identifier: Apache-2.0
"""Image-free features are true projections with noise, and can be matched as real ones."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.errors import ConfigError
from uav_vslam.simulation.landmarks import TWIN_M, LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_fleet

FLEET = simulate_fleet(SCENARIOS["kagaru"])
FIELD = scatter_landmarks(FLEET)


def expected_pixels(vehicle: SimulatedVehicle, frame: int, ids: np.ndarray) -> np.ndarray:
    T_body_world = vehicle.truth.pose(float(vehicle.frame_times_s[frame])).inverse()
    rig = vehicle.true_rig(frame)
    return rig.project(rig.T_body_left.inverse().apply(T_body_world.apply(FIELD.points_world[ids])))


def test_measurements_are_the_true_projections_with_the_stated_noise() -> None:
    residuals = []
    for frame, (features, ids) in enumerate(observe(FLEET[0], FIELD, noise=LandmarkNoise(sigma_px=0.7))):
        residuals.append(features.pixels - expected_pixels(FLEET[0], frame, ids))
    all_residuals = np.concatenate(residuals)
    assert np.std(all_residuals) == pytest.approx(0.7, rel=0.03)
    assert np.abs(all_residuals.mean(axis=0)).max() < 0.05


def test_so_low_that_the_cameras_have_no_view_in_common_there_is_nothing_to_scatter() -> None:
    fleet = simulate_fleet(dataclasses.replace(SCENARIOS["kagaru"], frames=2, altitude=1.0))
    with pytest.raises(ConfigError, match="no ground is in view of both cameras from 1 m"):
        scatter_landmarks(fleet)


def test_about_44_landmarks_are_seen_a_frame() -> None:
    counts = [len(features) for vehicle in FLEET for features, _ in observe(vehicle, FIELD)]
    assert np.mean(counts) == pytest.approx(44.0, abs=4.0)


def test_the_same_seed_gives_the_same_bytes() -> None:
    again = scatter_landmarks(simulate_fleet(SCENARIOS["kagaru"]))
    first, second = next(observe(FLEET[0], FIELD))[0], next(observe(FLEET[0], again))[0]
    assert first.pixels.tobytes() == second.pixels.tobytes()
    assert first.descriptors.tobytes() == second.descriptors.tobytes()


def test_the_ratio_test_matches_views_of_two_vehicles() -> None:
    a, ids_a = list(observe(FLEET[0], FIELD))[80]
    b, ids_b = list(observe(FLEET[1], FIELD))[80]
    distance = np.linalg.norm(a.descriptors[:, None].astype(float) - b.descriptors[None].astype(float), axis=2)
    order = np.sort(distance, axis=1)
    accepted = order[:, 0] < 0.8 * order[:, 1]
    matched = ids_b[np.argmin(distance, axis=1)] == ids_a
    assert np.all(matched[accepted])
    assert accepted.sum() == len(np.intersect1d(ids_a, ids_b)) > 10


def test_twins_share_a_descriptor_and_are_a_few_metres_apart() -> None:
    field = scatter_landmarks(FLEET, twin_share=0.2)
    _, first, counts = np.unique(field.descriptors, axis=0, return_index=True, return_counts=True)
    assert counts.max() == 2
    twins = first[counts == 2]
    assert 2 * len(twins) == pytest.approx(0.2 * len(field.points_world), abs=2)
    for row in twins[:20]:
        pair = np.flatnonzero((field.descriptors == field.descriptors[row]).all(axis=1))
        apart = np.linalg.norm(np.diff(field.points_world[pair, :2], axis=0))
        assert TWIN_M[0] <= apart <= TWIN_M[1]


def test_missed_landmarks_are_drawn_independently_per_frame() -> None:
    full, some = (list(observe(FLEET[0], FIELD, noise=LandmarkNoise(missed_share=share))) for share in (0.0, 0.3))
    assert all(set(ids) <= set(all_ids) for (_, all_ids), (_, ids) in zip(full, some, strict=True))
    assert np.mean([len(f) for f, _ in some]) == pytest.approx(0.7 * np.mean([len(f) for f, _ in full]), rel=0.05)
    missed = [set(all_ids) - set(ids) for (_, all_ids), (_, ids) in zip(full, some, strict=True)]
    assert missed[0] & set(some[1][1])  # missed in one frame, detected in the next
    for frame in (0, 5):
        features, ids = some[frame]
        assert np.abs(features.pixels - expected_pixels(FLEET[0], frame, ids)).max() < 6.0


def test_wrong_matches_are_marked_and_as_many_as_asked() -> None:
    noise = LandmarkNoise(wrong_share=0.2)
    shares = [np.mean(ids == -1) for _, ids in observe(FLEET[0], FIELD, noise=noise)]
    assert np.mean(shares) == pytest.approx(0.2, abs=0.02)


def test_a_wrong_match_is_seen_where_another_landmark_is() -> None:
    noise = LandmarkNoise(sigma_px=0.1, wrong_share=0.2)
    features, ids = next(observe(FLEET[0], FIELD, noise=noise))
    wrong = features.descriptors[ids == -1].astype(float)
    owner = np.array([np.argmin(np.linalg.norm(FIELD.descriptors - row, axis=1)) for row in wrong])
    offset = features.pixels[ids == -1] - expected_pixels(FLEET[0], 0, owner)
    assert len(wrong) > 3
    assert np.linalg.norm(offset[:, :2], axis=1).min() > 5.0
    assert FLEET[0].rig.epipolar_distance(features.pixels).max() < 1.0  # the stereo pair itself is sound


LOOKALIKES = LandmarkNoise(sigma_px=1e-6, lookalike_share=0.2)


def lookalike_shifts() -> np.ndarray:
    """Return the (N, 4) offsets of a flight's look-alikes from their own landmarks [px]."""
    plain = observe(FLEET[0], FIELD, noise=LandmarkNoise(sigma_px=1e-6))
    shifts = []
    for (clean, _), (shifted, ids) in zip(plain, observe(FLEET[0], FIELD, noise=LOOKALIKES), strict=True):
        shifts.append((shifted.pixels - clean.pixels)[ids == -1])
        np.testing.assert_allclose(shifted.pixels[ids >= 0], clean.pixels[ids >= 0], atol=1e-3)
    return np.concatenate(shifts)


def test_lookalikes_are_marked_and_as_many_as_asked_except_at_the_border() -> None:
    shares = [np.mean(ids == -1) for _, ids in observe(FLEET[0], FIELD, noise=LOOKALIKES)]
    assert 0.18 < np.mean(shares) < 0.21


def test_a_lookalike_is_a_few_pixels_off_in_any_direction_and_depth() -> None:
    shift = lookalike_shifts()
    disparity = shift[:, 3] - shift[:, 1]  # the rig's baseline is along v
    size = np.linalg.norm(np.column_stack([shift[:, :2], disparity]), axis=1)
    assert size.max() < 16.0  # 15 px, except for the cameras' relative attitude
    assert np.quantile(size, 0.1) > 3.0
    assert np.abs(shift[:, :2].mean(axis=0)).max() < 1.0
    assert np.percentile(disparity, 20) < -3.0
    assert np.percentile(disparity, 80) > 3.0


def test_a_lookalike_is_a_real_point() -> None:
    for features, ids in list(observe(FLEET[0], FIELD, noise=LOOKALIKES))[::40]:
        shifted = features.pixels[ids == -1].astype(float)
        assert FLEET[0].rig.epipolar_distance(shifted).max() < 0.1
        depth = FLEET[0].rig.triangulate(shifted)[:, 2]
        assert 20.0 < depth.min() < depth.max() < 160.0  # from 70 m above ground


def test_a_rotated_right_camera_moves_only_right_pixels() -> None:
    biased = simulate_fleet(dataclasses.replace(SCENARIOS["kagaru"], extrinsic_bias_deg=(0.02, 0.0, 0.0)))[0]
    noise = LandmarkNoise(sigma_px=1e-6)
    plain, rotated = next(observe(FLEET[0], FIELD, noise=noise))[0], next(observe(biased, FIELD, noise=noise))[0]
    np.testing.assert_allclose(plain.pixels[:, :2], rotated.pixels[:, :2], atol=1e-3)
    shift = rotated.pixels[:, 3] - plain.pixels[:, 3]
    assert np.abs(shift).mean() == pytest.approx(1645.0 * np.deg2rad(0.02), rel=0.05)
