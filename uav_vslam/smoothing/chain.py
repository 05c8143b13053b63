# SPDX-License-Identifier: Apache-2.0
"""The states of a flight and the measured motion between them as least squares.

The error of a state is that of `NavEstimate`: position, velocity, rotation xi (R_true = Exp(xi) R) and biases, all in
the map frame. The motion between neighbours has the transition F and noise Q of the filter, `ins.propagation`: with the
residual r = x[k+1] - f(x[k]), the term is |L^-1 (r + d[k+1] - F d[k])|^2 with L L^T = Q.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from uav_vslam.config import ImuConfig
from uav_vslam.ins.propagation import NAV_DIM, propagate, transition
from uav_vslam.numerics import cholesky
from uav_vslam.smoothing.arrowhead import Arrowhead
from uav_vslam.smoothing.cameras import MODEL, RigEstimate
from uav_vslam.smoothing.layout import Layout
from uav_vslam.types import ImuIncrement, NavEstimate, NavState

Array = NDArray[np.float64]

NO_LANDMARKS: Array = np.zeros((0, 3))


def moved(states: Sequence[NavState], step: Array) -> list[NavState]:
    """Return the states after corrections (N, 15)."""
    return [MODEL.retract(state, NO_LANDMARKS, d)[0] for state, d in zip(states, step, strict=True)]


def add_start(system: Arrowhead, start: NavEstimate, state: NavState) -> None:
    """Add the prior of the first state."""
    whiten = _whitening(start.covariance, "covariance of the start state")
    first = slice(0, NAV_DIM)
    residual = whiten @ MODEL.local(state, start.state)
    system.diagonal[0, first, first] += whiten.T @ whiten
    system.rhs[0, first] += whiten.T @ residual


def add_motion(
    system: Arrowhead, layout: Layout, states: Sequence[NavState], increments: Sequence[ImuIncrement], imu: ImuConfig
) -> None:
    """Add the motion between all neighbours."""
    for k, increment in enumerate(increments):
        F, Q = transition(states[k], increment, imu)
        whiten = _whitening(Q, f"noise of the motion that ends at {increment.stamp_ns} ns")
        residual = whiten @ MODEL.local(states[k + 1], propagate(states[k], increment, gravity=imu.gravity))
        before = -whiten @ F
        (block, rows), (block_to, rows_to) = layout.place(k), layout.place(k + 1)
        system.diagonal[block, rows, rows] += before.T @ before
        system.diagonal[block_to, rows_to, rows_to] += whiten.T @ whiten
        if block == block_to:
            system.diagonal[block, rows_to, rows] += whiten.T @ before
            system.diagonal[block, rows, rows_to] += before.T @ whiten
        else:
            system.below[block, rows_to, rows] += whiten.T @ before
        system.rhs[block, rows] += before.T @ residual
        system.rhs[block_to, rows_to] += whiten.T @ residual


def add_rig(system: Arrowhead, layout: Layout, rig: RigEstimate) -> None:
    """Add the priors of the rig's errors: of the constant ones, and of the vibration of each state."""
    rows, information = np.arange(layout.rig), np.linalg.inv(rig.errors.prior_covariance)
    system.border[rows[:, None], rows] += information
    system.border_rhs[rows] -= information @ rig.constant
    if not rig.vibrates:
        return
    for state, vibration in enumerate(rig.vibration):
        block, nav = layout.place(state)
        own = np.arange(nav.stop, nav.stop + layout.vibration)
        system.diagonal[block, own, own] += 1.0 / rig.errors.vibration_variance
        system.rhs[block, own] -= vibration / rig.errors.vibration_variance


def fill_up(system: Arrowhead, layout: Layout) -> None:
    """Give the rows of the last block that no state has a unit diagonal, so that they are zero."""
    used = layout.states - (layout.blocks - 1) * layout.size
    rest = np.arange(used * layout.stride, layout.size * layout.stride)
    system.diagonal[-1, rest, rest] = 1.0


def _whitening(covariance: Array, what: str) -> Array:
    """Return the inverse of the Cholesky factor, scaled to unit variances in between: units differ by far."""
    scale = np.sqrt(np.diagonal(covariance))
    L = cholesky(covariance / np.outer(scale, scale), what)
    return np.asarray(solve_triangular(L, np.diag(1.0 / scale), lower=True))
