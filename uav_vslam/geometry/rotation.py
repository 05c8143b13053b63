# SPDX-License-Identifier: Apache-2.0
"""SO(3) in numpy: rotation matrices, rotation vectors, Hamilton quaternions and yaw-pitch-roll angles.

All functions are vectorised over leading axes unless stated otherwise. Eq. (143) to (147) of [sola18].
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

TINY_ANGLE_RAD = 1e-150  # stands for zero where a quotient has a limit
SMALL_ANGLE_RAD = 1e-5  # below it the Taylor series is exact to double precision


def _four_qq(R: Array) -> Array:
    """Return (4, 4) 4 q q^T of the quaternion wxyz of a rotation matrix."""
    rows = np.diag(1.0 + np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) @ np.diagonal(R))
    rows[0, 1:] = rows[1:, 0] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    rows[1, 2] = rows[2, 1] = R[1, 0] + R[0, 1]
    rows[1, 3] = rows[3, 1] = R[0, 2] + R[2, 0]
    rows[2, 3] = rows[3, 2] = R[2, 1] + R[1, 2]
    return rows


# Linear maps as matrices: one product takes a fraction of the time of element by element.
_GENERATORS = np.array([np.cross(axis, np.eye(3)).T.ravel() for axis in np.eye(3)])  # [v]x from v, row by row
_FOUR_QQ = np.array([(_four_qq(R) - np.eye(4)).ravel() for R in np.eye(9).reshape(9, 3, 3)])  # 4 q q^T - I from R


def skew(vector: ArrayLike) -> Array:
    """Return [v]x with [v]x w = v x w.

    Args:
        vector: (..., 3).

    Returns:
        (..., 3, 3) skew-symmetric matrices.
    """
    v = np.asarray(vector, dtype=float)
    return np.asarray((v @ _GENERATORS).reshape(*v.shape[:-1], 3, 3))


def _angle(rotation_vector: Array) -> Array:
    """Return (..., 1, 1) lengths."""
    return np.asarray(np.sqrt((rotation_vector * rotation_vector).sum(axis=-1))[..., None, None])


def _sinc_and_versine(theta: Array) -> tuple[Array, Array]:
    """Return sin(t)/t and (1-cos(t))/t^2 = (sin(t/2)/(t/2))^2/2, which don't cancel near zero."""
    t = np.maximum(theta, TINY_ANGLE_RAD)
    half_sinc = np.sin(0.5 * t) / (0.5 * t)
    return np.sin(t) / t, 0.5 * half_sinc * half_sinc


def _cubic(theta: Array) -> Array:
    """Return (t-sin(t))/t^3; t - sin(t) cancels, so up to 0.05 it is the series, of which two terms suffice there."""
    square = theta * theta
    series = (1.0 - square / 20.0 * (1.0 - square / 42.0)) / 6.0
    t = np.maximum(theta, 0.05)
    return np.where(theta < 0.05, series, (t - np.sin(t)) / (t * t * t))


def so3_exp(rotation_vector: ArrayLike) -> Array:
    """Return Exp(xi) = I + sin(t)/t [xi]x + (1-cos(t))/t^2 [xi]x^2.

    Args:
        rotation_vector: (..., 3) [rad].

    Returns:
        (..., 3, 3) rotation matrices.
    """
    xi = np.asarray(rotation_vector, dtype=float)
    theta = _angle(xi)
    sinc, versine = _sinc_and_versine(theta)
    K = skew(xi)
    return np.asarray(np.eye(3) + sinc * K + versine * (K @ K))


def so3_left_jacobian(rotation_vector: ArrayLike) -> Array:
    """Return J_l(xi), with Exp(xi + d) ~ Exp(J_l d) Exp(xi); the right Jacobian is J_l(-xi).

    Args:
        rotation_vector: (..., 3) [rad].

    Returns:
        (..., 3, 3).
    """
    xi = np.asarray(rotation_vector, dtype=float)
    theta = _angle(xi)
    _, versine = _sinc_and_versine(theta)
    K = skew(xi)
    return np.asarray(np.eye(3) + versine * K + _cubic(theta) * (K @ K))


def so3_exp_and_right_jacobian(rotation_vector: ArrayLike) -> tuple[Array, Array]:
    """Return `so3_exp` and J_r(xi), with Exp(xi + d) ~ Exp(xi) Exp(J_r d), for less than they take one by one.

    Args:
        rotation_vector: (..., 3) [rad].

    Returns:
        Two (..., 3, 3).
    """
    xi = np.asarray(rotation_vector, dtype=float)
    theta = _angle(xi)
    sinc, versine = _sinc_and_versine(theta)
    K = skew(xi)
    K2 = K @ K
    return np.eye(3) + sinc * K + versine * K2, np.eye(3) - versine * K + _cubic(theta) * K2


def so3_log(R: ArrayLike) -> Array:
    """Return the rotation vector of a rotation matrix, in the ball of radius pi.

    Args:
        R: (..., 3, 3).

    Returns:
        (..., 3) [rad].
    """
    q = quaternion_wxyz_from_rotation(R)
    w, v = q[..., :1], q[..., 1:]
    norm = np.linalg.norm(v, axis=-1, keepdims=True)
    small = norm < SMALL_ANGLE_RAD
    angle = 2.0 * np.arctan2(norm, w)
    scale = np.where(small, 2.0, angle / np.where(small, 1.0, norm))
    return np.asarray(scale * v)


def nearest_rotation(matrix: Array) -> Array:
    """Return the R that maximises trace(R^T M) for one (3, 3) matrix M, such as a sum of rotations or of a b^T."""
    U, _, Vt = np.linalg.svd(matrix)
    handedness = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    return np.asarray(U @ handedness @ Vt)


def quaternion_wxyz_from_rotation(R: ArrayLike) -> Array:
    """Return the unit quaternion (w >= 0) of a rotation matrix, computed from the largest of its four components.

    Args:
        R: (..., 3, 3).

    Returns:
        (..., 4) as w, x, y, z.
    """
    R = np.asarray(R, dtype=float)
    # Row k is 4 q_k q; that with the largest diagonal is best conditioned.
    rows = (R.reshape(-1, 9) @ _FOUR_QQ + np.eye(4).ravel()).reshape(-1, 4, 4)
    best = rows.reshape(-1, 16)[:, ::5].argmax(axis=-1)
    q = rows[np.arange(len(rows)), best].reshape(*R.shape[:-2], 4)
    q = q / np.sqrt((q * q).sum(axis=-1, keepdims=True))
    return np.asarray(np.where(q[..., :1] < 0, -q, q))


def rotation_from_quaternion_wxyz(quaternion_wxyz: ArrayLike) -> Array:
    """Return the rotation matrix of a quaternion, which need not have unit length.

    Args:
        quaternion_wxyz: (..., 4).

    Returns:
        (..., 3, 3).

    Raises:
        ValueError: a quaternion has (nearly) zero norm.
    """
    q = np.asarray(quaternion_wxyz, dtype=float)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all(norm > 1e-6):
        raise ValueError("a quaternion has zero norm; expected a unit quaternion")
    q = q / norm
    w, v = q[..., 0], q[..., 1:]
    K = skew(v)
    return np.asarray(np.eye(3) + 2.0 * w[..., None, None] * K + 2.0 * (K @ K))


def rotation_from_rpy(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Return R_world_body = Rz(yaw) Ry(pitch) Rx(roll) for broadcastable angles [rad]; (..., 3, 3)."""
    roll, pitch, yaw = np.broadcast_arrays(roll, pitch, yaw)
    zero = np.zeros_like(roll, dtype=float)
    Rx = so3_exp(np.stack([roll, zero, zero], axis=-1))
    Ry = so3_exp(np.stack([zero, pitch, zero], axis=-1))
    Rz = so3_exp(np.stack([zero, zero, yaw], axis=-1))
    return np.asarray(Rz @ Ry @ Rx)


def rpy_from_rotation(R: ArrayLike) -> Array:
    """Return (..., 3) roll, pitch, yaw [rad] of R_world_body; at pitch = +-90 deg roll and yaw are not unique."""
    R = np.asarray(R, dtype=float)
    roll = np.arctan2(R[..., 2, 1], R[..., 2, 2])
    pitch = np.arcsin(np.clip(-R[..., 2, 0], -1.0, 1.0))
    yaw = np.arctan2(R[..., 1, 0], R[..., 0, 0])
    return np.stack([roll, pitch, yaw], axis=-1)
