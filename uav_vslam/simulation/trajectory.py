# SPDX-License-Identifier: Apache-2.0
"""The true motion of one vehicle, smooth enough that IMU readings follow exactly from its poses.

Position and roll, pitch, yaw are quintic splines of time, so velocity, acceleration and body rates are analytic
derivatives of the same poses that the cameras use. World is ENU with z = 0 at the mean ground; body is FLU.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, make_interp_spline

from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

SPLINE_DEGREE = 5


class Trajectory:
    """Ground truth as functions of the time `t_s` since `start_ns`; every query is vectorised over `t_s`.

    Attributes:
        start_ns: stamp of t_s = 0 [ns].
    """

    def __init__(self, start_ns: int, times_s: ArrayLike, positions_world: ArrayLike, rpy: ArrayLike) -> None:
        """Interpolate knots.

        Args:
            start_ns: stamp of t_s = 0 [ns].
            times_s: (N,) increasing knot times [s].
            positions_world: (N, 3) body origin in the world [m].
            rpy: (N, 3) roll, pitch, yaw of R_world_body [rad], unwrapped.
        """
        times = np.asarray(times_s, dtype=float)
        self.start_ns = start_ns
        self._position: BSpline = make_interp_spline(times, np.asarray(positions_world, dtype=float), k=SPLINE_DEGREE)
        self._velocity, self._acceleration = self._position.derivative(1), self._position.derivative(2)
        self._rpy: BSpline = make_interp_spline(times, np.asarray(rpy, dtype=float), k=SPLINE_DEGREE)
        self._rpy_rate = self._rpy.derivative(1)

    def time_s(self, stamp_ns: int | NDArray[np.int64]) -> Array:
        """Return the time(s) since `start_ns` [s] of one or more stamps."""
        return np.asarray((np.asarray(stamp_ns, dtype=np.int64) - self.start_ns) / NS_PER_S)

    def position(self, t_s: ArrayLike) -> Array:
        """Return (..., 3) positions of the body in the world [m]."""
        return np.asarray(self._position(t_s))

    def velocity(self, t_s: ArrayLike) -> Array:
        """Return (..., 3) velocities in the world frame [m/s]."""
        return np.asarray(self._velocity(t_s))

    def acceleration(self, t_s: ArrayLike) -> Array:
        """Return (..., 3) accelerations in the world frame, without gravity [m/s^2]."""
        return np.asarray(self._acceleration(t_s))

    def rotation(self, t_s: ArrayLike) -> Array:
        """Return (..., 3, 3) rotation matrices R_world_body."""
        roll, pitch, yaw = np.moveaxis(self._rpy(t_s), -1, 0)
        return rotation_from_rpy(roll, pitch, yaw)

    def pose(self, t_s: float) -> Pose:
        """Return T_world_body at one time."""
        return Pose(self.rotation(t_s), self.position(t_s))

    def angular_rate_body(self, t_s: ArrayLike) -> Array:
        """Return (..., 3) angular rates of the body relative to the world, in the body frame [rad/s]."""
        roll, pitch, _ = np.moveaxis(self._rpy(t_s), -1, 0)
        roll_rate, pitch_rate, yaw_rate = np.moveaxis(self._rpy_rate(t_s), -1, 0)
        x = roll_rate - yaw_rate * np.sin(pitch)
        y = pitch_rate * np.cos(roll) + yaw_rate * np.sin(roll) * np.cos(pitch)
        z = -pitch_rate * np.sin(roll) + yaw_rate * np.cos(roll) * np.cos(pitch)
        return np.stack([x, y, z], axis=-1)

    def specific_force_body(self, t_s: ArrayLike, *, gravity: float) -> Array:
        """Return (..., 3) specific forces R^T (a + g e_z) in the body frame [m/s^2]."""
        force_world = self.acceleration(t_s) + np.array([0.0, 0.0, gravity])
        return np.asarray(np.einsum("...ji,...j->...i", self.rotation(t_s), force_world))
