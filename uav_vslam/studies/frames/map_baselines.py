# SPDX-License-Identifier: Apache-2.0
"""The transform between two estimated maps, by the true identities of their landmarks: the reference for an
alignment.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.cooperation.alignment import fit
from uav_vslam.cooperation.point_pairs import PointPairs
from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.evaluation.alignment import align_yaw
from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.studies.engine.association_stages import Identities
from uav_vslam.types import JointInformation

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]


def common_rows(own: JointInformation, peer: JointInformation, truth: Identities) -> Pairs:
    """Return the (K, 2) rows of all landmarks that two maps truly share."""
    names = [truth.own[k] for k in own.ids.tolist()], [truth.peer[k] for k in peer.ids.tolist()]
    _, a, b = np.intersect1d(*names, return_indices=True)
    return np.column_stack([a, b])


def map_to_map(own: JointInformation, peer: JointInformation, truth: Identities) -> tuple[Pose, Array]:
    """Return the T_own_peer that fits two maps best, and the (3,) centre of what they share in the peer's frame [m].

    It minimises the unweighted sum of squared distances of all landmarks that both hold. So it includes the maps'
    drift, and does not depend on the alignment that is tested.
    """
    a, b = common_rows(own, peer, truth).T
    return align_yaw(peer.positions[b], own.positions[a]), peer.positions[b].mean(axis=0)


def weighted_map_to_map(own: JointInformation, peer: JointInformation, truth: Identities, floor_sigma_m: float) -> Pose:
    """Return the T_own_peer that fits all landmarks that two maps share best by the covariances of both."""
    pairs = common_rows(own, peer, truth)
    P, R = (joint.covariance[POSE_DIM:, POSE_DIM:] for joint in (own, peer))
    a, b = (landmark_rows(0, rows) for rows in pairs.T)
    points = PointPairs(
        own.positions[pairs[:, 0]], peer.positions[pairs[:, 1]], P[np.ix_(a, a)], R[np.ix_(b, b)], floor_sigma_m
    )
    return fit(points, map_to_map(own, peer, truth)[0])[0]


def alignment_error(T_own_peer: Pose, T_true: Pose, centre: Array) -> tuple[float, float]:
    """Return the distance at a point of the peer's map [m], and the turn [deg]."""
    turn = so3_log(T_own_peer.R.T @ T_true.R)[2]
    return float(np.linalg.norm(T_own_peer.apply(centre) - T_true.apply(centre))), float(np.rad2deg(abs(turn)))
