# SPDX-License-Identifier: Apache-2.0
"""ins_propagator: preintegrates IMU samples between images, and propagates inertial odometry.

in   imu/data_raw         sensor_msgs/Imu
     left/camera_info     sensor_msgs/CameraInfo; its stamps are those of the images. With input.calibration the left
                          image instead
     /tf_static           <vehicle>/base_link to the IMU's frame, if that is another one
     initial_state        uav_vslam_msgs/NavigationState, latched; an output instead with start.method static,
                          and from the back end with in_flight and map
     slam/correction      uav_vslam_msgs/NavigationState, from the back end
out  ins/increment        uav_vslam_msgs/InsIncrement, one per image
     ins/dead_reckoning   nav_msgs/Odometry per image, map frame, never corrected: the INS baseline
     ins/odometry         nav_msgs/Odometry at odometry_rate_hz, map frame, corrected
     /tf                  at odometry_rate_hz: <vehicle>/odom to <vehicle>/base_link, continuous, and <vehicle>/map to
                          <vehicle>/odom, which takes the steps of corrections
"""

from collections import deque

from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo

from uav_vslam.datasets.messages import header_stamp_ns, stamp_ns_of
from uav_vslam.errors import InvalidMessage, UavVslamError
from uav_vslam.ins.alignment import biased_rest, static_alignment
from uav_vslam.ins.live_odometry import LiveOdometry
from uav_vslam.ins.outliers import OUTLIER, OutlierFilter
from uav_vslam.ins.pending_start import PendingStart, Refusal
from uav_vslam.ins.preintegrator import DeadReckoning, ImuPreintegrator
from uav_vslam.ins.sensor_clock import EARLY_STARTS, bridges, carried_over, sensor_time_line
from uav_vslam.ins.sensor_lag import IMAGES, IMU
from uav_vslam.ins.startup_buffer import MAX_APART_S, MAX_UNCOVERED_S, StartupBuffer
from uav_vslam.ros.batches import Batches
from uav_vslam.ros.calibration import ImuListener
from uav_vslam.ros.convert import increment_to_msg, navigation_from_msg, navigation_to_msg
from uav_vslam.ros.inputs import Input, image_topics
from uav_vslam.ros.ins_outputs import InsOutputs
from uav_vslam.ros.ins_status import InsStatus
from uav_vslam.ros.qos import IMAGE, LATCHED, MOTION, NEWEST, STAMPS
from uav_vslam.ros.runtime import run_node
from uav_vslam.ros.timers import create_wall_timer
from uav_vslam.ros.vehicle_node import VehicleNode
from uav_vslam.stamps import Admitted, TimeJump
from uav_vslam.types import NS_PER_S, ImuIncrement, ImuSample, NavEstimate
from uav_vslam_msgs.msg import InsIncrement, NavigationState

SHORTEST_NS = NS_PER_S // 1000  # time between two looks at the readings


class InsPropagatorNode(VehicleNode):
    """Feeds `ImuPreintegrator`, `DeadReckoning` and `LiveOdometry`; buffers input until the start state arrives."""

    def __init__(self) -> None:
        super().__init__("ins_propagator")
        topics = self.config.input.topics
        self._policy = self.config.input.on_time_jump
        self._aligns = self.config.start.method == "static"
        self._starts: deque[NavigationState] = deque(maxlen=EARLY_STARTS)  # received in flight
        self._stamps = sensor_time_line(self._policy)
        self._image_ns = -1
        self._period_s = 1.0 / self.own.odometry_rate_hz if self.own.odometry_rate_hz else 0.0
        self._is_reset = False  # by itself: the back end may be in flight
        self._correction: NavigationState | None = None  # the newest
        self._resumed = False  # from a correction of before a reset, which no newer one has confirmed
        self._starts_again = False  # after a jump of the clock, which ends the back end's session as well
        self._in_batch = False
        self._forget_flight()
        self._increments = self.advertise(InsIncrement, "ins/increment", MOTION)
        self._outputs = InsOutputs(self)
        if self._aligns:
            self._initial_state = self.advertise(NavigationState, topics.initial_state, LATCHED)
        else:
            self.listen(NavigationState, topics.initial_state, self._on_initial_state, LATCHED)
        self._batches, self._reading_ns = Batches(at_once=True), -1
        self._sensors = ImuListener(self, self._on_reading, self._batches)
        self._status = InsStatus(self, self._sensors)
        if self._period_s:
            self._timer = create_wall_timer(self, self._period_s, self._take_waiting)
        self._images = [
            self.listen(kind, name, self._on_stamped, qos, instead_of=stands_for, raw=True)
            for kind, name, qos, stands_for in self._stamped_topics()
        ]
        self.listen(NavigationState, "slam/correction", self._on_correction, NEWEST)

    def _stamped_topics(self) -> list[tuple[type, str, QoSProfile, str]]:
        """Return type, name, QoS and the topic it stands for, of what has the images' stamps."""
        topics = self.config.input.topics
        if self._sensors.setup.needs_infos:
            return [(CameraInfo, topics.left_info, STAMPS, topics.left_info)]
        return [(kind, name, IMAGE, topics.left) for kind, name in image_topics(self, topics.left).items()]

    def _forget_flight(self) -> None:
        """Start from the state before the first message; a search for the start state needs increments already."""
        self._preintegrator = ImuPreintegrator(self.config.imu) if self.config.start.searches else None
        self._reckoner = DeadReckoning(self.config.imu)
        self._outliers = OutlierFilter()
        self._live: LiveOdometry | None = None
        self._startup_buffer = StartupBuffer(self.config.start.rest_s if self._aligns else MAX_APART_S)
        self._pending_start = PendingStart(self._startup_buffer)
        self.alarms.pop("imu_stamps", None)

    def reset(self) -> None:
        """Start again, at whatever stamps come next.

        A back end in flight makes no correction without increments: those from its newest one on.
        """
        self._starts.clear()
        self._stamps.restart()
        self._sensors.restart()
        self._forget_flight()
        self._is_reset, self._starts_again = True, False
        last = self._correction
        if self.config.start.method == "given" and last is not None and self._is_recent(stamp_ns_of(last)):
            self._on_correction(last)
            self._resumed = True
        self._status.restart()  # that correction says nothing about later ones

    def _is_recent(self, stamp_ns: int) -> bool:
        return abs(self._reading_ns - stamp_ns) <= MAX_APART_S * NS_PER_S

    def _take_waiting(self) -> None:
        """Take the image stamps and readings that wait; be back when the reading is due that makes the next odometry.

        On a machine that is behind, a turn of the executor takes so long that one image in each turn would not do.
        """
        self._take(*self._images)
        if self._live is not None:
            period_ns = round(self._period_s * NS_PER_S)
            beyond_ns = self._reading_ns - self._live.estimate.state.stamp_ns
            wait_ns = period_ns - beyond_ns if SHORTEST_NS < period_ns - beyond_ns < period_ns else period_ns
            if wait_ns != self._timer.timer_period_ns:
                self._timer.timer_period_ns = wait_ns
                self._timer.reset()

    def _take(self, *first: Input) -> None:
        """Take what waits of some inputs, then of the readings; no more than their queues, so that all else goes on."""
        self._in_batch = True
        for one in first:
            one.take_waiting(self)
        self._sensors.take_readings()
        self._in_batch = False
        self._outputs.publish_transforms()

    def _on_reading(self, reading: ImuSample) -> None:
        self._reading_ns = reading.stamp_ns
        self._feed(IMU, reading.stamp_ns, reading)
        self._batches.at_once = not self._period_s or self._live is None or reading.stamp_ns < self._image_ns

    def _on_stamped(self, data: bytes) -> None:
        stamp_ns = header_stamp_ns(data) + self._sensors.setup.time_offset_ns
        if stamp_ns != self._image_ns:  # the same image raw and compressed
            if not self._in_batch:
                self._take()
            self._image_ns = stamp_ns
            self._status.report_image(self._reading_ns, stamp_ns)
            self._feed(IMAGES, stamp_ns, stamp_ns)
            self._batches.at_once = True  # for the readings that it may wait for

    def _on_initial_state(self, message: NavigationState) -> None:
        given = navigation_from_msg(message)  # one that is invalid is refused now, not at the jump that would need it
        if self._resumed:  # the whole vehicle was reset: what the back end estimated before no longer counts
            self._resumed = False
            self._forget_flight()
        if self._live is not None:
            self._starts.append(message)
            return
        if self._preintegrator is not None:  # found in flight by the back end
            self._start(given)
            return
        self._pending_start.give(given, message.child_frame_id)
        self._start_if_confirmed()

    def _start_if_confirmed(self) -> None:
        """Start once IMU samples are near the start state's stamp, or say why there is no estimate until another."""
        ahead_s = self._pending_start.ahead_s
        if ahead_s is not None:
            self.notes["start"] = f"given {ahead_s:+.1f} s from the newest IMU sample"
        waits = ahead_s is not None and ahead_s > MAX_APART_S
        early = f"no start yet: initial_state is stamped {ahead_s:.1f} s after the newest IMU sample" if waits else ""
        self.report_alarm("start_ahead", early, logged=True)
        found = self._pending_start.confirmed(self._sensors.setup.conflict)
        if isinstance(found, Refusal):
            self.drop(found.reason, found.text)
            self.alarms["start"] = f"no start: {found.text}"
        elif found is not None:
            unplaced = self._sensors.setup.unplaced(self._pending_start.frame)
            self.report_alarm("start_frame", f"initial_state {unplaced}" if unplaced else "", logged=True)
            self._start(found)

    def _start(self, initial: NavEstimate) -> None:
        self._starts_again = False
        self.alarms.pop("start", None)
        is_resumed = self._pending_start.is_resumed(initial.state.stamp_ns)
        early = self._startup_buffer.take(from_first_reading=is_resumed)
        for estimate in self._reckoner.start(initial):
            self._outputs.publish_dead_reckoning(estimate, None)
        already_running = self._preintegrator is not None  # in flight, increments are needed before the start state
        if self._preintegrator is None:
            # restarted in flight: the images show the back end the motion up to the next one
            self._preintegrator = ImuPreintegrator(self.config.imu, initial.state, at_next_image=is_resumed)
        statistics = self._preintegrator.statistics
        self._live = LiveOdometry(initial, self.config.imu, statistics, period_s=self._period_s)
        for item in early:
            try:
                if not already_running:
                    self._preintegrate(self._preintegrator, item)
                self._propagate(self._live, item)
            except InvalidMessage as error:
                self.drop(error.reason, str(error))

    def _feed(self, name: str, stamp_ns: int, item: ImuSample | int) -> None:
        """Process what the time line lets through, in arrival order."""
        admitted = self._stamps.add(name, stamp_ns, item)
        happened = self._follow(admitted.jump, admitted) if admitted.jump is not None else ""
        self.report_clock(self._stamps, happened)
        for _, due in admitted.items:
            for one in self._plausible(due) if isinstance(due, ImuSample) else [due]:
                try:
                    self._process(one)
                except InvalidMessage as error:
                    self.drop(error.reason, f"{name}: {error}")

    def _plausible(self, reading: ImuSample) -> list[ImuSample]:
        """Return the readings that are no outliers, as far as it is known by now."""
        judged = self._outliers.add(reading)
        if judged.outlier is not None:
            self.drop(OUTLIER, judged.finding)
        return judged.readings

    def _follow(self, jump: TimeJump, admitted: Admitted[ImuSample | int]) -> str:
        """Go on after a jump of the clock as configured; return what was done."""
        if bridges(jump, self._policy):
            return f"{jump}; the motion in between is unknown"
        first_ns = next((item for _, item in admitted.items if isinstance(item, int)), jump.to_ns)
        before, start = self._live.estimate if self._live is not None else None, self._start_near(first_ns)
        self._forget_flight()
        self._correction, self._starts_again = None, True
        if start is not None:
            self._pending_start.give(navigation_from_msg(start), start.child_frame_id)
            return f"{jump}; started again from the newest start state"
        if before is None or self._policy != "bridge":
            return f"{jump}; it starts again"
        self._preintegrator = self._preintegrator or ImuPreintegrator(self.config.imu)
        self._start(carried_over(before, first_ns, self.config.imu))
        return f"{jump}; it goes on from the last estimate"

    def _start_near(self, stamp_ns: int) -> NavigationState | None:
        """Return the newest start state received in flight that is of the time line which has begun at a stamp."""
        starts = [s for s in self._starts if abs(stamp_ns_of(s) - stamp_ns) <= MAX_UNCOVERED_S * NS_PER_S]
        self._starts.clear()
        return starts[-1] if starts else None

    def _process(self, item: ImuSample | int) -> None:
        """Process an IMU sample or an image stamp."""
        if isinstance(item, ImuSample):
            self._status.report_reading(item.stamp_ns)
        if self._preintegrator is not None:
            self._preintegrate(self._preintegrator, item)
        if self._live is not None:
            self._propagate(self._live, item)
            return
        self._startup_buffer.add(item)
        if self._aligns and (samples := self._startup_buffer.at_rest()):
            self._align(samples)
        self._start_if_confirmed()

    def _preintegrate(self, preintegrator: ImuPreintegrator, item: ImuSample | int) -> None:
        if isinstance(item, ImuSample):
            preintegrator.add_imu(item)
        elif preintegrator.start_ns is None or item > preintegrator.start_ns:
            preintegrator.add_frame_stamp(item)
        before = preintegrator.gaps
        increments = preintegrator.increments()
        for increment in increments:
            self._publish_increment(increment)
        if increments:
            self._status.report_stamps(preintegrator.statistics.fault)
            self._status.report_gaps(increments[-1].stamp_ns, preintegrator.gaps - before)

    def _propagate(self, live: LiveOdometry, item: ImuSample | int) -> None:
        if not isinstance(item, ImuSample) or not live.add_imu(item):
            return
        self._outputs.publish_odometry(live)
        if not self._in_batch:
            self._outputs.publish_transforms()

    def _align(self, samples: list[ImuSample]) -> None:
        """Estimate the start state from IMU samples at rest, and publish it."""
        try:
            initial = static_alignment(samples, samples[-1].stamp_ns, self.config.imu)
        except UavVslamError as refused:
            self.alarms["start"] = f"no start: {refused}"
            raise
        if biased := biased_rest(initial, self.config.imu):
            self.get_logger().warning(biased)
        self._initial_state.publish(navigation_to_msg(initial, frame_id=self.map_frame, child_frame_id=self.base_frame))
        self._start(initial)

    def _publish_increment(self, increment: ImuIncrement) -> None:
        self.counts["increments"] += 1
        self._increments.publish(increment_to_msg(increment, frame_id=self.base_frame))
        for estimate in self._reckoner.add(increment):
            self._outputs.publish_dead_reckoning(estimate, increment)

    def _on_correction(self, message: NavigationState) -> None:
        corrected = navigation_from_msg(message)
        if self._starts_again:
            return  # of the session before
        self._correction, self._resumed = message, False
        self._status.report_lag(corrected.state.stamp_ns)
        if self._live is not None:
            self._live.correct(corrected)
        elif self._preintegrator is None or self._is_reset:
            # started again in flight: the back end knows better than the take-off state, which it publishes only once
            self._pending_start.resume(corrected, message.child_frame_id)
            self._start_if_confirmed()


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(InsPropagatorNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
