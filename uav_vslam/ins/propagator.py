# SPDX-License-Identifier: Apache-2.0
"""The inertial stage: readings and image stamps in, one increment per image out, and the INS baseline beside it."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.preintegration import ImuBuffer, preintegrate
from uav_vslam.ins.propagation import propagate, transition
from uav_vslam.types import NS_PER_S, ImuIncrement, ImuSample, NavEstimate, NavState, PoseEstimate

Array = NDArray[np.float64]

MAX_REPLAYED = 5000  # readings kept to be replayed after a correction: 25 s at 200 Hz


class InsPropagator:
    """Cuts the inertial data at the image stamps.

    All increments are linearised at the start's bias, whatever the filter learns later (their Jacobian carries it):
    so they depend on the recording alone, not on when a correction happened to arrive.
    """

    def __init__(self, initial: NavEstimate, imu: ImuConfig) -> None:
        self._imu = imu
        self._start = initial.state
        self._buffer = ImuBuffer()
        self._pending: deque[int] = deque()
        self._last_ns = initial.state.stamp_ns
        self.dead_reckoning = initial  # never corrected

    def add_imu(self, sample: ImuSample) -> None:
        """Take in a reading; see `ImuBuffer.append` for what is refused."""
        self._buffer.append(sample)

    def add_frame_stamp(self, stamp_ns: int) -> None:
        """Ask for the motion up to an image.

        Raises:
            InvalidMessage: the stamp is not after the previous one.
        """
        newest = self._pending[-1] if self._pending else self._last_ns
        if stamp_ns <= newest:
            raise InvalidMessage("stamp", f"image stamp {stamp_ns} ns is not after {newest} ns")
        self._pending.append(stamp_ns)

    @property
    def start_ns(self) -> int:
        """Stamp of the start state; images up to it need no increment [ns]."""
        return self._start.stamp_ns

    def increments(self, *, flush: bool = False) -> list[tuple[ImuIncrement, NavEstimate]]:
        """Return the increments that have become complete, in order, each with the dead reckoning at its end.

        Args:
            flush: the recording has ended; complete the rest with the readings there are.
        """
        ready = []
        while self._pending and (flush or self._buffer.covers(self._pending[0])):
            stamp_ns = self._pending.popleft()
            increment = preintegrate(
                self._buffer.cut(self._last_ns, stamp_ns),
                self._last_ns,
                stamp_ns,
                gyro_bias=self._start.gyro_bias,
                accel_bias=self._start.accel_bias,
                imu=self._imu,
            )
            self._last_ns = stamp_ns
            self.dead_reckoning = advance(self.dead_reckoning, increment, self._imu)
            ready.append((increment, self.dead_reckoning))
        return ready


def advance(estimate: NavEstimate, increment: ImuIncrement, imu: ImuConfig) -> NavEstimate:
    """Dead-reckon a navigation estimate, covariance included."""
    F, Q = transition(estimate.state, increment, imu)
    state = propagate(estimate.state, increment, gravity=imu.gravity)
    return NavEstimate(state, F @ estimate.covariance @ F.T + Q)


class InsOdometry:
    """Navigation state at the rate of the inertial unit: the newest correction plus the readings since."""

    def __init__(self, initial: NavEstimate, imu: ImuConfig) -> None:
        self._gravity = np.array([0.0, 0.0, -imu.gravity])
        self._since: deque[ImuSample] = deque(maxlen=MAX_REPLAYED)
        self._corrected = initial
        self.state = initial.state

    @property
    def pose(self) -> PoseEstimate:
        """The newest pose with the covariance of the newest correction, a fraction of a second old."""
        return PoseEstimate(self.state.stamp_ns, self.state.T_map_body, self._corrected.pose.covariance)

    def add_imu(self, sample: ImuSample) -> NavState:
        """Step to a reading and return the state there; readings from before the state change nothing."""
        self._since.append(sample)
        self.state = self._step(self.state, sample)
        return self.state

    def correct(self, corrected: NavEstimate) -> None:
        """Restart from a corrected state and replay the readings since its stamp."""
        while self._since and self._since[0].stamp_ns <= corrected.state.stamp_ns:
            self._since.popleft()
        self._corrected = corrected
        self.state = corrected.state
        for sample in self._since:
            self.state = self._step(self.state, sample)

    def _step(self, state: NavState, sample: ImuSample) -> NavState:
        """Hold the reading since the state's stamp: half a sample of delay is below this output's needs."""
        dt = (sample.stamp_ns - state.stamp_ns) / NS_PER_S
        if dt <= 0:
            return state
        R, v = state.T_map_body.R, state.v_map
        accel_map = R @ (sample.accel - state.accel_bias) + self._gravity
        pose = Pose(
            R @ so3_exp((sample.gyro - state.gyro_bias) * dt), state.T_map_body.t + (v + 0.5 * accel_map * dt) * dt
        )
        return NavState(sample.stamp_ns, pose, v + accel_map * dt, state.gyro_bias, state.accel_bias)
