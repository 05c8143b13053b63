# SPDX-License-Identifier: Apache-2.0
"""Tracks of an uncertain vehicle: which of them contradict the others."""

import dataclasses
import functools

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray
from scipy.stats import chi2

from uav_vslam.config import RigConfig
from uav_vslam.estimation.rig_errors import RigErrors
from uav_vslam.estimation.track_consensus import FAR_WIDE, LEAST_ASKED, WIDE, trusted
from uav_vslam.estimation.tracks import TrackObservation, Tracks, observe_tracks
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.pose import POSE_DIM

VIEWS = 3
SIGMA_PX = 0.1
PROBABILITY = 0.99
SLIDING = 0


@pytest.fixture
def seen(course) -> TrackObservation:
    """Return a track that slides by some pixels in each frame, then correct ones."""
    rng = np.random.default_rng(3)
    pixels = np.stack([course.pixels(frame, np.arange(len(course.landmarks))) for frame in range(VIEWS)], axis=1)
    pixels = pixels + rng.normal(0.0, 0.5 * SIGMA_PX, pixels.shape)
    pixels[SLIDING, :, [0, 2]] += 20 * SIGMA_PX * np.arange(VIEWS)
    errors = RigErrors(course.rig, RigConfig(), 15)
    past = course.past_poses(VIEWS, Turning.none())
    tracks = Tracks(pixels, np.ones(pixels.shape[:2], bool))
    return observe_tracks(tracks, past, rig=course.rig, errors=errors, sigma_px=SIGMA_PX)


def of(seen: TrackObservation, tracks: slice) -> TrackObservation:
    rows = np.zeros(len(seen.views), bool)
    rows[tracks] = True
    return seen.chosen(rows)


def covariance(seen: TrackObservation, position_m: float) -> NDArray[np.float64]:
    """Return that of the rig and the past poses, whose positions are that uncertain."""
    P = 1e-12 * np.eye(seen.H.shape[2])
    of_positions = np.arange(len(P) - POSE_DIM * VIEWS, len(P)).reshape(VIEWS, POSE_DIM)[:, :3].ravel()
    P[of_positions, of_positions] = position_m**2
    return P


def nobody() -> TrackObservation:
    raise AssertionError("others were asked")


@pytest.mark.parametrize("sigma_m", [1e-4, 0.02, 1.0])
def test_the_gate_is_the_chi_square_test_of_the_residuals_in_the_null_space_of_the_point(
    seen: TrackObservation, sigma_m: float
) -> None:
    P = covariance(seen, sigma_m)
    mean = 0.5 * np.sqrt(np.diagonal(P))
    passed, added = seen.gated(P, PROBABILITY, mean=mean)
    for k, dof in enumerate(4 * seen.views - 3):
        without_point = scipy.linalg.null_space(seen.Q[k].T).T
        H, r = without_point @ seen.H[k], without_point @ seen.residual[k]
        nis = (r - H @ mean) @ np.linalg.solve(H @ P @ H.T + np.eye(len(H)), r - H @ mean)
        assert passed[k] == (seen.good[k] and nis <= chi2.ppf(PROBABILITY, dof))
        assert added[k] == pytest.approx(np.trace(H @ P @ H.T), rel=1e-9)
    assert passed.any()


def test_a_narrow_gate_needs_no_others(seen: TrackObservation) -> None:
    passed = trusted(seen, nobody, covariance(seen, 1e-4), PROBABILITY)
    assert not passed[SLIDING]
    assert passed[SLIDING + 1 :].mean() > 0.9


def test_where_the_gate_is_wide_a_track_must_agree_with_the_others(seen: TrackObservation) -> None:
    P, alone, others = covariance(seen, 1.0), of(seen, slice(0, 1)), of(seen, slice(1, None))
    passed, added = alone.gated(P, PROBABILITY)
    assert passed.all()
    assert added.min() > WIDE
    few = of(seen, slice(1, LEAST_ASKED - 1))
    assert not trusted(alone, lambda: of(seen, slice(0)), P, PROBABILITY).any()  # without others to ask
    assert not trusted(few, lambda: alone, P, PROBABILITY).any()
    assert not trusted(alone, lambda: others, P, PROBABILITY).any()
    among_all = trusted(seen, None, P, PROBABILITY)
    assert not among_all[SLIDING]
    assert among_all[SLIDING + 1 :].mean() > 0.9


def test_the_gate_is_as_wide_as_for_those_that_pass(seen: TrackObservation) -> None:
    """Tracks that the state hardly moves don't make up for a few wrong ones that pass because it moves them far."""
    P, few = covariance(seen, 1.0), of(seen, slice(1, LEAST_ASKED))
    firm = of(seen, slice(LEAST_ASKED, 3 * LEAST_ASKED))
    firm = dataclasses.replace(firm, H=1e-4 * firm.H, residual=firm.residual + 100.0)
    both = few.joined(firm)
    passed, added = both.gated(P, PROBABILITY)
    assert passed[: len(few.views)].all()
    assert not passed[len(few.views) :].any()
    assert np.median(added) < WIDE
    assert not trusted(both, None, P, PROBABILITY).any()


def test_without_a_majority_the_gate_alone_decides(seen: TrackObservation) -> None:
    P, alone = covariance(seen, 1.0), of(seen, slice(0, 1))
    opposite = dataclasses.replace(alone, residual=-alone.residual)
    same, against = (functools.reduce(TrackObservation.joined, [one] * LEAST_ASKED) for one in (alone, opposite))
    assert trusted(same, lambda: against, P, PROBABILITY).all()


def test_where_no_linearisation_holds_a_few_tracks_wait_though_they_agree_with_the_others(
    seen: TrackObservation,
) -> None:
    good = of(seen, slice(SLIDING + 1, None))
    few, others = of(good, slice(LEAST_ASKED - 1)), of(good, slice(LEAST_ASKED - 1, None))
    added = np.median(few.gated(covariance(seen, 1.0), PROBABILITY)[1])
    for share, used in ((0.9, True), (1.1, False)):
        P = covariance(seen, np.sqrt(share * FAR_WIDE / added))
        assert trusted(few, lambda: others, P, PROBABILITY).any() == used
        assert trusted(good, None, P, PROBABILITY).mean() > 0.9
