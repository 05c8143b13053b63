# SPDX-License-Identifier: Apache-2.0
"""Stereo observations of points as least squares [triggs00], the points eliminated by Schur complement.

An observation is z = h(c) + a (0, b) + s m + a noise: c the point in the left camera frame, a by how much undistortion
magnifies errors, b an offset of the right image that is common to all observations of one point (the right image is
matched to one patch as long as that is tracked), and s the drift of the tracked patch with the distance m that its
image has moved (it is seen from another direction). A point's unknowns are y = (position, b, s), seven of them. With J
the Jacobian by the pose (position, xi), K by y and r the residual, all divided by the noise, elimination leaves for the
poses i and j of a point

    H_ij = [i = j] sum J' J - E_i E_j',   g_i = sum J' r - E_i e,   E = J' K L^-T,   e = L^-1 K' r,   L L' = sum K' K.

The E of points that start close together are the columns of one matrix A, and the sum is one A A'. The constant errors
of the rig, seen by all observations, are border variables with a Jacobian and an F of their own.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.smoothing.arrowhead import Arrowhead
from uav_vslam.smoothing.cameras import Cameras, PixelNoise
from uav_vslam.smoothing.layout import Layout
from uav_vslam.smoothing.sightings import Rows, Sightings

Array = NDArray[np.float64]

POINT_DIM = 7
FAINT_INFORMATION = 1e-8  # of each coordinate of a point, 10 km: an outlier may look infinitely far away [1/m^2]
GROUPS = 6  # of the points that start in a block: more are smaller products, but more of them
HUBER = 3.0  # length of the normalised residual, of 4 pixel coordinates, beyond which it counts linearly [huber64]


@dataclass(frozen=True, slots=True)
class Linearised:
    """Observations at an estimate, divided by their noise and robustly weighted.

    Attributes:
        residual: (M, 4).
        by_pose: (M, 4, 6 or 9), by_point: (M, 4, 7), by_rig: (M, 4, dim).
        misfit: (M,) squared length of the residual before the weight.
    """

    residual: Array
    by_pose: Array
    by_point: Array
    by_rig: Array
    misfit: Array


def linearise(sightings: Sightings, cameras: Cameras, points: Array, noise: PixelNoise) -> Linearised:
    """Linearise at the points' unknowns (P, 7)."""
    own = points[sightings.points]
    seen = cameras.observe(sightings.states, own[:, :3])
    far = _image_motion(sightings)
    expected = seen.expected + own[:, [5, 6, 5, 6]] * far[:, None]
    magnified = cameras.rig.magnification(sightings.pixels)[:, None]
    expected[:, 2:] += magnified * own[:, 3:5]
    white_px = magnified * noise.white_px
    residual = (sightings.pixels - expected) / white_px
    misfit = np.einsum("mi,mi->m", residual, residual)
    weight = np.sqrt(np.minimum(1.0, HUBER / np.sqrt(np.maximum(misfit, 1e-12)))) * (misfit <= noise.cut**2)
    scale = weight[:, None] / white_px
    by_point = np.zeros((len(own), 4, POINT_DIM))
    by_point[:, :, :3] = seen.by_point
    by_point[:, 2, 3] = by_point[:, 3, 4] = magnified[:, 0]
    by_point[:, [0, 2], 5] = by_point[:, [1, 3], 6] = far[:, None]
    by_pose, by_point, by_rig = (scale[..., None] * J for J in (seen.by_pose, by_point, seen.by_rig))
    return Linearised(weight[:, None] * residual, by_pose, by_point, by_rig, misfit)


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
    """Points as functions of the rest: y = L^-T (e - sum E' d(pose) - F' d(rig) - T' d(landmark)).

    Attributes:
        states, points: (M,) of each observation; points count from zero here.
        E: (M, 6 or 9, 7).
        F: (P, dim, 7).
        e: (P, 7).
        L_inverse: (P, 7, 7).
        tie: (P, 3, 7) T; zero but for points that show a revisited landmark.
    """

    states: Rows
    points: Rows
    E: Array
    F: Array
    e: Array
    L_inverse: Array
    tie: Array

    def corrections(self, pose_steps: Array, rig_step: Array, landmark_steps: Array) -> Array:
        """Return (P, 7) corrections for those of poses (N, 6 or 9), rig (dim,) and each point's own landmark (P, 3)."""
        by_poses = np.einsum("mik,mi->mk", self.E, pose_steps[self.states])
        rest = self.e - _summed(by_poses, self.points, len(self.e))
        rest -= np.einsum("pik,i->pk", self.F, rig_step) + np.einsum("pik,pi->pk", self.tie, landmark_steps)
        return np.einsum("pki,pk->pi", self.L_inverse, rest)


def eliminate(sightings: Sightings, view: Linearised, points: Array, noise: PixelNoise, ties: Ties) -> Eliminated:
    """Eliminate the points from their observations and from what ties them to revisited landmarks."""
    count = len(points)
    own = sightings.points
    H = _summed(_products(view.by_point, view.by_point), own, count)
    g = _summed(np.einsum("mki,mk->mi", view.by_point, view.residual), own, count)
    own_rows = np.arange(3, POINT_DIM)
    H[:, own_rows, own_rows] += noise.prior_information
    g[:, 3:] -= points[:, 3:] * noise.prior_information
    H[:, :3, :3] += (FAINT_INFORMATION + ties.information)[:, None, None] * np.eye(3)
    g[:, :3] += ties.pull
    L_inverse = np.linalg.inv(np.linalg.cholesky(H))
    E = _products(view.by_pose, view.by_point) @ np.swapaxes(L_inverse, 1, 2)[own]
    by_rig = _summed(_products(view.by_rig, view.by_point), own, count)
    F = by_rig @ np.swapaxes(L_inverse, 1, 2)
    e = np.einsum("pij,pj->pi", L_inverse, g)
    tie = np.zeros((count, 3, POINT_DIM))
    tie[:] = -ties.information[:, None, None] * np.swapaxes(L_inverse, 1, 2)[:, :3]
    return Eliminated(sightings.states, own, E, F, e, L_inverse, tie)


def add_views(system: Arrowhead, layout: Layout, block: int, view: Linearised, points: Eliminated, ties: Ties) -> None:
    """Add points that start in `block` and end in the next one at the latest."""
    states, window, own = points.states - block * layout.size, 2 * layout.size, points.points
    H = _between_states(points, states, window)
    dim = view.by_pose.shape[2]
    diagonal = H.reshape(window, dim, window, dim)
    diagonal[np.arange(window), :, np.arange(window)] += _by_state(
        _products(view.by_pose, view.by_pose), states, window
    )
    pull = _products(view.by_pose, view.residual[:, :, None]) - points.E @ points.e[own, :, None]
    with_rig = _products(view.by_pose, view.by_rig) - points.E @ np.swapaxes(points.F, 1, 2)[own]
    g, with_rig = (_by_state(each, states, window).reshape(window * dim, -1) for each in (pull, with_rig))
    _add_window(system, layout, block, H, g[:, 0], with_rig)
    rig, F = slice(0, layout.rig), points.F
    system.border[rig, rig] += _products(view.by_rig, view.by_rig).sum(axis=0) - np.einsum("pik,pjk->ij", F, F)
    system.border_rhs[rig] += np.einsum("mki,mk->i", view.by_rig, view.residual) - np.einsum("pik,pk->i", F, points.e)
    for point in np.flatnonzero(ties.rows >= 0).tolist():
        A = np.zeros((window, dim, POINT_DIM))
        A[states[own == point]] = points.E[own == point]
        _add_tie(system, layout, block, A.reshape(-1, POINT_DIM), points, ties, point)


def _between_states(points: Eliminated, states: Rows, window: int) -> Array:
    """Return -A A' over the states of a window: in groups of points, which are in order and each see a part of it."""
    dim = points.E.shape[1]
    H = np.zeros((window * dim, window * dim))
    for group in np.array_split(np.arange(len(points.e)), GROUPS):
        if len(group) == 0:
            continue
        seen = slice(*np.searchsorted(points.points, [group[0], group[-1] + 1]).tolist())
        first, last = int(states[seen].min()), int(states[seen].max()) + 1
        columns = np.zeros((last - first, dim, len(group), POINT_DIM))
        columns[states[seen] - first, :, points.points[seen] - group[0]] = points.E[seen]
        A = columns.reshape((last - first) * dim, len(group) * POINT_DIM)
        rows = slice(first * dim, last * dim)
        H[rows, rows] -= A @ A.T
    return H


def _add_window(system: Arrowhead, layout: Layout, block: int, H: Array, g: Array, with_rig: Array) -> None:
    """Add the normal equations of what the cameras see of the states of two blocks."""
    rows, half = layout.seen_of_block, len(layout.seen_of_block)
    rig = slice(0, layout.rig)
    system.diagonal[block][np.ix_(rows, rows)] += H[:half, :half]
    system.rhs[block, rows] += g[:half]
    system.coupling[block, rows, rig] += with_rig[:half]
    if block + 1 < layout.blocks:
        system.below[block][np.ix_(rows, rows)] += H[half:, :half]
        system.diagonal[block + 1][np.ix_(rows, rows)] += H[half:, half:]
        system.rhs[block + 1, rows] += g[half:]
        system.coupling[block + 1, rows, rig] += with_rig[half:]


def _add_tie(
    system: Arrowhead, layout: Layout, block: int, A: Array, points: Eliminated, ties: Ties, point: int
) -> None:
    """Add what one point says about the revisited landmark that it shows; A (rows of two blocks, 7) is the point's."""
    rows, half = layout.seen_of_block, len(layout.seen_of_block)
    border, tie = layout.landmark(ties.rows[point]), points.tie[point]
    cross = -A @ tie.T
    system.coupling[block, rows, border] += cross[:half]
    if block + 1 < layout.blocks:
        system.coupling[block + 1, rows, border] += cross[half:]
    with_rig = -points.F[point] @ tie.T
    system.border[: layout.rig, border] += with_rig
    system.border[border, : layout.rig] += with_rig.T
    system.border[border, border] += ties.information[point] * np.eye(3) - tie @ tie.T
    system.border_rhs[border] -= ties.pull[point] + tie @ points.e[point]


def _products(left: Array, right: Array) -> Array:
    """Return (M, i, j) left' right of (M, 4, i) and (M, 4, j)."""
    return np.asarray(np.swapaxes(left, 1, 2) @ right)


def _by_state(values: Array, states: Rows, window: int) -> Array:
    """Return (window, ...) sums of the values of each state."""
    total = np.zeros((window, *values.shape[1:]))
    np.add.at(total, states, values)
    return total


def _image_motion(sightings: Sightings) -> Array:
    """Return (M,) distance of each left image point from where its track began [px]."""
    left = sightings.pixels[:, :2]
    return np.asarray(np.linalg.norm(left - left[sightings.starts][sightings.points], axis=1))


def _summed(values: Array, rows: Rows, count: int) -> Array:
    """Return (count, ...) sums of the values of each row; `rows` ascend and each occurs."""
    if count == 0:
        return np.zeros((0, *values.shape[1:]))
    return np.asarray(np.add.reduceat(values, np.searchsorted(rows, np.arange(count)), axis=0))
