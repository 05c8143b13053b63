# SPDX-License-Identifier: Apache-2.0
"""The landmark information packet: made from the sender's belief, checked by the receiver.

The sender marginalises its pose (the joint covariance of the chosen landmarks is kept whole), rounds the Cholesky
factor to float32, and inflates until R, the covariance as it is coded, bounds the exact one: `lambda_max(R^-1 P) <= 1`
makes `R - P` positive semidefinite, so no receiver is told more than the sender knows.
"""

import dataclasses
import struct
import zlib
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from uav_vslam.errors import InvalidMessage
from uav_vslam.estimation.numerics import cholesky, inverse_spd, symmetrise
from uav_vslam.geometry.image_grid import spread
from uav_vslam.types import JointInformation, LandmarkPacket

Array = NDArray[np.float64]

POSE_DIM = 6
MAX_LANDMARKS = 1000  # a packet that claims more is not believed
MAX_SIGMA_M = 1e5  # nor one that knows so little: such numbers would only break the receiver's algebra
EIGENVALUE_MARGIN = 1e-9  # error of the computed largest eigenvalue
INFLATION_STEP = 2.4e-7  # the least that changes a float32 factor
HEADER_BYTES = 120  # fixed part with CDR lengths and padding; sources and strings come on top


def make_packet(
    joint: JointInformation,
    *,
    sequence: int,
    max_landmarks: int,
    matched_ids: Collection[int] = (),
    prior_id: str = "",
) -> LandmarkPacket:
    """Choose landmarks and code their joint marginal.

    Args:
        joint: the sender's belief.
        sequence: number of the packet within the session.
        max_landmarks: how many at most.
        matched_ids: landmarks that a peer was found to share; they go first.
        prior_id: hash of a loaded map or shared survey behind the belief.
    """
    rows = choose_landmarks(joint, max_landmarks, matched_ids=matched_ids, sequence=sequence)
    columns = (POSE_DIM + 3 * rows[:, None] + np.arange(3)).ravel()
    origin = np.round(joint.T_map_body.t)
    P = inverse_spd(joint.information, "joint information")
    factor, scale = code_covariance(P[np.ix_(columns, columns)])
    packet = LandmarkPacket(
        stamp_ns=joint.stamp_ns,
        vehicle=joint.vehicle,
        session=joint.session,
        sequence=sequence,
        sources=(f"{joint.vehicle}/{joint.session}",),
        prior_id=prior_id,
        ids=joint.ids[rows],
        origin=origin,
        offsets=(joint.positions[rows] - origin).astype(np.float32),
        covariance_factor=factor,
        covariance_scale=scale,
        descriptors=joint.descriptors[rows],
        checksum=0,
    )
    return dataclasses.replace(packet, checksum=checksum(packet))


def choose_landmarks(
    joint: JointInformation, count: int, *, matched_ids: Collection[int], sequence: int
) -> NDArray[np.intp]:
    """Return at most `count` ascending rows: shared landmarks, spread over the ground, then the others in turn.

    Each packet offers another share of the others, so that over time a peer is shown all of them.
    """
    matched = np.isin(joint.ids, np.fromiter(matched_ids, np.uint32, len(matched_ids)))
    first, others = np.flatnonzero(matched), np.flatnonzero(~matched)
    first = first[_spread_on_ground(joint.positions[first], count)]
    room = count - len(first)
    turn = np.roll(others, -sequence * room)[: max(room, 0)]
    return np.sort(np.concatenate([first, turn]))


def _spread_on_ground(positions: Array, count: int) -> NDArray[np.intp]:
    if len(positions) <= count:
        return np.arange(len(positions))
    plan = positions[:, :2] - positions[:, :2].min(axis=0)
    extent = np.maximum(plan.max(axis=0), 1e-3)
    return spread(plan, count, size=(float(extent[0]), float(extent[1])))


def code_covariance(P: Array) -> tuple[NDArray[np.float32], float]:
    """Return the packed float32 Cholesky factor of a bound of P (n, n), and the factor s >= 1 by which it bounds."""
    if len(P) == 0:
        return np.zeros(0, np.float32), 1.0
    tril = np.tril_indices(len(P))
    exact = cholesky(symmetrise(P), "covariance of a packet")
    coded, scale = np.zeros_like(P), 1.0
    while True:
        coded[tril] = (np.sqrt(scale) * exact[tril]).astype(np.float32)
        half = solve_triangular(coded, P, lower=True)
        largest = float(np.linalg.eigvalsh(solve_triangular(coded, half.T, lower=True))[-1])
        if largest <= 1.0 - EIGENVALUE_MARGIN:
            return coded[tril].astype(np.float32), scale
        scale *= 1.0 + 2.0 * max(largest - 1.0, 0.0) + INFLATION_STEP  # the next rounding errs as much as this one


def checksum(packet: LandmarkPacket) -> int:
    """Return the CRC-32 over every field but the checksum itself."""
    text = "\0".join([packet.vehicle, *packet.sources, packet.prior_id]).encode()
    crc = zlib.crc32(struct.pack("<qQId", packet.stamp_ns, packet.session, packet.sequence, packet.covariance_scale))
    arrays = (packet.ids, packet.origin, packet.offsets, packet.covariance_factor, packet.descriptors)
    for data in (text, *(np.ascontiguousarray(a).tobytes() for a in arrays)):
        crc = zlib.crc32(data, crc)
    return crc


def payload_bytes(packet: LandmarkPacket) -> int:
    """Return the size of the packet as DDS carries it, to within padding [bytes]."""
    text = sum(len(s) + 5 for s in (packet.vehicle, packet.prior_id, *packet.sources))
    arrays = packet.ids.nbytes + packet.offsets.nbytes + packet.covariance_factor.nbytes + packet.descriptors.nbytes
    return HEADER_BYTES + text + arrays


def validate(packet: LandmarkPacket) -> None:
    """Check everything a receiver relies on.

    Raises:
        InvalidMessage: with reason shape, checksum, sources, not_finite, covariance or duplicate_id.
    """
    n = len(packet.ids)
    if not n <= MAX_LANDMARKS:
        raise InvalidMessage("shape", f"{n} landmarks; at most {MAX_LANDMARKS} are accepted")
    if (
        packet.origin.shape != (3,)
        or packet.offsets.shape != (n, 3)
        or packet.covariance_factor.shape != (3 * n * (3 * n + 1) // 2,)
    ):
        raise InvalidMessage(
            "shape", f"{n} ids, offsets {packet.offsets.shape}, factor {packet.covariance_factor.shape} don't fit"
        )
    if packet.descriptors.ndim != 2 or len(packet.descriptors) != n:
        raise InvalidMessage("shape", f"{n} ids but descriptors {packet.descriptors.shape}")
    if checksum(packet) != packet.checksum:
        raise InvalidMessage("checksum", f"packet {packet.sequence} of {packet.source} was damaged on its way")
    if packet.source not in packet.sources:
        raise InvalidMessage("sources", f"packet {packet.sequence} of {packet.source} does not name its own sender")
    numbers = (packet.origin, packet.offsets, packet.covariance_factor, packet.covariance_scale)
    if not all(np.isfinite(a).all() for a in numbers):
        raise InvalidMessage("not_finite", f"packet {packet.sequence} of {packet.source} holds NaN or infinity")
    diagonal = packet.covariance_factor[np.cumsum(np.arange(1, 3 * n + 1)) - 1]
    if not (diagonal > 0).all() or not packet.covariance_scale >= 1:
        raise InvalidMessage("covariance", f"packet {packet.sequence} of {packet.source} is not positive definite")
    if not (np.abs(packet.covariance_factor) <= MAX_SIGMA_M).all():
        raise InvalidMessage(
            "covariance", f"packet {packet.sequence} of {packet.source} doubts by over {MAX_SIGMA_M} m"
        )
    if len(np.unique(packet.ids)) != n:
        raise InvalidMessage("duplicate_id", f"packet {packet.sequence} of {packet.source} repeats a landmark")
