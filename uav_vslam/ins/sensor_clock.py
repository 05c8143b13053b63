# SPDX-License-Identifier: Apache-2.0
"""The time line of a vehicle's sensors, and what a jump of their clock does to an estimate (`input.on_time_jump`)."""

import dataclasses
from typing import Any

from uav_vslam.config import ImuConfig
from uav_vslam.ins.preintegration import unknown_motion
from uav_vslam.ins.propagation import transition
from uav_vslam.stamps import IMAGE_TIME_JUMP_S, IMU_TIME_JUMP_S, TimeJump, TimeLine
from uav_vslam.types import NS_PER_S, NavEstimate

IMU, IMAGES = "IMU", "image"  # streams of the time line
MOST_BRIDGED_S = 30.0  # of a jump ahead; beyond it an estimate is worth no more than a new start
EARLY_STARTS = 4  # start states remembered that belong to no known time line
MOST_ELAPSED_S = 60.0  # flown unseen, however far a clock was set


def sensor_time_line(policy: str) -> TimeLine[Any]:
    """Return the time line of readings and frames, which must agree to be paired; a frame is whatever stands for it."""
    streams = {IMU: IMU_TIME_JUMP_S, IMAGES: IMAGE_TIME_JUMP_S}
    return TimeLine(streams, apart_s=IMU_TIME_JUMP_S, reference=IMU, follow=policy != "refuse")


def bridges(jump: TimeJump, policy: str) -> bool:
    """Return whether the motion goes on over a jump, as unknown; otherwise the stage starts again."""
    return policy == "bridge" and 0.0 < jump.size_s <= MOST_BRIDGED_S


def carried_over(estimate: NavEstimate, stamp_ns: int, imu: ImuConfig) -> NavEstimate:
    """Return an estimate as the start state after a jump of the clock.

    Nobody knows how much time has passed, from none to all of the jump: the mean stays, the covariance grows as by
    unknown motion over the jump.

    Args:
        estimate: the last one before the jump.
        stamp_ns: of the first frame after it, by the new clock [ns].
        imu: gravity.
    """
    state = estimate.state
    elapsed_ns = min(abs(stamp_ns - state.stamp_ns), round(MOST_ELAPSED_S * NS_PER_S)) or 1
    bias = {"gyro_bias": state.gyro_bias, "accel_bias": state.accel_bias}
    F, Q = transition(state, unknown_motion(state.stamp_ns, state.stamp_ns + elapsed_ns, **bias, imu=imu), imu)
    return NavEstimate(dataclasses.replace(state, stamp_ns=stamp_ns), F @ estimate.covariance @ F.T + Q)
