# SPDX-License-Identifier: Apache-2.0
"""Navigation between corrections: the newest one propagated by the readings since, and odometry without jumps."""

from collections import deque
from dataclasses import dataclass

from uav_vslam.config import ImuConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.pose import Pose
from uav_vslam.ins.imu_statistics import ImuStatistics
from uav_vslam.ins.increments import bridged
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.ins.preintegrator import advance
from uav_vslam.types import NS_PER_S, ImuIncrement, ImuSample, NavEstimate

MAX_STEPS = 2500  # retained for replay after a correction: 50 s at 50 Hz
MAX_AHEAD_S = 1.0  # of a correction before the newest reading; the clocks of sensors and back end disagree otherwise


@dataclass(frozen=True, slots=True)
class _Step:
    """The motion between two outputs, and the readings that it was made of."""

    increment: ImuIncrement
    readings: list[ImuSample]
    period_s: float  # their usual spacing as of the last
    imu: ImuConfig  # with their noise as of the last


class LiveOdometry:
    """Propagates the newest correction to the readings, once in a period.

    A correction moves the estimate in the map at once. The odometry frame has no such jumps (REP-105): its pose sums up
    the motion of the corrected estimate alone, so its drift is that of the corrected velocity and attitude.

    Attributes:
        estimate: newest output, in the map frame; its covariance is propagated as well.
        increment: motion since the output before; None until there is one.
        T_odom_body: the pose in the odometry frame at the same stamp.
    """

    def __init__(self, initial: NavEstimate, imu: ImuConfig, statistics: ImuStatistics, *, period_s: float) -> None:
        """Start at a state, where both frames coincide.

        Args:
            initial: the state.
            imu: gravity and bias walks.
            statistics: of the readings; the caller adds each to them before it adds it here.
            period_s: of the output [s]; 0 makes one at each reading.
        """
        self._imu, self._statistics, self._period_ns = imu, statistics, round(period_s * NS_PER_S)
        self._biases = initial.state.gyro_bias, initial.state.accel_bias
        self._steps: deque[_Step] = deque(maxlen=MAX_STEPS)
        self._readings: list[ImuSample] = []  # from the newest output on, and the last one before it
        self._pending: NavEstimate | None = None
        self._corrected_ns = -1  # stamp of the newest correction
        self.estimate = initial
        self.increment: ImuIncrement | None = None
        self.T_odom_body = initial.state.T_map_body

    @property
    def T_map_odom(self) -> Pose:
        """The odometry frame in the map frame, as the newest correction has moved it."""
        return self.estimate.state.T_map_body @ self.T_odom_body.inverse()

    def add_imu(self, sample: ImuSample) -> bool:
        """Add a reading; return whether it made a new output."""
        start_ns = self.estimate.state.stamp_ns
        self._readings.append(sample)
        if sample.stamp_ns <= start_ns:
            self._readings = self._readings[-1:]
            return False
        if not self._is_due(sample.stamp_ns - start_ns):
            return False
        period_s, imu = self._statistics.period_s, self._statistics.imu
        increment = self._preintegrated(self._readings, period_s, imu, start_ns, sample.stamp_ns)
        self._steps.append(_Step(increment, self._readings, period_s, imu))
        self._readings = [sample]
        before = self.estimate.state.T_map_body
        self.increment = increment
        self.estimate = advance(self.estimate, increment, self._imu)
        self.T_odom_body = self.T_odom_body @ before.inverse() @ self.estimate.state.T_map_body
        if self._pending is not None and self._pending.state.stamp_ns <= sample.stamp_ns:
            self._apply(self._pending)
        return True

    def correct(self, corrected: NavEstimate) -> None:
        """Restart from a corrected state and replay the motion since its stamp; one that is not newer changes nothing.

        Raises:
            InvalidMessage: its stamp is far ahead of the readings.
        """
        if corrected.state.stamp_ns <= self._corrected_ns:  # a restarted back end repeats itself
            return
        ahead_s = (corrected.state.stamp_ns - self.estimate.state.stamp_ns) / NS_PER_S
        if ahead_s > MAX_AHEAD_S:
            raise InvalidMessage(
                "stamp_ahead",
                f"a correction is {ahead_s:.1f} s ahead of the newest IMU reading, more than {MAX_AHEAD_S:g} s; "
                "do the clocks of cameras and IMU agree?",
            )
        if ahead_s > 0:
            self._pending = corrected
        else:
            self._apply(corrected)

    def _is_due(self, since_ns: int) -> bool:
        """Return whether an output falls on this reading rather than on the next one."""
        spacing_ns = self._readings[-1].stamp_ns - self._readings[-2].stamp_ns if len(self._readings) > 1 else 0
        return since_ns + spacing_ns // 2 >= self._period_ns

    def _apply(self, corrected: NavEstimate) -> None:
        self._pending = None
        self._corrected_ns = stamp_ns = corrected.state.stamp_ns
        while self._steps and self._steps[0].increment.stamp_ns <= stamp_ns:
            self._steps.popleft()
        for step in self._steps:
            corrected = advance(corrected, self._since(step, corrected.state.stamp_ns), self._imu)
        self.estimate = corrected

    def _since(self, step: _Step, stamp_ns: int) -> ImuIncrement:
        """Return the part of a step's motion after a stamp, or all from an earlier one on, as far as it is known."""
        increment = step.increment
        if increment.start_ns < stamp_ns:
            return self._preintegrated(step.readings, step.period_s, step.imu, stamp_ns, increment.stamp_ns)
        return bridged(increment, stamp_ns, self._imu)

    def _preintegrated(
        self, readings: list[ImuSample], period_s: float, imu: ImuConfig, start_ns: int, stamp_ns: int
    ) -> ImuIncrement:
        gyro_bias, accel_bias = self._biases
        return preintegrate(
            readings,
            start_ns,
            stamp_ns,
            gyro_bias=gyro_bias,
            accel_bias=accel_bias,
            imu=imu,
            period_s=period_s,
        )
