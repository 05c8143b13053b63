# SPDX-License-Identifier: Apache-2.0
"""A packet never claims more than its sender knows, and damage or nonsense is refused by name."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import eigh

from uav_vslam.errors import FilterDivergence, InvalidMessage
from uav_vslam.slam.packet import (
    MAX_LANDMARKS,
    POSE_DIM,
    checksum,
    choose_landmarks,
    code_covariance,
    make_packet,
    payload_bytes,
    validate,
)
from uav_vslam.types import JointInformation, LandmarkPacket

Array = NDArray[np.float64]

EIGENVALUE = 1e-12  # allowed above 1: the coding keeps a margin of 1e-9 for what eigh itself errs by


def random_covariance(rng: np.random.Generator, n: int, decades: float) -> Array:
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P = (Q * 10.0 ** rng.uniform(-decades / 2, decades / 2, n)) @ Q.T
    return np.asarray(0.5 * (P + P.T))


def largest_share(exact: Array, coded: Array) -> float:
    """Return lambda_max(R^-1 P): how much of the exact uncertainty the coded one holds, at worst."""
    return float(eigh(exact, coded, eigvals_only=True)[-1])


@pytest.fixture
def joint(make_joint) -> JointInformation:
    rng = np.random.default_rng(8)
    positions = np.column_stack([rng.uniform(-40, 40, (20, 2)), rng.normal(0, 2, 20)])
    return make_joint(positions, random_covariance(rng, 66, 3.0))


@pytest.fixture
def packet(joint: JointInformation) -> LandmarkPacket:
    return make_packet(joint, sequence=3, max_landmarks=8, prior_id="survey")


def resealed(packet: LandmarkPacket, **changes) -> LandmarkPacket:
    """Return the packet with other fields and a checksum that fits them."""
    changed = dataclasses.replace(packet, **changes)
    return dataclasses.replace(changed, checksum=checksum(changed))


@given(
    seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12), decades=st.floats(0.0, 8.0), log_scale=st.floats(-8, 8)
)
def test_coded_covariance_bounds_the_exact_one(seed: int, count: int, decades: float, log_scale: float) -> None:
    P = 10.0**log_scale * random_covariance(np.random.default_rng(seed), 3 * count, decades)
    factor, scale = code_covariance(P)
    L = np.zeros_like(P)
    L[np.tril_indices(len(P))] = factor
    assert largest_share(P, L @ L.T) <= 1.0 + EIGENVALUE
    assert 1.0 <= scale <= 1.0 + 1e-6 * 10.0 ** (decades / 2)  # float32 rounds by 6e-8 of the largest


@pytest.mark.parametrize("relative_m", [0.1, 0.03, 0.003])
def test_coded_covariance_bounds_landmarks_that_share_the_drift_of_their_map(relative_m: float) -> None:
    drift = np.tile(np.eye(3), (64, 1))
    P = drift @ drift.T + relative_m**2 * np.diag(np.random.default_rng(0).uniform(0.5, 2.0, 192))
    factor, _ = code_covariance(P)
    L = np.zeros_like(P)
    L[np.tril_indices(len(P))] = factor
    assert largest_share(P, L @ L.T) <= 1.0 + EIGENVALUE


def test_an_exactly_representable_covariance_is_hardly_inflated() -> None:
    factor, scale = code_covariance(4.0 * np.eye(6))
    assert 1.0 <= scale < 1.0 + 1e-6
    assert factor.dtype == np.float32


def test_a_packet_holds_the_marginal_of_its_landmarks(joint: JointInformation, packet: LandmarkPacket) -> None:
    rows = np.flatnonzero(np.isin(joint.ids, packet.ids))
    columns = (POSE_DIM + 3 * rows[:, None] + np.arange(3)).ravel()
    exact = np.linalg.inv(joint.information)[np.ix_(columns, columns)]
    assert largest_share(exact, packet.covariance) <= 1.0 + EIGENVALUE
    np.testing.assert_allclose(packet.covariance, exact, rtol=1e-4, atol=1e-4 * np.abs(exact).max())
    np.testing.assert_allclose(
        packet.positions, joint.positions[rows], rtol=0, atol=1e-5
    )  # float32 of offsets below 100 m
    np.testing.assert_array_equal(packet.descriptors, joint.descriptors[rows])
    assert (packet.vehicle, packet.session, packet.sequence) == ("uav1", 1, 3)
    assert packet.sources == ("uav1/1",)
    assert packet.prior_id == "survey"
    assert len(packet) == 8
    validate(packet)


def test_offsets_keep_their_digits_far_from_the_maps_origin(make_joint) -> None:
    far = np.array([4.0e5, -7.0e5, 300.0])
    joint = make_joint(far + np.array([[1.23456, 2.0, 3.0]]), np.eye(9))
    joint = dataclasses.replace(joint, T_map_body=dataclasses.replace(joint.T_map_body, t=far))
    packet = make_packet(joint, sequence=1, max_landmarks=5)
    np.testing.assert_allclose(packet.positions, joint.positions, rtol=0, atol=1e-6)


def test_a_belief_without_landmarks_makes_an_empty_valid_packet(make_joint) -> None:
    packet = make_packet(make_joint(np.zeros((0, 3)), np.eye(6)), sequence=1, max_landmarks=5)
    validate(packet)
    assert len(packet) == 0
    assert packet.covariance.shape == (0, 0)
    assert packet.positions.shape == (0, 3)


def test_a_belief_that_lost_its_definiteness_makes_no_packet(joint: JointInformation) -> None:
    with pytest.raises(FilterDivergence, match="joint information"):
        make_packet(dataclasses.replace(joint, information=-joint.information), sequence=1, max_landmarks=5)


ARRAYS = ("ids", "origin", "offsets", "covariance_factor", "descriptors")


@pytest.mark.parametrize("field", ARRAYS)
def test_every_damaged_byte_of_an_array_is_noticed(packet: LandmarkPacket, field: str) -> None:
    data = np.ascontiguousarray(getattr(packet, field))
    for place in range(data.nbytes):
        damaged = data.copy()
        damaged.view(np.uint8).reshape(-1)[place] ^= 1 << (place % 8)
        with pytest.raises(InvalidMessage) as caught:
            validate(dataclasses.replace(packet, **{field: damaged}))
        assert caught.value.reason == "checksum"


@pytest.mark.parametrize(
    "change",
    [
        {"stamp_ns": 10_000_000_001},
        {"vehicle": "uav3"},
        {"session": 2},
        {"sequence": 4},
        {"sources": ("uav2/1",)},
        {"sources": ("uav1/1", "uav2/1")},
        {"sources": ()},
        {"prior_id": ""},
        {"covariance_scale": 1.5},
        {"checksum": 0},
    ],
    ids=lambda change: next(iter(change)),
)
def test_every_changed_field_is_noticed(packet: LandmarkPacket, change: dict) -> None:
    with pytest.raises(InvalidMessage, match="checksum"):
        validate(dataclasses.replace(packet, **change))


def with_entry(array: NDArray, place: tuple[int, ...], value: float) -> NDArray:
    out = array.copy()
    out[place] = value
    return out


BAD = {
    "too_many": ("shape", lambda p: {"ids": np.arange(MAX_LANDMARKS + 1, dtype=np.uint32)}),
    "ids_without_offsets": ("shape", lambda p: {"ids": p.ids[:-1]}),
    "flat_offsets": ("shape", lambda p: {"offsets": p.offsets.ravel()}),
    "short_factor": ("shape", lambda p: {"covariance_factor": p.covariance_factor[:-1]}),
    "missing_descriptor": ("shape", lambda p: {"descriptors": p.descriptors[:-1]}),
    "origin_of_two": ("shape", lambda p: {"origin": p.origin[:2]}),
    "nan_origin": ("not_finite", lambda p: {"origin": with_entry(p.origin, (1,), np.nan)}),
    "infinite_offset": ("not_finite", lambda p: {"offsets": with_entry(p.offsets, (0, 2), np.inf)}),
    "nan_factor": ("not_finite", lambda p: {"covariance_factor": with_entry(p.covariance_factor, (4,), np.nan)}),
    "nan_scale": ("not_finite", lambda p: {"covariance_scale": float("nan")}),
    "zero_diagonal": ("covariance", lambda p: {"covariance_factor": with_entry(p.covariance_factor, (5,), 0.0)}),
    "negative_diagonal": ("covariance", lambda p: {"covariance_factor": with_entry(p.covariance_factor, (0,), -1.0)}),
    "deflated": ("covariance", lambda p: {"covariance_scale": 0.5}),
    "absurd_covariance": ("covariance", lambda p: {"covariance_factor": with_entry(p.covariance_factor, (3,), 1e30)}),
    "repeated_id": ("duplicate_id", lambda p: {"ids": with_entry(p.ids, (0,), p.ids[1])}),
}


@pytest.mark.parametrize("kind", sorted(BAD))
def test_nonsense_with_a_good_checksum_is_refused_by_its_reason(packet: LandmarkPacket, kind: str) -> None:
    reason, change = BAD[kind]
    with pytest.raises(InvalidMessage) as caught:
        validate(resealed(packet, **change(packet)))
    assert caught.value.reason == reason


def test_payload_grows_by_what_the_landmarks_need(joint: JointInformation) -> None:
    sizes = [payload_bytes(make_packet(joint, sequence=1, max_landmarks=n)) for n in (0, 1, 2)]
    assert sizes[1] - sizes[0] == 4 + 12 + 6 * 4 + 128
    assert sizes[2] - sizes[0] == 2 * (4 + 12 + 128) + 21 * 4


@given(st.integers(0, 25), st.integers(0, 100), st.sets(st.integers(1, 20)))
@settings(max_examples=50)
def test_the_choice_is_ascending_without_repeats_and_as_large_as_asked(count, sequence, matched) -> None:
    rows = choose_landmarks(TWENTY, count, matched_ids=matched, sequence=sequence)
    assert len(rows) == min(count, 20)
    assert (np.diff(rows) > 0).all()
    chosen_matched = len(matched & set((rows + 1).tolist()))
    assert chosen_matched == min(len(matched), count)  # shared landmarks go first


TWENTY = JointInformation(
    1,
    "uav1",
    1,
    None,  # type: ignore[arg-type]  # the choice looks at landmarks only
    np.arange(1, 21, dtype=np.uint32),
    np.random.default_rng(0).uniform(-40, 40, (20, 3)),
    np.eye(66),
    np.zeros((20, 128), np.uint8),
)


def test_in_time_every_landmark_is_offered() -> None:
    offered = [choose_landmarks(TWENTY, 6, matched_ids=(2, 9), sequence=k) for k in range(1, 6)]
    assert all({1, 8} <= set(rows.tolist()) for rows in offered)
    assert set(np.concatenate(offered).tolist()) == set(range(20))


def test_surplus_shared_landmarks_are_spread_over_the_ground() -> None:
    corners = np.array([[0, 0], [0, 40], [40, 0], [40, 40]], float)
    positions = np.vstack([np.full((16, 2), 20.0), corners])
    joint = dataclasses.replace(TWENTY, positions=np.column_stack([positions, np.zeros(20)]))
    rows = choose_landmarks(joint, 5, matched_ids=range(1, 21), sequence=1)
    assert rows.tolist() == [0, 16, 17, 18, 19]
