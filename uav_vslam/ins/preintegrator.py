# SPDX-License-Identifier: Apache-2.0
"""The inertial stage: readings and image stamps in, one increment per image out; the INS baseline and live odometry."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.preintegration import ImuBuffer, has_gap, preintegrate
from uav_vslam.ins.propagation import propagate, transition
from uav_vslam.types import NS_PER_S, ImuIncrement, ImuSample, NavEstimate, NavState, PoseEstimate

Array = NDArray[np.float64]

MAX_REPLAYED = 5000  # readings kept to be replayed after a correction: 25 s at 200 Hz
MAX_EARLY = 1000  # increments kept until the start state is known


class ImuPreintegrator:
    """Cuts the inertial data at the image stamps.

    All increments are linearised at the start's bias, whatever the filter learns later (their Jacobian carries it):
    so they depend on the recording alone, not on when a correction happened to arrive.

    Attributes:
        start_ns: where the first increment begins; images up to it need none [ns]. None until the first image, where
            no start state was given.
        gaps: increments over which the motion is unknown, at least in part.
    """

    def __init__(self, imu: ImuConfig, start: NavState | None = None) -> None:
        """Cut from the start state on, at its bias; without one from the first image on, at no bias."""
        self._imu = imu
        self._gyro_bias = np.zeros(3) if start is None else start.gyro_bias
        self._accel_bias = np.zeros(3) if start is None else start.accel_bias
        self._buffer = ImuBuffer()
        self._pending: deque[int] = deque()
        self.start_ns = None if start is None else start.stamp_ns
        self._last_ns = self.start_ns
        self.gaps = 0

    def add_imu(self, sample: ImuSample) -> None:
        """Take in a reading; see `ImuBuffer.append` for what is refused."""
        self._buffer.append(sample)

    def add_frame_stamp(self, stamp_ns: int) -> None:
        """Ask for the motion up to an image.

        Raises:
            InvalidMessage: the stamp is not after the previous one.
        """
        if self._last_ns is None:
            self.start_ns = self._last_ns = stamp_ns
            return
        newest = self._pending[-1] if self._pending else self._last_ns
        if stamp_ns <= newest:
            raise InvalidMessage("stamp", f"image stamp {stamp_ns} ns is not after {newest} ns")
        self._pending.append(stamp_ns)

    def increments(self, *, flush: bool = False) -> list[ImuIncrement]:
        """Return the increments that have become complete, in order.

        Args:
            flush: the recording has ended; complete the rest with the readings there are.
        """
        ready: list[ImuIncrement] = []
        while self._last_ns is not None and self._pending and (flush or self._buffer.covers(self._pending[0])):
            stamp_ns = self._pending.popleft()
            samples = self._buffer.cut(self._last_ns, stamp_ns)
            self.gaps += has_gap(samples, self._last_ns, stamp_ns)
            increment = preintegrate(
                samples,
                self._last_ns,
                stamp_ns,
                gyro_bias=self._gyro_bias,
                accel_bias=self._accel_bias,
                imu=self._imu,
            )
            self._last_ns = stamp_ns
            ready.append(increment)
        return ready


class DeadReckoning:
    """The INS baseline: from the start state by increments alone, never corrected.

    Attributes:
        estimate: the newest; None while the start state is not known.
    """

    def __init__(self, imu: ImuConfig) -> None:
        self._imu = imu
        self._startup_buffer: deque[ImuIncrement] = deque(maxlen=MAX_EARLY)
        self.estimate: NavEstimate | None = None

    def start(self, initial: NavEstimate) -> list[NavEstimate]:
        """Return the start state, and the reckoning at the end of each increment that has come since."""
        self.estimate = initial
        reckoned, early = [initial], list(self._startup_buffer)
        self._startup_buffer.clear()
        for increment in early:
            if increment.start_ns >= initial.state.stamp_ns:
                reckoned += self.add(increment)
        return reckoned

    def add(self, increment: ImuIncrement) -> list[NavEstimate]:
        """Return the reckoning at the end of an increment; none while the start state is not known."""
        if self.estimate is None:
            self._startup_buffer.append(increment)
            return []
        self.estimate = advance(self.estimate, increment, self._imu)
        return [self.estimate]


class InsPropagator:
    """Increments, each with the dead reckoning at its end, where the start state is known beforehand."""

    def __init__(self, initial: NavEstimate, imu: ImuConfig) -> None:
        self._preintegrator = ImuPreintegrator(imu, initial.state)
        self._reckoning = DeadReckoning(imu)
        self._reckoning.start(initial)
        self.add_imu = self._preintegrator.add_imu
        self.add_frame_stamp = self._preintegrator.add_frame_stamp

    def increments(self, *, flush: bool = False) -> list[tuple[ImuIncrement, NavEstimate]]:
        """Return what has become complete, in order; see `ImuPreintegrator.increments`."""
        return [
            (increment, reckoned)
            for increment in self._preintegrator.increments(flush=flush)
            for reckoned in self._reckoning.add(increment)
        ]


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
