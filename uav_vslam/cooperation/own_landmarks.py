# SPDX-License-Identifier: Apache-2.0
"""The landmarks of the own map, as a peer's are associated with them."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.numerics import marginalise_information
from uav_vslam.types import JointInformation

Array = NDArray[np.float64]

LOOSE = 0.1  # sigma of a landmark's distance over that distance, beyond which its error is not Gaussian


@dataclass(frozen=True, slots=True)
class OwnLandmarks:
    """Position, uncertainty and appearance of N landmarks.

    Attributes:
        positions: (N, 3) in the own map frame [m].
        covariance: (3N, 3N) joint covariance [m^2].
        descriptors: (N, D) as extracted; whoever compares them compresses them with the peer's basis.
    """

    positions: Array
    covariance: Array
    descriptors: NDArray[np.uint8]

    @staticmethod
    def of(joint: JointInformation) -> "OwnLandmarks":
        """Return the landmarks of a belief."""
        return OwnLandmarks(joint.positions, joint.covariance[POSE_DIM:, POSE_DIM:], joint.descriptors)

    def __len__(self) -> int:
        return len(self.positions)


def well_ranged(joint: JointInformation) -> JointInformation:
    """Return a belief without the landmarks whose distance is hardly known, as after a single view.

    The error of 1 / disparity is skewed: it shifts the mean distance by the square of its relative sigma and has a long
    tail. The vehicle's own pose hardly depends on such a landmark, but one that a peer has too would correct its tilt.
    What counts is the landmark's error given all the others: drift, which they share, is not skewed.
    """
    arm, Y = joint.positions - joint.T_map_body.t, joint.information
    own = landmark_rows(POSE_DIM, np.arange(len(arm))).reshape(-1, 3)
    given_others = np.linalg.inv(Y[own[:, :, None], own[:, None, :]])
    along = np.einsum("ni,nij,nj->n", arm, given_others, arm)  # variance of the distance, times its square
    loose = along > LOOSE**2 * np.sum(arm**2, axis=1) ** 2
    if not loose.any():
        return joint
    keep, gone = np.concatenate([np.arange(POSE_DIM), own[~loose].ravel()]), own[loose].ravel()
    return dataclasses.replace(
        joint,
        ids=joint.ids[~loose],
        positions=joint.positions[~loose],
        information=marginalise_information(Y, keep, gone, "information of loose landmarks"),
        descriptors=joint.descriptors[~loose],
    )
