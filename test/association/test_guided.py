# SPDX-License-Identifier: Apache-2.0
"""A feature matches a landmark only inside its gate, by its descriptor."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from uav_vslam.association.descriptor_statistics import DescriptorStatistics
from uav_vslam.association.guided import gate, gated
from uav_vslam.association.in_view import InView
from uav_vslam.config import BackendConfig
from uav_vslam.geometry.stereo import STEREO_DOF
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]


def covariances(rng: np.random.Generator, count: int) -> Array:
    A = rng.normal(size=(count, 4, 4))
    return np.asarray(A @ A.transpose(0, 2, 1) + 0.1 * np.eye(4))


def descriptors_of(*identities: int) -> NDArray[np.uint8]:
    return np.array([np.random.default_rng(k).integers(0, 256, 128) for k in identities], np.uint8).reshape(-1, 128)


def matched(
    predicted: Array, S: Array, known: NDArray[np.uint8], observed: Array, seen: NDArray[np.uint8], *, ratio: float
) -> NDArray[np.intp]:
    """Return the pairs of landmarks with features, at a gate of 99 %."""
    in_view = InView(np.arange(len(predicted)), predicted, S, known, DescriptorStatistics.of(known))
    config = BackendConfig(gate_probability=0.99, min_descriptor_ratio=ratio)
    return gated(in_view, StereoFeatures(0, observed.astype(np.float32), seen), config)


def test_the_gate_passes_its_probability_of_true_observations() -> None:
    """5000 draws: the share's standard deviation is 0.6 %; one degree of freedom more or less changes it by 5 %."""
    rng = np.random.default_rng(2)
    S = covariances(rng, 5)
    predicted = rng.uniform(0, 900, (5, 4))
    for k in range(5):
        observed = rng.multivariate_normal(predicted[k], S[k], 1000)
        passed = gate(predicted[k : k + 1], S[k : k + 1], observed, probability=0.8)
        assert passed.mean() == pytest.approx(0.8, abs=0.04)


def test_the_gate_is_the_chi_square_of_the_whitened_difference() -> None:
    rng = np.random.default_rng(3)
    S, predicted = covariances(rng, 6), rng.uniform(0, 20, (6, 4))
    observed = rng.uniform(0, 20, (9, 4))
    passed = gate(predicted, S, observed, probability=0.99)
    for n in range(6):
        for m in range(9):
            nu = observed[m] - predicted[n]
            assert passed[n, m] == (nu @ np.linalg.solve(S[n], nu) <= chi2.ppf(0.99, STEREO_DOF))


def test_the_nearest_descriptor_outside_the_gate_is_ignored() -> None:
    predicted = np.array([[100.0, 100.0, 90.0, 100.0]])
    S = 4.0 * np.eye(4)[None]
    observed = np.array([[101.0, 99.0, 91.0, 100.0], [300.0, 99.0, 291.0, 100.0]])
    nearly = descriptors_of(1).astype(int) + 5
    descriptors = np.vstack([np.minimum(nearly, 255).astype(np.uint8), descriptors_of(1)])
    pairs = matched(predicted, S, descriptors_of(1), observed, descriptors, ratio=0.85)
    assert pairs.tolist() == [[0, 0]]


def test_two_similar_descriptors_inside_one_gate_are_ambiguous() -> None:
    predicted = np.array([[100.0, 100.0, 90.0, 100.0]])
    observed = np.array([[101.0, 99.0, 91.0, 100.0], [99.0, 101.0, 90.0, 101.0]])
    descriptors = np.vstack([descriptors_of(1), descriptors_of(1)])
    pairs = matched(predicted, 4.0 * np.eye(4)[None], descriptors_of(1), observed, descriptors, ratio=0.85)
    assert pairs.shape == (0, 2)


def test_no_landmark_and_no_feature_is_used_twice() -> None:
    rng = np.random.default_rng(5)
    predicted = rng.uniform(0, 60, (30, 4))
    observed = predicted[rng.permutation(30)] + rng.normal(0, 5, (30, 4))
    pairs = matched(
        predicted,
        np.tile(400.0 * np.eye(4), (30, 1, 1)),
        descriptors_of(*range(30)),
        observed,
        descriptors_of(*rng.integers(0, 30, 30)),
        ratio=0.9,
    )
    assert len(pairs) > 5
    assert len(set(pairs[:, 0].tolist())) == len(set(pairs[:, 1].tolist())) == len(pairs)


@pytest.mark.parametrize(("landmarks", "features"), [(0, 0), (3, 0), (0, 3)])
def test_an_empty_side_matches_nothing(landmarks: int, features: int) -> None:
    pairs = matched(
        np.zeros((landmarks, 4)),
        np.tile(np.eye(4), (landmarks, 1, 1)),
        descriptors_of(*range(landmarks)),
        np.zeros((features, 4)),
        descriptors_of(*range(features)),
        ratio=0.85,
    )
    assert pairs.shape == (0, 2)
    assert gate(
        np.zeros((landmarks, 4)), np.zeros((landmarks, 4, 4)), np.zeros((features, 4)), probability=0.9
    ).shape == (
        landmarks,
        features,
    )
