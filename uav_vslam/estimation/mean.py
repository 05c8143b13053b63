# SPDX-License-Identifier: Apache-2.0
"""The mean of a filter, and the coordinates of the errors about it.

The mean lives on a manifold. A `Chart` says which row of an error belongs to what, moves a mean by an error and carries
a belief along. Rows: navigation state in the model's coordinates, rig errors, past poses, landmarks (map frame).
"""

import dataclasses
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.belief import Belief, Indices
from uav_vslam.estimation.models import StateModel, chart_transport, difference
from uav_vslam.estimation.past_poses import PastPoses
from uav_vslam.estimation.rig_errors import RigErrors, RigState
from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.rotation import skew, so3_log
from uav_vslam.ins.propagation import ROTATION
from uav_vslam.types import NavState

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Mean:
    """What is estimated.

    Attributes:
        nav: of the vehicle now.
        rig: errors of the calibration.
        past: earlier poses.
        landmarks: (N, 3) in the map frame [m].
    """

    nav: NavState
    rig: RigState
    past: PastPoses
    landmarks: Array

    @classmethod
    def at_start(cls, nav: NavState) -> Self:
        """Return a mean of the vehicle alone."""
        return cls(nav, RigState(), PastPoses.none(), np.zeros((0, 3)))

    @property
    def points(self) -> Array:
        """(V + N, 3) the past positions, then the landmarks."""
        return np.vstack([self.past.t, self.landmarks])

    def at(self, T_map_body: Pose) -> Self:
        """Return this mean with the vehicle at another pose, and with it the past pose of the same time."""
        past = self.past.with_newest(self.nav.stamp_ns, R=T_map_body.R, t=T_map_body.t)
        return dataclasses.replace(self, nav=dataclasses.replace(self.nav, T_map_body=T_map_body), past=past)

    def at_poses_of(self, other: Self) -> Self:
        """Return this mean with the vehicle's present and past poses of another one, of the same times."""
        nav = dataclasses.replace(self.nav, T_map_body=other.nav.T_map_body)
        return dataclasses.replace(self, nav=nav, past=other.past)

    def without_landmarks(self) -> Self:
        """Return the mean of the vehicle alone."""
        return dataclasses.replace(self, landmarks=np.zeros((0, 3)))


@dataclass(frozen=True, slots=True)
class Chart:
    """Coordinates of the errors about a mean."""

    model: StateModel
    errors: RigErrors

    @property
    def present(self) -> int:
        """Number of rows of the vehicle without its past: navigation state and rig errors."""
        return self.model.nav_dim + self.errors.dim

    def vehicle(self, mean: Mean) -> int:
        """Return the number of rows of the vehicle, its past included."""
        return self.present + POSE_DIM * len(mean.past)

    def past(self, mean: Mean) -> slice:
        """Return the rows of the past poses."""
        return slice(self.present, self.vehicle(mean))

    def past_rows(self, numbers: Indices) -> Indices:
        """Return the rows of some past poses."""
        return (self.present + POSE_DIM * numbers[:, None] + np.arange(POSE_DIM)).ravel()

    def retract(self, mean: Mean, delta: Array) -> Mean:
        """Move a mean by an error (vehicle + 3N,)."""
        past = delta[self.past(mean)].reshape(-1, 2, 3)
        on_manifold = np.concatenate([delta[: self.model.nav_dim], past[:, 0].ravel(), delta[self.vehicle(mean) :]])
        nav, points = self.model.retract(mean.nav, mean.points, on_manifold)
        return Mean(
            nav,
            self.errors.retract(mean.rig, delta),
            mean.past.moved(past[:, 1], points[: len(past)]).with_newest(nav.stamp_ns, v_map=nav.v_map),
            points[len(past) :],
        )

    def local(self, mean: Mean, other: Mean) -> Array:
        """Return the error (vehicle + 3N,) of a mean that moves its poses to another's; its landmarks stay in place."""
        nav_dim, count, points = self.model.nav_dim, len(mean.past), np.vstack([other.past.t, mean.landmarks])
        offset = difference(mean.nav, mean.points, other.nav, points)
        past = np.zeros((count, 2, 3))
        past[:, 0] = offset[nav_dim : nav_dim + 3 * count].reshape(-1, 3)
        past[:, 1] = so3_log(other.past.R @ np.swapaxes(mean.past.R, 1, 2))
        return np.concatenate(
            [offset[:nav_dim], np.zeros(self.errors.dim), past.ravel(), offset[nav_dim + 3 * count :]]
        )

    def transport(self, mean: Mean, moved: Mean) -> Array:
        """Return B (vehicle + 3N, 3): errors e of a mean are (I - B E^T) e of the moved one, E selecting `ROTATION`."""
        if not self.model.invariant:
            return np.zeros((self.vehicle(mean) + 3 * len(mean.landmarks), 3))
        shift, count = moved.points - mean.points, len(mean.past)
        moved_position = moved.nav.T_map_body.t - mean.nav.T_map_body.t
        B = chart_transport(self.vehicle(mean), moved_position, moved.nav.v_map - mean.nav.v_map, shift[count:])
        B[self.past(mean)].reshape(count, 2, 3, 3)[:, 0] = skew(shift[:count])
        return B

    def transported(self, belief: Belief, mean: Mean, moved: Mean) -> Belief:
        """Return a belief over the errors of a mean as one over those of the moved mean."""
        if not self.model.invariant:
            return belief
        return belief.coordinates_changed(self.transport(mean, moved), ROTATION)
