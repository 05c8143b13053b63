# SPDX-License-Identifier: Apache-2.0
"""Velocity and gravity in the body frame, from a few stereo frames and the IMU readings between them.

The stereo baseline gives scale and the gyroscope rotation, so only the projection is non-linear. In the
first frame's body axes, with the increments' dR_k, dp_k and t_k from the first frame to frame k:

    p_k = v t_k + g t_k^2 / 2 + dp_k(b, n) + v_k s,    R_k = dR_k(b, n) Exp(w_k s)
    z_ik = h(R_left_body (R_k^T (l_i - p_k) - t_body_left))

where s is the delay of the exposures, the first too, after their stamps by the IMU's clock, and v_k and w_k are the
velocity and the angular rate at frame k: in gusts of 0.6 rad/s, 4 ms move all points by two pixels.

Unknown are x = (v, g, gyro bias, accelerometer bias, n) and the points l_i. |g| is known, the biases b have the spread
that `ImuConfig` gives them, and n ~ N(0, I) is s in its standard deviations, then the increments' noise, scaled by a
factor of its covariance. Solved by Gauss-Newton on the pixels with the points eliminated, first with Cauchy weights
against wrong matches, then on the inliers. No pose is estimated from one pair of frames: far points are too uncertain.

Where a map knows some of the points, `align_in_map` solves for the body's pose in it as well: `map_points`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import chdtri

from uav_vslam.config import ImuConfig
from uav_vslam.estimation.observation import MIN_DEPTH_M
from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.rotation import skew, so3_exp
from uav_vslam.geometry.stereo import STEREO_DOF, StereoRig
from uav_vslam.ins.increments import compose, error_transfer
from uav_vslam.slam.map_points import MapPoints
from uav_vslam.slam.pose_equations import TINY_INFORMATION, PoseEquations
from uav_vslam.types import ImuIncrement

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

VELOCITY, GRAVITY, GYRO_BIAS, ACCEL_BIAS = (slice(k, k + 3) for k in range(0, 12, 3))
BIASES, NOISE = slice(6, 12), slice(12, None)
DELAY = NOISE.start  # of the exposures
INCREMENT_POSE = [0, 1, 2, 6, 7, 8]  # of (rotation, velocity, position), the numbers that affect a frame's pixels
SIGMA_GRAVITY = 0.03  # [m/s^2] uncertainty of the configured norm of gravity
ROBUST_STEPS, FINAL_STEPS = 12, 4
MEDIAN_CHI2, INLIER_CHI2 = (float(chdtri(STEREO_DOF, beyond)) for beyond in (0.5, 1e-3))


@dataclass(frozen=True, slots=True)
class View:
    """Observations of the first frame's points in a later frame.

    Attributes:
        motion: since the previous view, or since the first frame.
        rows: (M,) indices of the points, each at most once.
        pixels: (M, 4) their stereo pixels [px].
    """

    motion: ImuIncrement
    rows: Rows
    pixels: Array


@dataclass(frozen=True, slots=True)
class Alignment:
    """The motion at the first frame, in its body axes.

    Attributes:
        velocity: (3,) [m/s].
        gravity: (3,) [m/s^2].
        gyro_bias: (3,) [rad/s].
        covariance: (12, 12) of velocity, gravity, gyro and accelerometer bias, assuming correct inliers.
        inliers: observations of each view that agree with the result.
    """

    velocity: Array
    gravity: Array
    gyro_bias: Array
    covariance: Array
    inliers: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class MapAlignment:
    """The motion at the first frame, in its body axes, and the pose of that frame in a map.

    Attributes:
        velocity, gravity, gyro_bias: as in `Alignment`.
        accel_bias: (3,) [m/s^2].
        T_map_body: pose.
        covariance: (18, 18) of velocity, gravity, gyro and accelerometer bias, then the pose's position and rotation
            (map-frame rotation vector); without errors that all points of the map share.
        landmarks: points of the map that agree.
    """

    velocity: Array
    gravity: Array
    gyro_bias: Array
    accel_bias: Array
    T_map_body: Pose
    covariance: Array
    landmarks: int


def align(
    rig: StereoRig, pixels: Array, views: list[View], *, imu: ImuConfig, sigma_px: float, delay_sigma_s: float
) -> Alignment:
    """Solve for the motion at the first frame.

    Args:
        rig: calibration.
        pixels: (N, 4) the first frame's points, all of which triangulate [px].
        views: later frames in stamp order, one or more, each with at least one match; increments at zero bias.
        imu: gravity, and the spread of the biases.
        sigma_px: standard deviation of each pixel coordinate [px].
        delay_sigma_s: standard deviation of the exposures' delay [s].
    """
    x, H, weight, _ = _solve(rig, pixels, views, None, imu, sigma_px, delay_sigma_s)
    covariance = np.asarray(np.linalg.inv(H)[: NOISE.start, : NOISE.start])
    return Alignment(x[VELOCITY], x[GRAVITY], x[GYRO_BIAS], covariance, (weight[:, 1:] > 0).sum(axis=0))


def align_in_map(
    rig: StereoRig,
    pixels: Array,
    views: list[View],
    known: MapPoints,
    *,
    imu: ImuConfig,
    sigma_px: float,
    delay_sigma_s: float,
) -> MapAlignment:
    """Solve for the motion at the first frame and its pose in a map; arguments as for `align`.

    The views fix the shape of the ground, so that its fit to the map separates tilt from shift; one frame hardly does.
    """
    x, H, weight, T_map_body = _solve(rig, pixels, views, known, imu, sigma_px, delay_sigma_s)
    kept = np.r_[: NOISE.start, len(H) - POSE_DIM : len(H)]
    covariance = np.linalg.inv(H)[np.ix_(kept, kept)]
    landmarks = int((weight[:, -1] > 0).sum())
    return MapAlignment(x[VELOCITY], x[GRAVITY], x[GYRO_BIAS], x[ACCEL_BIAS], T_map_body, covariance, landmarks)


def _solve(
    rig: StereoRig,
    pixels: Array,
    views: list[View],
    known: MapPoints | None,
    imu: ImuConfig,
    sigma_px: float,
    delay_sigma_s: float,
) -> tuple[Array, Array, Array, Pose]:
    """Return x, the information matrix, the weights (N, K) and the pose in the map.

    With points of a map, the map is the last of the K frames, and its pose follows x in the matrix.
    """
    motion = _Motion.through(views, delay_sigma_s)
    z, seen = _table(pixels, views)
    points = rig.T_body_left.apply(rig.triangulate(pixels))
    noise_px = sigma_px * rig.magnification(z)[..., None]
    x = _first_guess(rig, motion, z, seen, points, imu.gravity)
    T_map_body = Pose.identity()
    if known is not None:
        T_map_body = known.T_map_body
        seen = np.concatenate([seen, known.seen(len(points))], axis=1)
    for step in range(ROBUST_STEPS + FINAL_STEPS):
        by_x = motion.by_x(x)
        residual, J_pose, J_point = _linearise(rig, motion.poses(by_x @ x), points, z, noise_px)
        if known is not None:
            by_x = block_diag(by_x, np.eye(POSE_DIM))
            residual, J_pose, J_point = known.appended(T_map_body, points, residual, J_pose, J_point)
        chi2 = np.einsum("nki,nki->nk", residual, residual)
        weight = _cauchy(chi2, seen) if step < ROBUST_STEPS else seen * (chi2 <= INLIER_CHI2)
        system = PoseEquations.of(residual, J_pose, J_point, weight)
        H, b = by_x.T @ system.H @ by_x, by_x.T @ system.b
        H_prior, b_prior = _prior(x, imu)
        H[: len(x), : len(x)] += H_prior
        b[: len(x)] += b_prior
        dx = np.linalg.solve(H, b)
        points = points + system.points(by_x @ dx)
        x = x + dx[: len(x)]
        T_map_body = T_map_body if known is None else T_map_body.moved(dx[len(x) :])
    return x, H, weight, T_map_body


@dataclass(frozen=True, slots=True)
class _Motion:
    """The frames' motion since frame 0 by IMU readings; K frames in all.

    Attributes:
        times_s: (K,).
        delta_R: (K, 3, 3), delta_v: (K, 3) [m/s], delta_p: (K, 3) [m] at zero bias, without gravity and velocity.
        at_stamps: (6K, 13 + 6(K-1)) derivative of all poses by x without what moves during the delay.
        rates: (K, 3) angular rates, axes of frame k [rad/s].
        delay_sigma_s: standard deviation of the exposures' delay [s].
    """

    times_s: Array
    delta_R: Array
    delta_v: Array
    delta_p: Array
    at_stamps: Array
    rates: Array
    delay_sigma_s: float

    @staticmethod
    def through(views: list[View], delay_sigma_s: float) -> "_Motion":
        wholes, covariance = [views[0].motion], views[0].motion.covariance
        for view in views[1:]:
            A, _ = error_transfer(wholes[-1], view.motion)
            cross = A @ covariance[-9:]
            wholes.append(compose(wholes[-1], view.motion))
            covariance = np.block([[covariance, cross.T], [cross, wholes[-1].covariance]])
        rows = np.concatenate([9 * k + np.array(INCREMENT_POSE) for k in range(len(wholes))])
        values, vectors = np.linalg.eigh(covariance[np.ix_(rows, rows)])
        by_x = np.zeros((POSE_DIM * (len(wholes) + 1), DELAY + 1 + len(rows)))
        by_x[POSE_DIM:, DELAY + 1 :] = vectors * np.sqrt(np.maximum(values, 0.0))
        times_s = np.array([0.0, *np.cumsum([view.motion.dt_s for view in views])])
        for k, (t, whole) in enumerate(zip(times_s[1:], wholes, strict=True), start=1):
            pose = slice(POSE_DIM * k, POSE_DIM * (k + 1))
            by_x[pose, BIASES] = whole.bias_jacobian[INCREMENT_POSE]
            by_x[pose, VELOCITY][3:], by_x[pose, GRAVITY][3:] = t * np.eye(3), 0.5 * t**2 * np.eye(3)
        return _Motion(
            times_s,
            np.stack([np.eye(3), *(whole.delta_R for whole in wholes)]),
            np.stack([np.zeros(3), *(whole.delta_v for whole in wholes)]),
            np.stack([np.zeros(3), *(whole.delta_p for whole in wholes)]),
            by_x,
            np.stack([views[0].motion.rate_start, *(view.motion.rate_end for view in views)]),
            delay_sigma_s,
        )

    def by_x(self, x: Array) -> Array:
        """Return the (6K, 13 + 6(K-1)) derivative of all poses by x, without that of the velocities in the delay."""
        velocities = x[VELOCITY] + self.times_s[:, None] * x[GRAVITY] + self.delta_v
        moving = np.concatenate([self.rates, velocities], axis=1)
        by_x = self.at_stamps.copy()
        by_x[:, DELAY] = self.delay_sigma_s * moving.ravel()
        return by_x

    def poses(self, shift: Array) -> tuple[Array, Array]:
        """Return R_first_k (K, 3, 3) and p_k (K, 3) for the (6K,) shift of all poses by x."""
        shift = shift.reshape(-1, POSE_DIM)
        return self.delta_R @ so3_exp(shift[:, :3]), self.delta_p + shift[:, 3:]


def _table(pixels: Array, views: list[View]) -> tuple[Array, NDArray[np.bool_]]:
    """Return pixels (N, K, 4) of each point in each frame, and the mask of existing ones (N, K)."""
    z, seen = np.zeros((len(pixels), len(views) + 1, STEREO_DOF)), np.zeros((len(pixels), len(views) + 1), bool)
    z[:, 0], seen[:, 0] = pixels, True
    for k, view in enumerate(views, start=1):
        z[view.rows, k], seen[view.rows, k] = view.pixels, True
    return z, seen


def _first_guess(
    rig: StereoRig, motion: _Motion, z: Array, seen: NDArray[np.bool_], points: Array, gravity: float
) -> Array:
    """Return x of an unaccelerated vehicle, with the median of the single points' velocities."""
    x = np.zeros(motion.at_stamps.shape[1])
    t, moved = motion.times_s[1:, None], motion.delta_p[1:]
    force = motion.delta_p[-1]
    x[GRAVITY] = -gravity * force / np.linalg.norm(force)
    found = rig.T_body_left.apply(rig.triangulate(z[:, 1:])).reshape(len(points), len(t), 3)
    displacement = points[:, None] - np.einsum("kij,nkj->nki", motion.delta_R[1:], found)
    velocities = ((displacement - 0.5 * x[GRAVITY] * t**2 - moved) / t)[seen[:, 1:]]
    finite = np.isfinite(velocities).all(axis=1)
    if finite.any():
        x[VELOCITY] = np.median(velocities[finite], axis=0)
    return x


def _linearise(
    rig: StereoRig, poses: tuple[Array, Array], points: Array, z: Array, noise_px: Array
) -> tuple[Array, Array, Array]:
    """Return residuals (N, K, 4) in sigmas (N, K, 1), their prediction by pose (N, K, 4, 6) and point (N, K, 4, 3)."""
    R, p = poses
    body = np.einsum("kji,nkj->nki", R, points[:, None] - p)
    left = (body - rig.T_body_left.t) @ rig.T_body_left.R
    left[..., 2] = np.maximum(left[..., 2], MIN_DEPTH_M)  # nearer points, and those behind, are outliers
    J_body = rig.project_jacobian(left) @ rig.T_body_left.R.T / noise_px[..., None]
    J_point = J_body @ R.transpose(0, 2, 1)
    J_pose = np.concatenate([J_body @ skew(body), -J_point], axis=-1)
    return (z - rig.project(left)) / noise_px, J_pose, J_point


def _cauchy(chi2: Array, seen: NDArray[np.bool_]) -> Array:
    """Return Cauchy weights of (N, K) squared residuals, scaled by their median or the noise."""
    scale = max(1.0, float(np.median(chi2[seen])) / MEDIAN_CHI2)
    return np.asarray(seen / (1.0 + chi2 / (STEREO_DOF * scale)))


def _prior(x: Array, imu: ImuConfig) -> tuple[Array, Array]:
    """Return information matrix and vector of the prior."""
    information = np.full(len(x), TINY_INFORMATION)
    information[GYRO_BIAS] = 1.0 / imu.gyro_bias_sigma**2
    information[ACCEL_BIAS] = 1.0 / imu.accel_bias_sigma**2
    information[NOISE] = 1.0
    H, b = np.diag(information), -information * x
    norm = float(np.linalg.norm(x[GRAVITY]))
    down = x[GRAVITY] / norm
    H[GRAVITY, GRAVITY] += np.outer(down, down) / SIGMA_GRAVITY**2
    b[GRAVITY] += down * (imu.gravity - norm) / SIGMA_GRAVITY**2
    return H, b
