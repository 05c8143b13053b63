# SPDX-License-Identifier: Apache-2.0
"""The inertial stage: readings and image stamps in, one increment per image out; the INS baseline."""

from collections import deque

import numpy as np

from uav_vslam.config import ImuConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.ins.imu_buffer import ImuBuffer
from uav_vslam.ins.imu_statistics import ImuStatistics
from uav_vslam.ins.increments import bridged
from uav_vslam.ins.preintegration import has_gap, preintegrate
from uav_vslam.ins.propagation import corrected, propagate, transition
from uav_vslam.types import ImuIncrement, ImuSample, NavEstimate, NavState

MAX_BUFFERED = 1000  # increments buffered until the start state is known


class ImuPreintegrator:
    """Preintegrates the readings between image stamps.

    All increments are linearised at the start's bias, not at later estimates (the Jacobian corrects for them), so they
    depend on the recording alone, not on the timing of corrections.

    Attributes:
        start_ns: start of the first increment; images up to it have none [ns]. None until the first image if there is
            no start state.
        gaps: number of increments with a gap in the readings.
    """

    def __init__(self, imu: ImuConfig, start: NavState | None = None, *, at_next_image: bool = False) -> None:
        """Start at the start state with its bias; without one at the first image with zero bias.

        With `at_next_image` only the bias is the start state's.
        """
        self._gyro_bias = np.zeros(3) if start is None else start.gyro_bias
        self._accel_bias = np.zeros(3) if start is None else start.accel_bias
        self._buffer = ImuBuffer(imu)
        self._pending: deque[int] = deque()
        self.start_ns = None if start is None or at_next_image else start.stamp_ns
        self._last_ns = self.start_ns
        self.gaps = 0

    @property
    def statistics(self) -> ImuStatistics:
        """Return those of all readings so far."""
        return self._buffer.statistics

    def add_imu(self, sample: ImuSample) -> None:
        """Add a reading; see `ImuBuffer.append` for what is rejected."""
        self._buffer.append(sample)

    def add_frame_stamp(self, stamp_ns: int) -> None:
        """Request the motion up to an image.

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
        """Return the newly completed increments, in order.

        Args:
            flush: the recording has ended; complete the rest with the available readings.
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
                imu=self._buffer.imu,
                period_s=self._buffer.period_s,
            )
            self._last_ns = stamp_ns
            ready.append(increment)
        return ready


class DeadReckoning:
    """The INS baseline: dead reckoning from the start state, never corrected; until that is known, increments wait.

    Attributes:
        estimate: the newest; None until the start state is known.
    """

    def __init__(self, imu: ImuConfig) -> None:
        self._imu = imu
        self._startup_buffer: deque[ImuIncrement] = deque(maxlen=MAX_BUFFERED)
        self.estimate: NavEstimate | None = None

    def start(self, initial: NavEstimate) -> list[NavEstimate]:
        """Return the start state and the dead-reckoned state at the end of each increment since."""
        self.estimate = initial
        states, buffered = [initial], list(self._startup_buffer)
        self._startup_buffer.clear()
        for increment in buffered:
            if increment.start_ns >= initial.state.stamp_ns:
                states += self.add(increment)
        return states

    def add(self, increment: ImuIncrement) -> list[NavEstimate]:
        """Return the dead-reckoned state at the end of an increment; empty until the start state is known."""
        if self.estimate is None:
            self._startup_buffer.append(increment)
            return []
        self.estimate = dead_reckoned(self.estimate, increment, self._imu)
        return [self.estimate]


def dead_reckoned(estimate: NavEstimate, increment: ImuIncrement, imu: ImuConfig) -> NavEstimate:
    """Return an estimate at the end of a later increment; what is lost of the motion in between is unknown."""
    return advance(estimate, bridged(increment, estimate.state.stamp_ns, imu), imu)


def advance(estimate: NavEstimate, increment: ImuIncrement, imu: ImuConfig) -> NavEstimate:
    """Dead-reckon a navigation estimate, covariance included."""
    deltas = corrected(increment, estimate.state.gyro_bias, estimate.state.accel_bias)
    F, Q = transition(estimate.state, increment, imu, deltas=deltas)
    state = propagate(estimate.state, increment, gravity=imu.gravity, deltas=deltas)
    return NavEstimate(state, F @ estimate.covariance @ F.T + Q)
