# SPDX-License-Identifier: Apache-2.0
"""Base of every vehicle node: configuration, inputs, rejected messages counted by reason, and diagnostics."""

import contextlib
import copy
import time
import typing
from collections import Counter
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

from uav_vslam.config import VehicleConfig, doubtful_settings
from uav_vslam.config.nodes import NODES
from uav_vslam.errors import ConfigError, UavVslamError
from uav_vslam.monitor import DROPPED
from uav_vslam.ros.diagnostics import status_message
from uav_vslam.ros.executor import CLOCK
from uav_vslam.ros.fleet_commands import vehicle_in
from uav_vslam.ros.health import RECENT_REPORTS, START_S, RecentDrops, Start
from uav_vslam.ros.inputs import Input, mismatch, mixed, silent, stopped, unmatched
from uav_vslam.ros.lifecycle import PausableNode
from uav_vslam.ros.parameter_service import AnsweringParameterService
from uav_vslam.ros.params import VehicleParameters, declare, read
from uav_vslam.ros.qos import LATCHED, LATCHED_BY_MANY
from uav_vslam.ros.readiness import DiscoveryReport
from uav_vslam.ros.timers import create_wall_timer
from uav_vslam.slam.state_folder import state_folder
from uav_vslam.stamps import TimeLine

DIAGNOSTICS_PERIOD_S = 1.0
FOLLOW_PERIOD_S = 0.5  # how often inputs check the reliability that is offered
NO_CLOCK = f"{CLOCK} (no publisher, but use_sim_time is set: time does not advance)"
MAX_PATH = 2000  # poses in a published path


class VehicleNode(PausableNode):
    """A node in a vehicle's namespace, with its configuration and its health.

    Parameters: those that `config.nodes.NODES` lists for the node's name.

    Attributes:
        own: the node's own parameters.
        vehicle: name.
        counts: what happened how often, for the diagnostics.
        notes: further values for the diagnostics.
        alarms: current faults, by subject; they set the status to WARN.
        failures: current faults that keep the node from working, by subject; they set it to ERROR.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, start_parameter_services=False)
        self.own: Any = read(self, typing.cast(Any, NODES[name].own))
        declare(self, self.own)
        self._parameter_service = AnsweringParameterService(self) if self.own.parameter_services else None
        self._settings = VehicleParameters(self, NODES[name].used_names, self.configure)
        for setting, text in doubtful_settings(self.config).items():
            if setting in NODES[name].used_names:
                self.get_logger().warning(text)
        self.vehicle: str = self.own.vehicle or vehicle_in(self.get_namespace())
        if not self.vehicle:
            raise ConfigError(f"start it in its vehicle's namespace, as in --ros-args -r __ns:=/uav1 (node {name})")
        self._settings.keep_live(state_folder() / f"{self.vehicle}_{name}.json", resume=self.own.resume)
        self._pause_mark = state_folder() / f"{self.vehicle}_{name}.paused"
        self.counts: Counter[str] = Counter()
        self.notes: dict[str, str] = {}
        self.alarms: dict[str, str] = {}
        self.failures: dict[str, str] = {}
        self._inputs: list[Input] = []
        self._mixed: set[str] = set()  # topics that several nodes publish
        self._was_active = False
        self._refused = 0  # messages off the time line, as last reported
        self._startup, self._recent_drops = self._new_start(), RecentDrops()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        DiscoveryReport(self, lambda: unmatched(self._inputs))
        create_wall_timer(self, DIAGNOSTICS_PERIOD_S, self._publish_diagnostics)
        create_wall_timer(self, FOLLOW_PERIOD_S, self.follow_offers)
        create_wall_timer(self, START_S, self._report_missing)
        if self.own.resume and self._pause_mark.exists():
            self.get_logger().warning("paused, as the process before was")
            self.trigger_configure()
        elif self.own.autostart:
            self.begin()

    @property
    def config(self) -> VehicleConfig:
        """The vehicle's configuration; live settings as they are now."""
        return self._settings.config

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Also take what was published once in the meantime: transforms, and before the first flight its start."""
        for one in self._inputs:
            if one.once and not self._was_active:
                one.received = 0  # all were ignored
            if one.once and (one.shared or not self._was_active):
                one.renew(self)
        self._was_active = True
        with contextlib.suppress(OSError):
            self._pause_mark.unlink(missing_ok=True)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Also leave a mark for the process that takes the place of this one, should it die."""
        try:
            self._pause_mark.parent.mkdir(parents=True, exist_ok=True)
            self._pause_mark.touch()
        except OSError as error:
            self.get_logger().warning(
                f"{self._pause_mark} can't be written ({error.strerror}); a restart of this node ends the pause"
            )
        return super().on_deactivate(state)

    def configure(self, config: VehicleConfig) -> None:
        """Apply changed live settings."""

    @property
    def world_frame(self) -> str:
        """Name of the frame of the fused estimate."""
        return self.config.frames.world_of(self.vehicle, common=self.config.fusion.common_origin)

    @property
    def map_frame(self) -> str:
        """Name of the vehicle's map frame."""
        return self.config.frames.map_of(self.vehicle)

    @property
    def odom_frame(self) -> str:
        """Name of the frame in which the own pose has no jumps."""
        return self.config.frames.odom or f"{self.vehicle}/odom"

    @property
    def base_frame(self) -> str:
        """Name of the body frame."""
        return self.config.input.base_frame(self.vehicle)

    def listen(
        self,
        message_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile,
        *,
        instead_of: str = "",
        raw: bool = False,
        group: CallbackGroup | None = None,
    ) -> Input:
        """Subscribe; a message that the callback rejects is dropped and counted by reason.

        Args:
            message_type, topic, qos: as for create_subscription.
            callback: may raise ValueError or an error of ours.
            instead_of: another topic that this one can replace: the node needs only one of them.
            raw: the callback gets serialised messages.
            group: as for create_subscription.
        """
        one = Input(message_type, topic, self.guarded(topic, callback), qos, instead_of or topic, raw, group)
        one.shared, one.once = qos is LATCHED_BY_MANY, qos in (LATCHED, LATCHED_BY_MANY)
        one.subscribe(self)
        self.watch(one)
        return one

    def guarded(self, topic: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a callback that drops and counts messages that `callback` rejects."""

        def call(message: Any) -> None:
            if self.paused:
                self.counts["paused"] += 1
                return
            try:
                callback(message)
            except (ValueError, UavVslamError) as error:
                self.drop(getattr(error, "reason", "refused"), f"{topic}: {error}")

        return call

    def watch(self, one: Input) -> None:
        """Report an input's faults in the diagnostics, and adapt its reliability to the offer."""
        self._inputs.append(one)
        self._startup = self._new_start()  # in flight too: a new communication mode has new inputs

    def _new_start(self) -> Start:
        return Start(self.get_clock(), lambda: self.count_publishers(CLOCK) > 0)

    def unwatch(self, one: Input) -> None:
        """Stop watching an input that is to be closed."""
        if one in self._inputs:
            self._inputs.remove(one)

    def advertise(self, message_type: Any, topic: str, qos: QoSProfile) -> Any:
        """Create a publisher whose policies can be overridden by parameters qos_overrides.<topic>.publisher.

        It does not watch for subscriptions that can't match it: they say so themselves, and each watch costs time at
        every turn of the executor.
        """
        overrides = QoSOverridingOptions.with_default_policies()
        events = PublisherEventCallbacks(use_default_callbacks=False)
        own = copy.copy(qos)  # rclpy writes overrides into it, and other topics share the profile
        return self.create_publisher(message_type, topic, own, qos_overriding_options=overrides, event_callbacks=events)

    def drop(self, reason: str, detail: str) -> None:
        """Count a dropped message and log it, throttled."""
        self.counts[f"{DROPPED}{reason}"] += 1
        self.get_logger().warning(f"dropped a message: {detail}", throttle_duration_sec=5.0)

    def report_clock(self, line: TimeLine[Any], happened: str) -> None:
        """Report a jump of the clock that was followed, messages off the time line, and clocks that disagree."""
        if happened:
            self.counts["time_jumps"] += 1
            self.notes["time_jump"] = happened
            self.get_logger().warning(happened)
        if (refused := line.refused.total()) != self._refused:
            self._refused = refused
            self.counts |= {f"{DROPPED}{reason}": count for reason, count in line.refused.items()}
            self.get_logger().warning(f"dropped a message: {line.refusal}", throttle_duration_sec=5.0)
        self.report_failure("clock", "; ".join(line.faults.values()))

    def report_alarm(self, subject: str, text: str, *, logged: bool = False) -> None:
        """Set an alarm, and log a new one if wished; an empty text means that there is none."""
        if not text:
            self.alarms.pop(subject, None)
            return
        if logged and subject not in self.alarms:
            self.get_logger().warning(text)
        self.alarms[subject] = text

    def report_failure(self, subject: str, text: str) -> None:
        """Set a failure, and log it if it is new; an empty text means that there is none."""
        if not text:
            self.failures.pop(subject, None)
            return
        if subject not in self.failures:
            self.get_logger().error(text)
        self.failures[subject] = text

    def follow_offers(self) -> None:
        """Adapt the inputs to what is published now; called periodically."""
        for one in self._inputs:
            if one.follow(self):
                offered = f"{one.qos.reliability.name}, {one.qos.durability.name}"
                self.get_logger().info(f"{one.subscription.topic_name} switched to the QoS offered: {offered}")
        self._refuse_mixed()

    def _refuse_mixed(self) -> None:
        """Report inputs that several nodes publish; the inputs themselves stop passing messages on."""
        faults = mixed(self._inputs, self)
        for topic in sorted(self._mixed - faults.keys()):
            self.get_logger().info(f"one node publishes {topic} again; it is used")
        for topic in sorted(self._mixed | faults.keys()):
            self.report_failure(topic, faults.get(topic, ""))
        self._mixed = set(faults)
        refused = sum(one.refused for one in self._inputs)
        if refused:
            self.counts[f"{DROPPED}several_publishers"] = refused

    def _awaited(self) -> list[str]:
        """Return the topics of which nothing has come, each with what is known of its publishers."""
        awaited, lacking = [], unmatched(self._inputs)
        for topic in silent(self._inputs):
            resolved = self.resolve_topic_name(topic)
            published = "no publisher" if resolved in lacking else "published, but no message yet"
            awaited.append(f"{resolved} ({mismatch(self._inputs, topic, self) or published})")
        return awaited

    def _report_missing(self) -> None:
        waiting = [NO_CLOCK] if self._startup.lacks_clock() else []
        waiting += [] if self._startup.lasts() else self._awaited()
        if waiting:  # one line for all: the throttle counts lines of code, not texts
            self.get_logger().warning(f"waiting for {', '.join(waiting)}", throttle_duration_sec=20.0)
        if stops := self._stops():
            self.get_logger().warning(stops[0], throttle_duration_sec=20.0)

    def _stops(self) -> list[str]:
        """Return which streams have stopped, and for how long, in a line; none if none has."""
        pauses = [f"{topic} for {pause_s:.0f} s" for topic, pause_s in stopped(self._inputs, time.monotonic()).items()]
        return [f"no more messages from {', '.join(pauses)}"] if pauses else []

    def _health(self) -> tuple[bytes, str]:
        """Return the level and the text of the node's status: failures first, then what most explains the rest."""
        clock = [NO_CLOCK] if self._startup.lacks_clock() else []
        why = {topic: mismatch(self._inputs, topic, self) for topic in silent(self._inputs)}
        awaited = [f"{topic} ({text})" if text else topic for topic, text in why.items()]
        missing, drops = ", ".join([*clock, *awaited]), self._recent_drops.next_report(self.counts)
        stops = self._stops()
        if self.paused:
            return DiagnosticStatus.WARN, f"{self.paused}: messages are ignored"
        if self.failures:
            named = [*self.failures.values(), *stops]  # a silent IMU looks like another clock
            return DiagnosticStatus.ERROR, "; ".join(named)
        if missing and self._startup.lasts():
            return DiagnosticStatus.OK, f"starting, waiting for {missing}"
        if missing:  # an alarm may say why, or be about another input; one that never comes hides none that has stopped
            return DiagnosticStatus.WARN, "; ".join([*self.alarms.values(), f"waiting for {missing}", *stops])
        if stops:
            return DiagnosticStatus.WARN, stops[0]
        if self.alarms:
            return DiagnosticStatus.WARN, "; ".join(self.alarms.values())
        if drops:
            return DiagnosticStatus.WARN, f"dropped in the last {RECENT_REPORTS * DIAGNOSTICS_PERIOD_S:g} s: {drops}"
        return DiagnosticStatus.OK, "running"

    def _publish_diagnostics(self) -> None:
        level, text = self._health()
        values = {key: str(count) for key, count in sorted(self.counts.items())} | self.notes
        name, stamp = f"{self.vehicle}: {self.get_name()}", self.get_clock().now().to_msg()
        self._diagnostics.publish(
            status_message(name, values, level=level, text=text, vehicle=self.vehicle, stamp=stamp)
        )
