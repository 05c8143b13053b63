# SPDX-License-Identifier: Apache-2.0
"""Least squares over a stereo rig and the poses of a board in its image pairs.

The parameters: fx, fy, cx, cy and the coefficients of the left camera, the same of the right one, the pose of the left
camera in the right one, and the pose of the board in the left camera for each pair; poses as rotation vector and
translation. The residuals: measured minus predicted pixels of all left corners, then of all right ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from uav_vslam.calibration.boards import Corners
from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.camera import COEFFICIENTS, PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import SIDES, StereoRig

Array = NDArray[np.float64]
Columns = NDArray[np.intp]

LINEAR = 4  # fx, fy, cx, cy
POSE = 6
DIFFERENCE = 1e-7  # relative step of the forward differences
# Relative to the diagonal of the normal matrix; the least keeps coefficients that nearly cancel from going astray.
FIRST_DAMPING, DAMPING_STEP, LEAST_DAMPING, MOST_DAMPING = 1e-3, 10.0, 1e-10, 1e6
LEAST_EIGENVALUE = 1e-13  # of the scaled normal matrix: what is less well determined has no smaller variance
MOST_STEPS = 100
LEAST_GAIN = 1e-10  # relative, of the cost, in the last step


@dataclass(frozen=True, slots=True)
class BoardPair:
    """A board seen by both cameras at once.

    Attributes:
        name: of the pair, for people.
        left, right: corners; they need not be the same ones.
    """

    name: str
    left: Corners
    right: Corners


class Bundle:
    """The problem for given pairs: packs its parameters, predicts pixels, refines.

    Attributes:
        intrinsics: number of parameters of one camera.
        shared: number of parameters that all pairs share, which come first.
    """

    def __init__(self, pairs: Sequence[BoardPair], size: tuple[int, int], model: str) -> None:
        """Set up.

        Args:
            pairs: corners.
            size: width and height of the images [px].
            model: distortion model of both cameras.
        """
        self._size, self._model = size, model
        self.intrinsics = LINEAR + COEFFICIENTS[model]
        self.shared = 2 * self.intrinsics + POSE
        seen = [[getattr(pair, side) for pair in pairs] for side in SIDES]
        self._counts = [[len(corners.pixels) for corners in side] for side in seen]
        self._pair = [np.repeat(np.arange(len(pairs)), counts) for counts in self._counts]
        of_rows = np.repeat(np.concatenate(self._pair), 2)
        self._rows = [np.flatnonzero(of_rows == k) for k in range(len(pairs))]
        self._points_board = [np.concatenate([corners.points_board for corners in side]) for side in seen]
        self._pixels = [np.concatenate([corners.pixels for corners in side]) for side in seen]

    def pack(self, rig: StereoRig, T_left_boards: Sequence[Pose]) -> Array:
        """Return (P,) parameters: of both cameras, T_right_left, and T_left_board of each pair."""
        cameras = [[c.fx, c.fy, c.cx, c.cy, *c.distortion] for c in (rig.left, rig.right)]
        return np.concatenate([*cameras, _vector(rig.T_right_left), *map(_vector, T_left_boards)])

    def rig(self, parameters: Array) -> StereoRig:
        """Return the rig of (P,) parameters; the left camera is the body."""
        left, right = (self._camera(values) for values in parameters[: 2 * self.intrinsics].reshape(2, self.intrinsics))
        T_right_left = _pose(parameters[self.shared - POSE : self.shared])
        return StereoRig(left, right, Pose.identity(), T_right_left.inverse())

    def residuals(self, parameters: Array) -> Array:
        """Return all residuals, flat [px]."""
        rig = self.rig(parameters)
        boards = parameters[self.shared :].reshape(-1, POSE)
        R_left_boards = Rotation.from_rotvec(boards[:, :3]).as_matrix()
        parts = []
        for camera, T_cam_left, pair, points, pixels in zip(
            (rig.left, rig.right),
            (Pose.identity(), rig.T_right_left),
            self._pair,
            self._points_board,
            self._pixels,
            strict=True,
        ):
            points_left = np.einsum("nij,nj->ni", R_left_boards[pair], points) + boards[pair, 3:]
            parts.append(pixels - camera.distort(camera.project(T_cam_left.apply(points_left))))
        return np.concatenate(parts).ravel()

    def split(self, residuals: Array) -> list[tuple[Array, Array]]:
        """Return flat residuals as (N, 2) of the left and the right image of each pair."""
        rows = residuals.reshape(-1, 2)
        sides = np.split(rows, [sum(self._counts[0])])
        left, right = (np.split(side, np.cumsum(counts)[:-1]) for side, counts in zip(sides, self._counts, strict=True))
        return list(zip(left, right, strict=True))

    def refine(self, start: Array, free: Columns) -> tuple[Array, Array]:
        """Minimise the squared residuals over some of the parameters by Levenberg and Marquardt's method.

        The normal equations are small and dense where the Jacobian is large and sparse, which a general solver handles
        a hundred times slower.

        Args:
            start: all parameters.
            free: indices of those that may change.

        Returns:
            All parameters, and the (free, free) inverse of the normal matrix there: the covariance for unit residuals.

        Raises:
            CalibrationError: the corners do not determine the parameters.
        """
        parameters, damping = start.copy(), FIRST_DAMPING
        residuals = self.residuals(parameters)
        normal, gradient = self._normal_equations(parameters, residuals)
        for _ in range(MOST_STEPS):
            step = _damped_step(normal[np.ix_(free, free)], gradient[free], damping)
            trial = parameters.copy()
            trial[free] += step
            change = self.residuals(trial)
            gain = 1.0 - float(change @ change) / float(residuals @ residuals)
            if not gain > 0.0:
                damping *= DAMPING_STEP
                if damping > MOST_DAMPING:
                    break
                continue
            parameters, residuals, damping = trial, change, max(damping / DAMPING_STEP, LEAST_DAMPING)
            normal, gradient = self._normal_equations(parameters, residuals)
            if gain < LEAST_GAIN:
                break
        return parameters, _inverse(normal[np.ix_(free, free)])

    def _camera(self, values: Array) -> PinholeCamera:
        fx, fy, cx, cy = map(float, values[:LINEAR])
        return PinholeCamera(*self._size, fx, fy, cx, cy, values[LINEAR:], self._model)

    def _normal_equations(self, parameters: Array, residuals: Array) -> tuple[Array, Array]:
        """Return J^T J and -J^T residuals over all parameters."""
        count = len(parameters)
        columns = [np.array([k]) for k in range(self.shared)]
        columns += [np.arange(self.shared + k, count, POSE) for k in range(POSE)]  # a pair's rows see its own pose only
        J = np.stack([self._slope(parameters, residuals, column) for column in columns], axis=-1)
        normal, gradient = np.zeros((count, count)), np.zeros(count)
        own = np.arange(self.shared + POSE)
        for k, rows in enumerate(self._rows):
            place = np.where(own < self.shared, own, own + POSE * k)
            normal[np.ix_(place, place)] += J[rows].T @ J[rows]
            gradient[place] -= J[rows].T @ residuals[rows]
        return normal, gradient

    def _slope(self, parameters: Array, residuals: Array, columns: Columns) -> Array:
        """Return the forward difference of the residuals when parameters change together."""
        moved = parameters.copy()
        step = DIFFERENCE * np.maximum(1.0, np.abs(parameters[columns]).max())
        moved[columns] += step
        return np.asarray((self.residuals(moved) - residuals) / step)


def _scale(normal: Array) -> Array:
    scale = np.sqrt(np.diag(normal))
    if not scale.all():
        raise CalibrationError("the corners do not determine the cameras; tilt the board more, in more pictures")
    return np.asarray(scale)


def _inverse(normal: Array) -> Array:
    scale = _scale(normal)
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, LEAST_EIGENVALUE)) @ vectors.T
    return np.asarray(inverse / np.outer(scale, scale))


def _damped_step(normal: Array, gradient: Array, damping: float) -> Array:
    scale = _scale(normal)
    damped = normal / np.outer(scale, scale) + damping * np.eye(len(scale))
    return np.asarray(scipy.linalg.solve(damped, gradient / scale, assume_a="pos") / scale)


def _vector(pose: Pose) -> Array:
    return np.concatenate([Rotation.from_matrix(pose.R).as_rotvec(), pose.t])


def _pose(vector: Array) -> Pose:
    return Pose(Rotation.from_rotvec(vector[:3]).as_matrix(), vector[3:].copy())
