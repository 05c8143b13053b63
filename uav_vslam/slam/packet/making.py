# SPDX-License-Identifier: Apache-2.0
"""Makes packets from the sender's estimate."""

import dataclasses
from collections.abc import Collection, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.geometry.coded_points import OFFSET_LIMIT_M, CodedPoints
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.slam.packet.choice import choose_landmarks, expected_gain
from uav_vslam.slam.packet.covariance import code_anchored, code_dense
from uav_vslam.slam.packet.policy import ANCHOR, PacketPolicy
from uav_vslam.slam.packet.wire import checksum, payload_size
from uav_vslam.types import JointInformation, LandmarkPacket
from uav_vslam.vision.compact_descriptors import in_basis

Array = NDArray[np.float64]

INT32 = np.iinfo(np.int32)


def make_packet(
    joint: JointInformation,
    *,
    sequence: int,
    policy: PacketPolicy,
    matched_ids: Collection[int] = (),
    times_sent: Mapping[int, int] = MappingProxyType({}),
    prior_id: str = "",
    byte_limit: int | None = None,
) -> LandmarkPacket:
    """Choose landmarks and encode their joint marginal.

    Args:
        joint: the sender's estimate.
        sequence: number of the packet within the session.
        policy: form and size.
        matched_ids: landmarks found to be shared with a peer; they go first.
        times_sent: how often landmarks were sent before; the least sent go first.
        prior_id: hash of a shared survey used by the estimate; that of a map that it was started in is in `joint`.
        byte_limit: free capacity of the link, in addition to the policy's own limit.

    Returns:
        A packet with as many landmarks as the limits allow; it may have none, which carries no information and
        revokes none.
    """
    codes = in_basis(joint.descriptors, policy.descriptor_basis)
    prior_id = joint.prior_id or prior_id
    count = _max_landmarks(joint, policy, codes.shape[1], prior_id, byte_limit)
    P = joint.covariance
    rows = choose_landmarks(
        joint, expected_gain(P), count, matched_ids=matched_ids, times_sent=times_sent, offered=policy.offered
    )
    origin = _origin(joint, rows)
    if policy.form == ANCHOR:
        near = np.abs(joint.positions[rows] - origin) <= OFFSET_LIMIT_M
        rows = rows[near.all(axis=1)]
    columns = landmark_rows(POSE_DIM, rows)
    points, scale = _code(policy.form, joint.positions[rows] - origin, P[np.ix_(columns, columns)])
    packet = LandmarkPacket(
        stamp_ns=joint.stamp_ns,
        vehicle=joint.vehicle,
        session=joint.session,
        sequence=sequence,
        sources=joint.sources,
        prior_id=prior_id,
        ids=joint.ids[rows],
        origin=origin,
        points=points,
        covariance_scale=scale,
        descriptor_basis=policy.descriptor_basis,
        descriptors=codes[rows],
        checksum=0,
    )
    return dataclasses.replace(packet, checksum=checksum(packet))


def _code(form: str, offsets: Array, P: Array) -> tuple[CodedPoints, float]:
    return code_anchored(offsets, P) if form == ANCHOR else code_dense(offsets, P)


def _origin(joint: JointInformation, rows: NDArray[np.intp]) -> NDArray[np.int32]:
    """Return the median of the chosen landmarks [m], robust to a single far one."""
    middle = np.median(joint.positions[rows], axis=0) if len(rows) else joint.T_map_body.t
    return np.clip(np.round(middle), INT32.min, INT32.max).astype(np.int32)


def _max_landmarks(
    joint: JointInformation, policy: PacketPolicy, descriptor_size: int, prior_id: str, byte_limit: int | None
) -> int:
    """Return the number of landmarks that count limit, byte limits and estimate allow."""
    count = min(policy.max_landmarks, len(joint.ids))
    limits = [limit for limit in (policy.max_bytes, byte_limit) if limit is not None]

    def size(landmarks: int) -> int:
        return payload_size(
            landmarks,
            anchored=policy.form == ANCHOR,
            vehicle=joint.vehicle,
            sources=joint.sources[1:],
            prior_id=prior_id,
            descriptor_size=descriptor_size,
            tag_size=policy.tag_bytes,
        )

    while limits and count > 0 and size(count) > min(limits):
        count -= 1
    return count
