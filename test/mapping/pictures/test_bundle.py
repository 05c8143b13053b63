# SPDX-License-Identifier: Apache-2.0
"""The adjustment descends along its own gradient to the truth, whatever a few false observations and positions say."""

from dataclasses import replace

import numpy as np
import pytest
from similarity_errors import similarity_errors

from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.mapping.pictures.bundle import POSE, Bundle, Priors, Scene
from uav_vslam.mapping.pictures.lens import PARAMETERS
from uav_vslam.mapping.pictures.tracks import Tracks

CAMERAS, POINTS = 6, 120
NOISE_PX = 0.3
LENS = np.array([[np.log(1000.0), -0.05, 0.01, 0.004, -0.006]])
NO_POSITIONS = np.full((CAMERAS, 3), np.nan)
LOOSE = Priors(LENS, np.array([[0.3, 0.1, 0.1, 0.01, 0.01]]), NO_POSITIONS, np.ones(3))


def true_scene(rng: np.random.Generator) -> Scene:
    points = np.column_stack([rng.uniform(-1.0, 1.0, (POINTS, 2)), rng.normal(0.0, 0.1, POINTS)])
    centres = np.column_stack([rng.uniform(-0.5, 0.5, (CAMERAS, 2)), 1.0 + rng.normal(0.0, 0.05, CAMERAS)])
    attitudes = so3_exp(rng.normal(0.0, 0.15, (CAMERAS, 3))) @ np.diag([1.0, -1.0, -1.0])
    return Scene(attitudes, centres, LENS.copy(), np.zeros(CAMERAS, np.intp), points)


def observed(scene: Scene, rng: np.random.Generator, noise_px: float = NOISE_PX) -> Tracks:
    point, picture = np.repeat(np.arange(POINTS), CAMERAS), np.tile(np.arange(CAMERAS), POINTS)
    empty = Tracks(picture, point, np.zeros((len(point), 2)), POINTS)
    return replace(empty, pixels=scene.residuals(empty) + rng.normal(0.0, noise_px, (len(point), 2)))


def disturbed(scene: Scene, rng: np.random.Generator, size: float = 1.0) -> Scene:
    return replace(
        scene,
        R_cam_map=so3_exp(size * rng.normal(0.0, 0.05, (CAMERAS, 3))) @ scene.R_cam_map,
        centres=scene.centres + size * rng.normal(0.0, 0.05, (CAMERAS, 3)),
        lenses=scene.lenses + size * np.array([[0.1, 0.05, -0.01, 0.003, 0.002]]),
        points=scene.points + size * rng.normal(0.0, 0.05, (POINTS, 3)),
    )


@pytest.mark.parametrize("with_positions", [False, True])
def test_the_gradient_is_the_numerical_one_of_the_cost(with_positions: bool) -> None:
    rng = np.random.default_rng(1)
    truth = true_scene(rng)
    scene = disturbed(truth, rng)
    priors = replace(LOOSE, positions=truth.centres, position_sigmas=np.full(3, 0.02)) if with_positions else LOOSE
    bundle = Bundle(observed(truth, rng), priors, huber_px=40.0, noise_px=1000.0)  # so that the priors weigh, too
    gradient = bundle._normal(scene).gradient
    still = np.zeros((POINTS, 3))
    for k in (0, 4, POSE + 2, POSE + 5, *range(POSE * CAMERAS, POSE * CAMERAS + PARAMETERS)):
        step = 1e-7 * np.eye(len(gradient))[k]
        costs = [bundle.cost(bundle._moved(scene, sign * step, still)) for sign in (1.0, -1.0)]
        assert (costs[0] - costs[1]) / 2e-7 == pytest.approx(gradient[k], rel=1e-4, abs=1.0)


def test_poses_and_lens_are_recovered() -> None:
    rng = np.random.default_rng(3)
    truth = true_scene(rng)
    bundle = Bundle(observed(truth, rng), LOOSE, huber_px=2.0, noise_px=NOISE_PX)
    found = bundle.adjust(disturbed(truth, rng))
    sigmas = bundle.lens_sigmas(found)
    assert np.all(np.abs(found.lenses - LENS) < 4.0 * sigmas)
    assert sigmas[0, 0] < 0.005
    assert similarity_errors(found.centres, truth.centres).max() < 0.004  # a thousandth of the height is about a pixel


def lens_errors(seed: int, within_picture_px: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return (5,) errors of a lens and their standard deviations; each picture may have a twist of its own [px]."""
    rng = np.random.default_rng(seed)
    truth = true_scene(rng)
    tracks = observed(truth, rng)
    twist = rng.normal(0.0, within_picture_px, (CAMERAS, 2))[tracks.picture] * np.sin(tracks.pixels / 150.0)
    bundle = Bundle(replace(tracks, pixels=tracks.pixels + twist), LOOSE, huber_px=5.0, noise_px=NOISE_PX)
    found = bundle.adjust(truth)
    return (found.lenses - LENS)[0], bundle.lens_sigmas(found)[0]


@pytest.mark.parametrize("within_picture_px", [0.0, 1.0])
def test_the_lens_errs_as_its_standard_deviation_says(within_picture_px: float) -> None:
    """Independent noise, and errors that the points of a picture share."""
    runs = [lens_errors(seed, within_picture_px) for seed in range(20)]
    errors, sigmas = (np.array(each) for each in zip(*runs, strict=True))
    ratio = np.sqrt(((errors / sigmas) ** 2).mean(axis=0))
    assert np.all(ratio > 0.5)
    assert np.all(ratio < 1.5)


def test_false_observations_do_not_pull() -> None:
    rng = np.random.default_rng(4)
    truth = true_scene(rng)
    tracks = observed(truth, rng)
    false = rng.random(len(tracks.point)) < 0.05
    pixels = tracks.pixels + false[:, None] * rng.normal(0.0, 60.0, tracks.pixels.shape)
    found = disturbed(truth, rng, 0.2)
    for huber_px in (30.0, 1.0):  # far from the truth, a narrow kernel follows whatever is near
        found = Bundle(replace(tracks, pixels=pixels), LOOSE, huber_px=huber_px).adjust(found)
    assert similarity_errors(found.centres, truth.centres).max() < 0.006


def test_a_wrong_position_loses_its_pull() -> None:
    rng = np.random.default_rng(5)
    truth = true_scene(rng)
    positions = truth.centres + rng.normal(0.0, 0.003, truth.centres.shape)
    positions[2] += [0.5, -0.3, 0.1]
    priors = replace(LOOSE, positions=positions, position_sigmas=np.full(3, 0.003))
    bundle = Bundle(observed(truth, rng), priors, huber_px=2.0, noise_px=NOISE_PX)
    found = bundle.adjust(truth)
    error = np.linalg.norm(found.centres - truth.centres, axis=1)
    assert error.max() < 0.01


def test_a_given_focal_length_stays() -> None:
    rng = np.random.default_rng(6)
    truth = true_scene(rng)
    held = replace(
        LOOSE, lenses=LENS + np.array([[0.02, 0, 0, 0, 0]]), lens_sigmas=np.array([[0.0, 0.1, 0.1, 0.01, 0.01]])
    )
    start = replace(disturbed(truth, rng), lenses=held.lenses.copy())
    found = Bundle(observed(truth, rng), held, huber_px=2.0).adjust(start)
    assert found.lenses[0, 0] == held.lenses[0, 0]
    assert found.lenses[0, 1] != held.lenses[0, 1]


def test_the_same_input_gives_the_same_bits() -> None:
    def once() -> Scene:
        rng = np.random.default_rng(7)
        truth = true_scene(rng)
        return Bundle(observed(truth, rng), LOOSE, huber_px=2.0).adjust(disturbed(truth, rng))

    assert once().centres.tobytes() == once().centres.tobytes()
