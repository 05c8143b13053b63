# SPDX-License-Identifier: Apache-2.0
"""All landmarks of a flight are kept once, with a covariance that covers their errors."""

import dataclasses
from collections import Counter
from contextlib import nullcontext

import numpy as np
import pytest

from uav_vslam.config import RigConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.slam.saved_map.archive import LEFT_FOR_SECTION, MIN_OBSERVATIONS, SECTION_LANDMARKS, MapArchive
from uav_vslam.slam.saved_map.record import MapOrigin

SEEDS = range(1, 4)


def test_every_landmark_that_was_in_the_filter_long_enough_is_kept_once(mapped) -> None:
    flight = mapped(1)
    seen: Counter[int] = Counter()
    for output in flight.track.outputs:
        seen.update(output.report.sightings[:, 0].tolist())
    in_beliefs = {i for output in flight.track.outputs if output.joint for i in output.joint.ids.tolist()}
    kept = [i for section in flight.saved.sections for i in section.ids.tolist()]
    assert len(set(kept)) == len(kept)
    assert {i for i in in_beliefs if seen[i] >= MIN_OBSERVATIONS} <= set(kept) <= in_beliefs
    assert len(kept) > 2 * SECTION_LANDMARKS


@pytest.mark.slow
def test_positions_err_as_the_covariance_of_their_section_says(mapped) -> None:
    joint, single = [], []
    for seed in SEEDS:
        flight = mapped(seed)
        for section in flight.saved.sections:
            error, P = flight.errors_m(section), section.covariance
            joint.append(error.ravel() @ np.linalg.solve(P, error.ravel()) / error.size)
            own = P.reshape(len(error), 3, len(error), 3)[np.arange(len(error)), :, np.arange(len(error))]
            single.append(np.einsum("ni,ni->n", error, np.linalg.solve(own, error[..., None])[..., 0]).mean() / 3)
    assert max(joint) < 1.0  # a bound of the exact covariance is cautious
    assert np.mean(joint) > 0.1  # but not vague
    assert 0.2 < np.mean(single) < 1.2


@pytest.mark.slow
def test_drift_is_in_the_common_error_of_a_section_and_not_in_each_landmark_s_own(mapped) -> None:
    trusted = RigConfig(miscalibrated_probability=0.0)  # doubt about depths is each landmark's own
    flight = mapped(1, frames=80, rig=trusted)
    sections = [section for section in flight.saved.sections if len(section) == SECTION_LANDMARKS]
    common = [np.trace(section.common_covariance(section.anchor)[:3, :3]) for section in sections]
    own = [np.median(np.trace(section.own_covariances, axis1=1, axis2=2)) for section in sections]
    assert common[-1] > 2.0 * common[0]
    assert own[-1] < 1.5 * own[0]


def test_a_section_has_landmarks_of_about_one_view(mapped) -> None:
    sections = mapped(1).saved.sections
    assert all(len(section) <= SECTION_LANDMARKS for section in sections)
    assert np.median([len(section) for section in sections]) > LEFT_FOR_SECTION
    assert all(np.ptp(section.positions[:, :2], axis=0).max() < 150.0 for section in sections)


def test_a_filter_that_was_re_initialised_loses_no_landmark(make_joint) -> None:
    archive = MapArchive(MapOrigin("uav1", 1, frame="uav1/map", stamp_ns=0))
    rng = np.random.default_rng(2)
    for first in (1, 101):  # all identifiers change at once
        ids = np.arange(first, first + 5, dtype=np.uint32)
        for _ in range(MIN_OBSERVATIONS):
            archive.count(np.column_stack([ids, ids]).astype(np.intp))
        belief = make_joint(rng.normal(0.0, 20.0, (5, 3)), np.eye(21), stamp_ns=first * 1_000_000_000)
        archive.add(dataclasses.replace(belief, ids=ids))
    kept = archive.mapped()
    assert [place.ids.tolist() for place in kept.places] == [[1, 2, 3, 4, 5], [101, 102, 103, 104, 105]]
    assert kept.origin.stamp_ns == 101_000_000_000


def test_a_belief_that_is_not_positive_definite_costs_no_other_its_landmarks(make_joint) -> None:
    """The filter is re-initialised after it; taken over, it would fail each later belief, and the map."""
    archive = MapArchive(MapOrigin("uav1", 1, frame="uav1/map", stamp_ns=0))
    rng = np.random.default_rng(2)
    broken = np.diag(np.append(np.ones(20), -1.0))
    for first, covariance in ((1, np.eye(21)), (101, broken), (201, np.eye(21))):
        ids = np.arange(first, first + 5, dtype=np.uint32)
        for _ in range(MIN_OBSERVATIONS):
            archive.count(np.column_stack([ids, ids]).astype(np.intp))
        belief = make_joint(rng.normal(0.0, 20.0, (5, 3)), covariance, stamp_ns=first * 1_000_000_000)
        with pytest.raises(FilterDivergence) if covariance is broken else nullcontext():
            archive.add(dataclasses.replace(belief, ids=ids))
    assert [place.ids.tolist() for place in archive.mapped().places] == [[1, 2, 3, 4, 5], [201, 202, 203, 204, 205]]


def test_a_flight_without_a_belief_has_an_empty_map() -> None:
    assert len(MapArchive(MapOrigin("uav1", 1, frame="uav1/map", stamp_ns=0)).mapped().saved_map()) == 0
