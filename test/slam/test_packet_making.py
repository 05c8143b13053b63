# SPDX-License-Identifier: Apache-2.0
"""A packet holds the marginal of its landmarks, within its byte limit."""

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh

from uav_vslam.errors import FilterDivergence
from uav_vslam.geometry.coded_points import OFFSET_LIMIT_M, OFFSET_STEP_M
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.slam.packet import ANCHOR, DENSE, PacketPolicy, make_packet, payload_bytes, validate
from uav_vslam.types import JointInformation, LandmarkPacket
from uav_vslam.vision.compact_descriptors import COMPACT, in_basis

COMPACTED = PacketPolicy(form=ANCHOR, max_landmarks=8, descriptor_basis=COMPACT)
POLICIES = {DENSE: PacketPolicy(max_landmarks=8), ANCHOR: COMPACTED}
POSITION_M = {DENSE: 1e-5, ANCHOR: OFFSET_STEP_M / 2 + 1e-9}  # float32 of offsets below 100 m; half a step


@pytest.fixture(scope="module")
def joint(make_joint) -> JointInformation:
    rng = np.random.default_rng(8)
    positions = np.column_stack([rng.uniform(-40, 40, (20, 2)), rng.normal(0, 2, 20)])
    A = rng.normal(size=(66, 66))
    return make_joint(positions, 0.01 * (A @ A.T + 10 * np.eye(66)))


@pytest.fixture(params=[DENSE, ANCHOR])
def form(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def packet(joint: JointInformation, form: str) -> LandmarkPacket:
    return make_packet(joint, sequence=3, policy=POLICIES[form], prior_id="survey")


def test_a_packet_holds_the_marginal_of_its_landmarks(
    joint: JointInformation, packet: LandmarkPacket, form: str
) -> None:
    rows = np.flatnonzero(np.isin(joint.ids, packet.ids))
    columns = (POSE_DIM + 3 * rows[:, None] + np.arange(3)).ravel()
    exact = np.linalg.inv(joint.information)[np.ix_(columns, columns)]
    assert eigh(exact, packet.covariance, eigvals_only=True)[-1] <= 1.0 + 1e-12
    if form == DENSE:
        np.testing.assert_allclose(packet.covariance, exact, rtol=1e-4, atol=1e-4 * np.abs(exact).max())
    np.testing.assert_allclose(packet.positions, joint.positions[rows], rtol=0, atol=POSITION_M[form])
    np.testing.assert_array_equal(
        packet.descriptors, in_basis(joint.descriptors[rows], POLICIES[form].descriptor_basis)
    )
    assert (packet.vehicle, packet.session, packet.sequence) == ("uav1", 1, 3)
    assert packet.sources == ("uav1/1",)
    assert packet.prior_id == "survey"
    assert len(packet) == 8
    validate(packet)


def test_making_a_packet_is_deterministic(joint: JointInformation, packet: LandmarkPacket, form: str) -> None:
    again = make_packet(joint, sequence=3, policy=POLICIES[form], prior_id="survey")
    assert again.checksum == packet.checksum


def test_offsets_keep_their_digits_far_from_the_maps_origin(make_joint, form: str) -> None:
    far = np.array([4.0e5, -7.0e5, 300.0])
    joint = make_joint(far + np.array([[1.23456, 2.0, 3.0]]), np.eye(9))
    packet = make_packet(joint, sequence=1, policy=POLICIES[form])
    np.testing.assert_allclose(packet.positions, joint.positions, rtol=0, atol=POSITION_M[form])


def test_a_landmark_out_of_the_compact_forms_range_is_left_out(make_joint) -> None:
    positions = np.zeros((5, 3))
    positions[1:, 0] = [OFFSET_LIMIT_M - 1.0, OFFSET_LIMIT_M + 9.0, -1e6, 3.0]
    positions[4, 2] = -OFFSET_LIMIT_M - 1.0
    joint = make_joint(positions, np.eye(21))
    assert make_packet(joint, sequence=1, policy=COMPACTED).ids.tolist() == [1, 2]
    assert len(make_packet(joint, sequence=1, policy=PacketPolicy())) == 5


def test_an_estimate_without_landmarks_makes_an_empty_valid_packet(make_joint, form: str) -> None:
    packet = make_packet(make_joint(np.zeros((0, 3)), np.eye(6)), sequence=1, policy=POLICIES[form])
    validate(packet)
    assert len(packet) == 0
    assert packet.covariance.shape == (0, 0)
    assert packet.positions.shape == (0, 3)


def test_indefinite_joint_information_makes_no_packet(joint: JointInformation, form: str) -> None:
    with pytest.raises(FilterDivergence, match="joint information"):
        make_packet(dataclasses.replace(joint, information=-joint.information), sequence=1, policy=POLICIES[form])


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(limit=st.integers(250, 4000), tag_bytes=st.sampled_from([0, 16, 64]), of_policy=st.booleans())
def test_a_byte_limit_is_met_with_as_many_landmarks_as_fit(joint, form, limit, tag_bytes, of_policy) -> None:
    policy = dataclasses.replace(POLICIES[form], max_landmarks=15, tag_bytes=tag_bytes)
    if of_policy:
        packet = make_packet(joint, sequence=1, policy=dataclasses.replace(policy, max_bytes=limit), byte_limit=10**6)
    else:
        packet = make_packet(joint, sequence=1, policy=policy, byte_limit=limit)
    assert payload_bytes(dataclasses.replace(packet, tag=bytes(tag_bytes))) <= limit or len(packet) == 0
    more = make_packet(joint, sequence=1, policy=dataclasses.replace(policy, max_landmarks=len(packet) + 1))
    assert len(packet) == 15 or payload_bytes(dataclasses.replace(more, tag=bytes(tag_bytes))) > limit


def test_a_limit_below_one_landmark_leaves_an_empty_packet(joint: JointInformation, form: str) -> None:
    assert len(make_packet(joint, sequence=1, policy=POLICIES[form], byte_limit=200)) == 0
