# SPDX-License-Identifier: Apache-2.0
"""Poses for mapping: the shape of a flight from its smoother, its place from the fleet.

Neighbouring images must fit to millimetres, which the smoothed own-only poses do; where the whole flight lies is known
better by fusion with the peers, but the fused poses step whenever a packet arrives. So the smoothed trajectory is moved
by a correction c, position and rotation (map frame, R' = Exp(xi) R), that is estimated from the flight as a whole:

    c_k+1 = F_k c_k + w_k      rigid, F = [I, -[moved]x; 0, I]; w is the drift of the smoothed poses on the way
    d_k   = c_k + e_k          the fused pose's difference from the smoothed one, with the fused covariance

Fused poses err together over long: they hold the same start and the same landmarks. A pose every dt of a process that
forgets in tau counts as dt / 2 tau independent ones, so their covariance is inflated by 2 tau / dt. Nothing else is
known of c: the smoothed poses' own place is part of the fused ones', and would count twice. A Kalman filter and a
Rauch-Tung-Striebel smoother [rauch65] solve the chain.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import skew, so3_log
from uav_vslam.numerics import symmetrise
from uav_vslam.types import NS_PER_S, PoseEstimate

Array = NDArray[np.float64]

MEMORY_S = 10.0  # over which fused poses err together
LEAST_DRIFT = np.repeat([1e-4, 1e-6], 3)  # standard deviations of w over a metre [m], [rad]
UNKNOWN = np.repeat([1e3, 1.0], 3)  # of c before the first fused pose


@dataclass(frozen=True, slots=True)
class _Chain:
    """The linear problem: (N-1, 6, 6) F and Q, and the (M,) rows that have a difference (M, 6) with covariance R."""

    F: Array
    Q: Array
    rows: NDArray[np.intp]
    d: Array
    R: Array


def anchored(
    smoothed: Sequence[PoseEstimate], fused: Sequence[PoseEstimate], *, memory_s: float = MEMORY_S
) -> list[PoseEstimate]:
    """Return the smoothed poses, moved to where the fused ones are, each with the covariance of its correction.

    All are moved, those whose stamp no fused pose has with their neighbours: the correction drifts slowly.

    Args:
        smoothed: own-only poses in stamp order, with covariance.
        fused: of the same vehicle in the same map frame; stamps that no smoothed pose has are left out.
        memory_s: correlation time of the fused poses' errors [s].

    Raises:
        UavVslamError: no stamps are common.
    """
    if len(smoothed) == 0:
        return []
    chain = _chain_of(smoothed, fused, memory_s)
    corrections, covariances = _solve(chain, len(smoothed))
    return [
        PoseEstimate(pose.stamp_ns, pose.T_map_body.moved(c), P)
        for pose, c, P in zip(smoothed, corrections, covariances, strict=True)
    ]


def _chain_of(smoothed: Sequence[PoseEstimate], fused: Sequence[PoseEstimate], memory_s: float) -> _Chain:
    place = {pose.stamp_ns: row for row, pose in enumerate(smoothed)}
    partners = sorted((place[pose.stamp_ns], k) for k, pose in enumerate(fused) if pose.stamp_ns in place)
    if not partners:
        raise UavVslamError("smoothed and fused poses have no stamp in common; use those of one run of one vehicle")
    rows = np.array([row for row, _ in partners])
    others = [fused[k] for _, k in partners]
    span_s = (others[-1].stamp_ns - others[0].stamp_ns) / NS_PER_S
    inflation = max(1.0, 2.0 * memory_s * max(len(others) - 1, 1) / max(span_s, 1e-9)) if len(others) > 1 else 1.0
    d = np.array(
        [_difference(smoothed[row].T_map_body, other.T_map_body) for row, other in zip(rows, others, strict=True)]
    )
    R = np.array([inflation * other.covariance for other in others])
    steps = [_step(a, b) for a, b in itertools.pairwise(smoothed)]
    F = np.array([step[0] for step in steps]).reshape(-1, 6, 6)
    return _Chain(F, np.array([step[1] for step in steps]).reshape(-1, 6, 6), rows, d, R)


def _step(a: PoseEstimate, b: PoseEstimate) -> tuple[Array, Array]:
    """Return F and Q between two smoothed poses: the covariance grows by the drift between them."""
    moved = b.T_map_body.t - a.T_map_body.t
    F = np.eye(6)
    F[:3, 3:] = -skew(moved)
    values, vectors = np.linalg.eigh(symmetrise(b.covariance - F @ a.covariance @ F.T))
    least = np.diag(LEAST_DRIFT**2) * max(float(np.linalg.norm(moved)), 1e-3)
    return F, (vectors * np.maximum(values, 0.0)) @ vectors.T + least


def _solve(chain: _Chain, count: int) -> tuple[Array, Array]:
    """Return (N, 6) corrections and their (N, 6, 6) covariance."""
    at = {int(row): k for k, row in enumerate(chain.rows)}
    x, P = np.zeros((count, 6)), np.zeros((count, 6, 6))
    predicted_x, predicted_P = np.zeros((count, 6)), np.zeros((count, 6, 6))
    predicted_P[0] = np.diag(UNKNOWN**2)
    for k in range(count):
        if k > 0:
            F = chain.F[k - 1]
            predicted_x[k] = F @ x[k - 1]
            predicted_P[k] = symmetrise(F @ P[k - 1] @ F.T + chain.Q[k - 1])
        x[k], P[k] = predicted_x[k], predicted_P[k]
        if k in at:
            x[k], P[k] = _updated(x[k], P[k], chain.d[at[k]], chain.R[at[k]])
    for k in range(count - 2, -1, -1):
        gain = np.linalg.solve(predicted_P[k + 1], chain.F[k] @ P[k]).T
        x[k] = x[k] + gain @ (x[k + 1] - predicted_x[k + 1])
        P[k] = symmetrise(P[k] + gain @ (P[k + 1] - predicted_P[k + 1]) @ gain.T)
    return x, P


def _updated(x: Array, P: Array, d: Array, R: Array) -> tuple[Array, Array]:
    """Return the belief after a difference; in Joseph's form, as the first one is far better than what was known."""
    gain = np.linalg.solve(P + R, P).T
    rest = np.eye(6) - gain
    return x + gain @ (d - x), symmetrise(rest @ P @ rest.T + gain @ R @ gain.T)


def _difference(smoothed: Pose, fused: Pose) -> Array:
    return np.concatenate([fused.t - smoothed.t, so3_log(fused.R @ smoothed.R.T)])
