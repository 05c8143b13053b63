# SPDX-License-Identifier: Apache-2.0
"""Our measurements as factors of GTSAM: the same start, readings and pixels, with the same noise.

GTSAM writes the error of a pose in the body frame, rotation first: T_true = T Exp(omega, u). Ours (`NavEstimate`) are
differences in the map frame and R_true = Exp(xi) R, so omega = R^T xi and u = R^T dp. GTSAM's bias has the
accelerometer first. The keys of frame k are X(k) pose, V(k) velocity and B(k) bias.
"""

from collections.abc import Sequence
from typing import Protocol

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.propagation import ACCEL_BIAS, GYRO_BIAS, NAV_DIM, POSITION, ROTATION, VELOCITY
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, NavState

Array = NDArray[np.float64]

INTEGRATION_SIGMA = 1e-6  # of the position [m/sqrt(s)]; only keeps the covariance of a single step regular


class Cameras(Protocol):
    """Stereo pixels as factors."""

    def add(self, graph: gtsam.NonlinearFactorGraph, pixels: Array, pose: int, landmarks: Sequence[int]) -> None:
        """Add the factors of (M, 4) stereo pixels between the key of a pose and those of M landmarks."""


class CameraPair:
    """A projection factor for each camera."""

    def __init__(self, rig: StereoRig, sigma_px: float) -> None:
        self._noise = gtsam.noiseModel.Isotropic.Sigma(2, sigma_px)
        self._left = _calibration(rig.left), to_pose3(rig.T_body_left)
        self._right = _calibration(rig.right), to_pose3(rig.T_body_right)

    def add(self, graph: gtsam.NonlinearFactorGraph, pixels: Array, pose: int, landmarks: Sequence[int]) -> None:
        for (K, T_body_camera), points in ((self._left, pixels[:, :2]), (self._right, pixels[:, 2:])):
            for point, landmark in zip(points, landmarks, strict=True):
                graph.push_back(
                    gtsam.GenericProjectionFactorCal3_S2(
                        point, self._noise, pose, landmark, K, False, False, T_body_camera
                    )
                )


class RectifiedPair:
    """One stereo factor for both cameras, turned so that the baseline is their x axis: half the factors.

    Only the mean of the two v (standard deviation sigma / sqrt 2) depends on the landmark; their difference
    depends on the rig alone. Turning the Kagaru rig by 2 degrees stretches pixels by less than 2 %.
    """

    def __init__(self, rig: StereoRig, sigma_px: float) -> None:
        T_left_right = rig.T_body_left.inverse() @ rig.T_body_right
        x = T_left_right.t / rig.baseline_m
        forward = T_left_right.R[:, 2] + [0.0, 0.0, 1.0]
        y = np.cross(forward, x)
        y /= np.linalg.norm(y)
        self._R_left_rectified = np.column_stack([x, y, np.cross(x, y)])
        self._R_right_rectified = T_left_right.R.T @ self._R_left_rectified
        self._rig = rig
        self._focal_px = float(np.mean([rig.left.fx, rig.left.fy, rig.right.fx, rig.right.fy]))
        self._K = gtsam.Cal3_S2Stereo(self._focal_px, self._focal_px, 0.0, 0.0, 0.0, rig.baseline_m)
        self._T_body_rectified = to_pose3(rig.T_body_left @ Pose(self._R_left_rectified, np.zeros(3)))
        self._noise = gtsam.noiseModel.Diagonal.Sigmas(sigma_px * np.array([1.0, 1.0, np.sqrt(0.5)]))

    def add(self, graph: gtsam.NonlinearFactorGraph, pixels: Array, pose: int, landmarks: Sequence[int]) -> None:
        for (left_u, right_u, v), landmark in zip(self._rectified(pixels).tolist(), landmarks, strict=True):
            graph.push_back(
                gtsam.GenericStereoFactor3D(
                    gtsam.StereoPoint2(left_u, right_u, v),
                    self._noise,
                    pose,
                    landmark,
                    self._K,
                    False,
                    False,
                    self._T_body_rectified,
                )
            )

    def _rectified(self, pixels: Array) -> Array:
        """Return (M, 3) u_left, u_right and the mean v of (M, 4) stereo pixels."""
        left = self._rig.left.bearings(pixels[:, :2]) @ self._R_left_rectified
        right = self._rig.right.bearings(pixels[:, 2:]) @ self._R_right_rectified
        left, right = left / left[:, 2:], right / right[:, 2:]
        return self._focal_px * np.column_stack([left[:, 0], right[:, 0], 0.5 * (left[:, 1] + right[:, 1])])


class Motion:
    """Preintegration by GTSAM between frames, from the same readings and by the same midpoint rule as ours."""

    def __init__(
        self,
        samples: Sequence[ImuSample],
        imu: ImuConfig,
        start: NavState,
        *,
        integration_sigma: float = INTEGRATION_SIGMA,
    ) -> None:
        self._stamps_ns = np.array([s.stamp_ns for s in samples], np.int64)
        self._readings = np.array([np.concatenate([s.gyro, s.accel]) for s in samples])
        self._start = start
        self._params = gtsam.PreintegrationCombinedParams.MakeSharedU(imu.gravity)
        self._params.setGyroscopeCovariance(imu.gyro_noise**2 * np.eye(3))
        self._params.setAccelerometerCovariance(imu.accel_noise**2 * np.eye(3))
        self._params.setBiasOmegaCovariance(imu.gyro_bias_walk**2 * np.eye(3))
        self._params.setBiasAccCovariance(imu.accel_bias_walk**2 * np.eye(3))
        self._params.setIntegrationCovariance(integration_sigma**2 * np.eye(3))

    def between(self, start_ns: int, stamp_ns: int) -> gtsam.PreintegratedCombinedMeasurements:
        """Return the motion from one frame's stamp to the next one's [ns]."""
        inside = self._stamps_ns[(self._stamps_ns > start_ns) & (self._stamps_ns < stamp_ns)]
        t_s = (np.concatenate([[start_ns], inside, [stamp_ns]]) - start_ns) / NS_PER_S
        known_s = (self._stamps_ns - start_ns) / NS_PER_S
        readings = np.column_stack([np.interp(t_s, known_s, column) for column in self._readings.T])
        gyro, accel = readings[:, :3], readings[:, 3:]
        dt, omega = np.diff(t_s), 0.5 * (gyro[:-1] + gyro[1:])
        # GTSAM holds a step's first attitude throughout, so the reading at its end is rotated back to it.
        turn, force = (omega - self._start.gyro_bias) * dt[:, None], accel[1:] - self._start.accel_bias
        ahead = np.einsum("kij,kj->ki", so3_exp(turn), force) + self._start.accel_bias
        measured = gtsam.PreintegratedCombinedMeasurements(self._params, to_bias(self._start))
        for step in zip(0.5 * (accel[:-1] + ahead), omega, dt, strict=True):
            measured.integrateMeasurement(*step)
        return measured


def motion_factor(frame: int, motion: gtsam.PreintegratedCombinedMeasurements) -> gtsam.CombinedImuFactor:
    """Return the factor between a frame's state and that of the frame before."""
    return gtsam.CombinedImuFactor(X(frame - 1), V(frame - 1), X(frame), V(frame), B(frame - 1), B(frame), motion)


def start_factor(start: NavEstimate) -> gtsam.LinearContainerFactor:
    """Return the prior of frame 0, with all its correlations."""
    C = np.zeros((NAV_DIM, NAV_DIM))  # from our error to GTSAM's: omega, u, velocity, accelerometer and gyro bias
    R = start.state.T_map_body.R
    C[0:3, ROTATION], C[3:6, POSITION] = R.T, R.T
    C[6:9, VELOCITY], C[9:12, ACCEL_BIAS], C[12:15, GYRO_BIAS] = np.eye(3), np.eye(3), np.eye(3)
    pose, velocity, bias = np.split(np.linalg.inv(np.linalg.cholesky(C @ start.covariance @ C.T)), [6, 9], axis=1)
    unit = gtsam.noiseModel.Unit.Create(NAV_DIM)
    linear = gtsam.JacobianFactor(X(0), pose, V(0), velocity, B(0), bias, np.zeros(NAV_DIM), unit)
    return gtsam.LinearContainerFactor(linear, state_values(0, to_nav_state(start.state), to_bias(start.state)))


def state_values(frame: int, state: gtsam.NavState, bias: gtsam.imuBias.ConstantBias) -> gtsam.Values:
    """Return the values of one frame's state."""
    values = gtsam.Values()
    values.insert(X(frame), state.pose())
    values.insert(V(frame), state.velocity())
    values.insert(B(frame), bias)
    return values


def to_pose3(T: Pose) -> gtsam.Pose3:
    """Return our pose as GTSAM's."""
    return gtsam.Pose3(gtsam.Rot3(T.R), T.t)


def to_pose(pose: gtsam.Pose3) -> Pose:
    """Return GTSAM's pose as ours."""
    return Pose(pose.rotation().matrix(), pose.translation())


def to_nav_state(state: NavState) -> gtsam.NavState:
    """Return our pose and velocity as GTSAM's."""
    return gtsam.NavState(to_pose3(state.T_map_body), state.v_map)


def to_bias(state: NavState) -> gtsam.imuBias.ConstantBias:
    """Return our biases as GTSAM's."""
    return gtsam.imuBias.ConstantBias(state.accel_bias, state.gyro_bias)


def to_pose_covariance(pose: gtsam.Pose3, covariance: Array) -> Array:
    """Return GTSAM's (6, 6) covariance of a pose as ours: position, rotation vector, both in the map frame."""
    R = pose.rotation().matrix()
    C = np.zeros((6, 6))
    C[0:3, 3:6], C[3:6, 0:3] = R, R
    return np.asarray(C @ covariance @ C.T)


def _calibration(camera: PinholeCamera) -> gtsam.Cal3_S2:
    return gtsam.Cal3_S2(camera.fx, camera.fy, 0.0, camera.cx, camera.cy)
