# SPDX-License-Identifier: Apache-2.0
"""Landmark selection for packets: shared landmarks first by expected gain, and the others in turn."""

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.coded_points import diagonal_blocks
from uav_vslam.geometry.image_grid import ground_plan, spread
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.types import JointInformation

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


def expected_gain(P: Array) -> Array:
    """Return the (N,) information a peer gains from each landmark, 1/2 log det(I + P_i^-1 P_pos) [nat].

    The peer is assumed to be as uncertain of the landmark as this vehicle is of its own position.

    Args:
        P: (6+3N, 6+3N) covariance of position, rotation and landmarks.
    """
    own = diagonal_blocks(P[POSE_DIM:, POSE_DIM:])
    return np.asarray(0.5 * (np.linalg.slogdet(own + P[:3, :3])[1] - np.linalg.slogdet(own)[1]))


def choose_landmarks(
    joint: JointInformation,
    gain: Array,
    count: int,
    *,
    matched_ids: Collection[int],
    times_sent: Mapping[int, int],
    offered: int = 0,
) -> Rows:
    """Return at most `count` ascending rows.

    Landmarks known to be shared with a peer go first, by gain within each ground cell. The rest goes to those sent
    least often, newest first: peers nearby see the same ground now, and probably lack landmarks that were sent
    without a match.

    Args:
        joint: the estimate.
        gain: (N,) expected gain of each landmark.
        count: largest number to return.
        matched_ids: landmarks found to be shared with a peer.
        times_sent: how often landmarks were sent, by identifier; missing ones never were.
        offered: number of landmarks not known to be shared to leave room for, in half of `count` at most.
    """
    plan, size = ground_plan(joint.positions)
    matched = np.isin(joint.ids, np.fromiter(matched_ids, np.uint32, len(matched_ids)))
    by_gain = np.argsort(-gain, kind="stable")
    first = by_gain[matched[by_gain]]
    others = np.flatnonzero(~matched)
    room = min(offered, count // 2, len(others))
    first = first[spread(plan[first], count - room, size=size)]
    times = np.array([times_sent.get(landmark, 0) for landmark in joint.ids[others].tolist()], np.intp)
    in_turn = others[np.lexsort((-joint.ids[others].astype(np.int64), times))]
    return np.sort(np.concatenate([first, in_turn[: count - len(first)]]))
