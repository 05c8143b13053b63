# SPDX-License-Identifier: Apache-2.0
"""The states that a run over a recorded flight may start from.

recorded    the start state that the recording holds
drawn N     the same with an error drawn from its own covariance by seed N
frame K     the true pose and velocity at a later frame. A recording holds no true biases there, so they are those
            of the recorded start, with the variance of their random walk since then added
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.pairing import MAX_GAP_S
from uav_vslam.evaluation.trajectory import interpolate
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.propagation import ACCEL_BIAS, GYRO_BIAS, POSITION, ROTATION, VELOCITY
from uav_vslam.studies.engine.recorded_flights import RecordedFlight
from uav_vslam.types import NS_PER_S, NavEstimate, NavState

Array = NDArray[np.float64]

LATER_SHARES = (0.25, 0.5, 0.75)  # of the frames, where the later starts are


@dataclass(frozen=True, slots=True)
class Start:
    """A start state of a run, and its name."""

    name: str
    estimate: NavEstimate


def starts_of(flight: RecordedFlight, imu: ImuConfig, seeds: Sequence[int]) -> list[Start]:
    """Return the recorded start, one drawn by each seed, and the later ones."""
    drawn = [Start(f"drawn {seed}", drawn_start(flight.initial_state, np.random.default_rng(seed))) for seed in seeds]
    frames = [round(share * len(flight.frame_stamps_ns)) for share in LATER_SHARES]
    later = [Start(f"frame {frame}", true_start(flight, frame, imu)) for frame in frames]
    return [Start("recorded", flight.initial_state), *drawn, *later]


def drawn_start(centre: NavEstimate, rng: np.random.Generator) -> NavEstimate:
    """Return an estimate whose error, if the truth is at the centre, is drawn from the centre's covariance."""
    error = np.linalg.cholesky(centre.covariance) @ rng.standard_normal(len(centre.covariance))
    state, T = centre.state, centre.state.T_map_body
    moved = NavState(
        state.stamp_ns,
        Pose(so3_exp(-error[ROTATION]) @ T.R, T.t - error[POSITION]),
        state.v_map - error[VELOCITY],
        state.gyro_bias - error[GYRO_BIAS],
        state.accel_bias - error[ACCEL_BIAS],
    )
    return NavEstimate(moved, centre.covariance)


def true_start(flight: RecordedFlight, frame: int, imu: ImuConfig) -> NavEstimate:
    """Return the true pose and velocity at a frame, with the recorded start's covariance plus the biases' walk.

    Raises:
        UavVslamError: there is no truth at that frame.
    """
    stamp_ns = int(flight.frame_stamps_ns[frame])
    pose, rows = interpolate(flight.truth, np.array([stamp_ns]), max_gap_s=MAX_GAP_S)
    if len(rows) == 0:
        raise UavVslamError(f"{flight.vehicle}: no truth at frame {frame} ({stamp_ns} ns), where a run should start")
    since_ns = flight.truth.stamps_ns - stamp_ns
    velocity = np.array([np.interp(0.0, since_ns, component) for component in flight.velocities.T])
    recorded = flight.initial_state
    dt_s = (stamp_ns - recorded.state.stamp_ns) / NS_PER_S
    P = recorded.covariance.copy()
    P[GYRO_BIAS, GYRO_BIAS] += imu.gyro_bias_walk**2 * dt_s * np.eye(3)
    P[ACCEL_BIAS, ACCEL_BIAS] += imu.accel_bias_walk**2 * dt_s * np.eye(3)
    T_map_body = Pose(pose.rotations[0], pose.positions[0])
    state = NavState(stamp_ns, T_map_body, velocity, recorded.state.gyro_bias, recorded.state.accel_bias)
    return NavEstimate(state, P)
