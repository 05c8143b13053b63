# SPDX-License-Identifier: Apache-2.0
"""Stereo observations of points as least squares [triggs00], the points eliminated by Schur complement.

An observation is z = h(c) + (0, b) + s m + noise: c the point in the left camera frame, b an offset of the right
image that is common to all observations of one point (the right image is matched to one patch as long as that is
tracked), and s the drift of the tracked patch with the distance m that its image has moved (it is seen from another
direction). A point's unknowns are y = (position, b, s), seven of them. With J the Jacobian by the pose (position, xi),
K by y and r the residual, all divided by the noise, elimination leaves for the poses i and j of a point

    H_ij = [i = j] sum J' J - E_i E_j',   g_i = sum J' r - E_i e,   E = J' K L^-T,   e = L^-1 K' r,   L L' = sum K' K.

The E of all points that start in one block of the chain are the columns of one matrix A, and the sum is one A A'.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.observation import MIN_DEPTH_M
from uav_vslam.geometry.rotation import skew
from uav_vslam.ins.propagation import NAV_DIM
from uav_vslam.smoothing.arrowhead import Arrowhead
from uav_vslam.smoothing.cameras import Cameras, PixelNoise
from uav_vslam.smoothing.sightings import Rows, Sightings

Array = NDArray[np.float64]

POSE_DIM, POINT_DIM = 6, 7
HUBER = 3.0  # length of the normalised residual, of 4 pixel coordinates, beyond which it counts linearly [huber64]


@dataclass(frozen=True, slots=True)
class Linearised:
    """Observations at an estimate, divided by their noise and robustly weighted.

    Attributes:
        residual: (M, 4).
        by_pose: (M, 4, 6), by_point: (M, 4, 7).
        misfit: (M,) squared length of the residual before the weight.
    """

    residual: Array
    by_pose: Array
    by_point: Array
    misfit: Array


def linearise(sightings: Sightings, cameras: Cameras, points: Array, noise: PixelNoise) -> Linearised:
    """Linearise at the points' unknowns (P, 7)."""
    own, states = points[sightings.points], sightings.states
    c = cameras.points_left(states, own[:, :3])
    c[:, 2] = np.maximum(c[:, 2], MIN_DEPTH_M)  # one that slips behind the camera is an outlier
    expected = cameras.rig.project(c)
    far = _image_motion(sightings)
    expected += own[:, [5, 6, 5, 6]] * far[:, None]
    expected[:, 2:] += own[:, 3:5]
    residual = (sightings.pixels - expected) / noise.white_px
    misfit = np.einsum("mi,mi->m", residual, residual)
    weight = np.sqrt(np.minimum(1.0, HUBER / np.sqrt(np.maximum(misfit, 1e-12))))
    scale = weight / noise.white_px
    by_point = np.zeros((len(states), 4, POINT_DIM))
    by_point[:, :, :3] = scale[:, None, None] * (cameras.rig.project_jacobian(c) @ cameras.R_left_map[states])
    by_point[:, 2, 3] = by_point[:, 3, 4] = scale
    by_point[:, [0, 2], 5] = by_point[:, [1, 3], 6] = (scale * far)[:, None]
    arms = own[:, :3] - cameras.positions[states]
    by_pose = np.concatenate([-by_point[:, :, :3], by_point[:, :, :3] @ skew(arms)], axis=2)
    return Linearised(weight[:, None] * residual, by_pose, by_point, misfit)


@dataclass(frozen=True, slots=True)
class Ties:
    """What ties points to revisited landmarks.

    Attributes:
        rows: (P,) the landmark of each point, -1 for none.
        information: (P,) inverse variance of the distance between them, per axis; zero for none [1/m^2].
        pull: (P, 3) landmark minus point, times the information; zero for none [1/m].
    """

    rows: Rows
    information: Array
    pull: Array


@dataclass(frozen=True, slots=True)
class Eliminated:
    """Points that are functions of poses and landmarks: y = L^-T (e - sum E' d(pose) - T' d(landmark)).

    Attributes:
        states, points: (M,) of each observation; points count from zero here.
        E: (M, 6, 7).
        e: (P, 7).
        L_inverse: (P, 7, 7).
        tie: (P, 3, 7) T; zero but for points that show a revisited landmark.
    """

    states: Rows
    points: Rows
    E: Array
    e: Array
    L_inverse: Array
    tie: Array

    def corrections(self, pose_steps: Array, landmark_steps: Array) -> Array:
        """Return (P, 7) corrections for those of the poses (N, 6) and of each point's own landmark (P, 3)."""
        by_poses = np.einsum("mik,mi->mk", self.E, pose_steps[self.states])
        rest = self.e - _summed(by_poses, self.points, len(self.e))
        rest -= np.einsum("pik,pi->pk", self.tie, landmark_steps)
        return np.einsum("pki,pk->pi", self.L_inverse, rest)


def eliminate(sightings: Sightings, view: Linearised, points: Array, noise: PixelNoise, ties: Ties) -> Eliminated:
    """Eliminate the points from their observations and from what ties them to revisited landmarks."""
    count = len(points)
    own = sightings.points
    H = _summed(np.einsum("mki,mkj->mij", view.by_point, view.by_point), own, count)
    g = _summed(np.einsum("mki,mk->mi", view.by_point, view.residual), own, count)
    own_rows = np.arange(3, POINT_DIM)
    H[:, own_rows, own_rows] += noise.prior_information
    g[:, 3:] -= points[:, 3:] * noise.prior_information
    H[:, :3, :3] += ties.information[:, None, None] * np.eye(3)
    g[:, :3] += ties.pull
    L_inverse = np.linalg.inv(np.linalg.cholesky(H))
    cross = np.einsum("mki,mkj->mij", view.by_pose, view.by_point)
    E = cross @ np.swapaxes(L_inverse, 1, 2)[own]
    e = np.einsum("pij,pj->pi", L_inverse, g)
    tie = np.zeros((count, 3, POINT_DIM))
    tie[:] = -ties.information[:, None, None] * np.swapaxes(L_inverse, 1, 2)[:, :3]
    return Eliminated(sightings.states, own, E, e, L_inverse, tie)


def add_views(system: Arrowhead, block: int, view: Linearised, points: Eliminated, ties: Ties) -> None:
    """Add points that start in `block` and end in the next one at the latest."""
    size = system.diagonal.shape[1] // NAV_DIM
    states = points.states - block * size
    H = np.zeros((2 * size, POSE_DIM, POSE_DIM))
    g = np.zeros((2 * size, POSE_DIM))
    np.add.at(H, states, np.einsum("mki,mkj->mij", view.by_pose, view.by_pose))
    np.add.at(g, states, np.einsum("mki,mk->mi", view.by_pose, view.residual))
    np.add.at(g, states, -np.einsum("mij,mj->mi", points.E, points.e[points.points]))
    A = np.zeros((2 * size, POSE_DIM, len(points.e), POINT_DIM))
    A[states, :, points.points] = points.E
    A = A.reshape(2 * size * POSE_DIM, -1)
    dense = -(A @ A.T)
    for k in range(2 * size):
        own = slice(k * POSE_DIM, (k + 1) * POSE_DIM)
        dense[own, own] += H[k]
    rows = _pose_rows(size)
    half = size * POSE_DIM
    system.diagonal[block][np.ix_(rows, rows)] += dense[:half, :half]
    system.rhs[block, rows] += g[:size].ravel()
    if block + 1 < len(system.diagonal):
        system.below[block][np.ix_(rows, rows)] += dense[half:, :half]
        system.diagonal[block + 1][np.ix_(rows, rows)] += dense[half:, half:]
        system.rhs[block + 1, rows] += g[size:].ravel()
    tied = np.flatnonzero(ties.rows >= 0)
    if len(tied):
        _add_ties(system, block, A, points, ties, tied)


def _add_ties(system: Arrowhead, block: int, A: Array, points: Eliminated, ties: Ties, tied: Rows) -> None:
    """Add what the points of revisited landmarks say about those."""
    size = system.diagonal.shape[1] // NAV_DIM
    rows, half = _pose_rows(size), size * POSE_DIM
    columns = A.reshape(2 * half, len(points.e), POINT_DIM)
    for point in tied.tolist():
        border, tie = slice(3 * ties.rows[point], 3 * ties.rows[point] + 3), points.tie[point]
        cross = -columns[:, point] @ tie.T
        system.coupling[block, rows, border] += cross[:half]
        if block + 1 < len(system.diagonal):
            system.coupling[block + 1, rows, border] += cross[half:]
        system.border[border, border] += ties.information[point] * np.eye(3) - tie @ tie.T
        system.border_rhs[border] -= ties.pull[point] + tie @ points.e[point]


def _image_motion(sightings: Sightings) -> Array:
    """Return (M,) distance of each left image point from where its track began [px]."""
    left = sightings.pixels[:, :2]
    return np.asarray(np.linalg.norm(left - left[sightings.starts][sightings.points], axis=1))


def _pose_rows(size: int) -> Rows:
    """Return the rows of position and attitude in a block of states."""
    return np.asarray((NAV_DIM * np.arange(size)[:, None] + [0, 1, 2, 6, 7, 8]).ravel())


def _summed(values: Array, rows: Rows, count: int) -> Array:
    """Return (count, ...) sums of the values of each row; `rows` ascend and each occurs."""
    if count == 0:
        return np.zeros((0, *values.shape[1:]))
    return np.asarray(np.add.reduceat(values, np.searchsorted(rows, np.arange(count)), axis=0))
