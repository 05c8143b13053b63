# SPDX-License-Identifier: Apache-2.0
"""SO(3) in numpy: rotation matrices, rotation vectors, Hamilton quaternions and yaw-pitch-roll angles.

All functions are vectorised over leading axes unless stated otherwise. References: Sola, Deray, Atchuthan,
"A micro Lie theory for state estimation in robotics" (2018), Eqs. (143)-(147).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SMALL_ANGLE_RAD = 1e-5  # below it the Taylor series is exact to double precision


def skew(vector: ArrayLike) -> Array:
    """Return [v]x with [v]x w = v x w.

    Args:
        vector: (..., 3).

    Returns:
        (..., 3, 3) skew-symmetric matrices.
    """
    v = np.asarray(vector, dtype=float)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def _sinc_and_versine(theta: Array) -> tuple[Array, Array]:
    """Return sin(t)/t and (1-cos(t))/t^2 without cancellation near zero."""
    small = theta < SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, theta)
    sinc = np.where(small, 1.0 - theta**2 / 6.0, np.sin(safe) / safe)
    versine = np.where(small, 0.5 - theta**2 / 24.0, 2.0 * np.sin(safe / 2.0) ** 2 / safe**2)
    return sinc, versine


def _cubic(theta: Array) -> Array:
    """Return (t-sin(t))/t^3; t - sin(t) cancels long before SMALL_ANGLE_RAD: the series has two terms up to 0.05."""
    series = (1.0 - theta**2 / 20.0 * (1.0 - theta**2 / 42.0)) / 6.0
    safe = np.where(theta < SMALL_ANGLE_RAD, 1.0, theta)
    return np.where(theta < 0.05, series, (safe - np.sin(safe)) / safe**3)


def so3_exp(rotation_vector: ArrayLike) -> Array:
    """Return Exp(xi) = I + sin(t)/t [xi]x + (1-cos(t))/t^2 [xi]x^2.

    Args:
        rotation_vector: (..., 3) [rad].

    Returns:
        (..., 3, 3) rotation matrices.
    """
    xi = np.asarray(rotation_vector, dtype=float)
    theta = np.linalg.norm(xi, axis=-1)[..., None, None]
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
    theta = np.linalg.norm(xi, axis=-1)[..., None, None]
    _, versine = _sinc_and_versine(theta)
    K = skew(xi)
    return np.asarray(np.eye(3) + versine * K + _cubic(theta) * (K @ K))


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


def quaternion_wxyz_from_rotation(R: ArrayLike) -> Array:
    """Return the unit quaternion (w >= 0) of a rotation matrix, computed from the largest of its four components.

    Args:
        R: (..., 3, 3).

    Returns:
        (..., 4) as w, x, y, z.
    """
    R = np.asarray(R, dtype=float)
    m00, m11, m22 = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    # Row k of `rows` is 4 q_k q; the row with the largest diagonal is best conditioned.
    rows = np.empty((*R.shape[:-2], 4, 4))
    rows[..., 0, 0] = 1 + m00 + m11 + m22
    rows[..., 1, 1] = 1 + m00 - m11 - m22
    rows[..., 2, 2] = 1 - m00 + m11 - m22
    rows[..., 3, 3] = 1 - m00 - m11 + m22
    rows[..., 0, 1] = rows[..., 1, 0] = R[..., 2, 1] - R[..., 1, 2]
    rows[..., 0, 2] = rows[..., 2, 0] = R[..., 0, 2] - R[..., 2, 0]
    rows[..., 0, 3] = rows[..., 3, 0] = R[..., 1, 0] - R[..., 0, 1]
    rows[..., 1, 2] = rows[..., 2, 1] = R[..., 1, 0] + R[..., 0, 1]
    rows[..., 1, 3] = rows[..., 3, 1] = R[..., 2, 0] + R[..., 0, 2]
    rows[..., 2, 3] = rows[..., 3, 2] = R[..., 2, 1] + R[..., 1, 2]
    best = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
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
