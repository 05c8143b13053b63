# SPDX-License-Identifier: Apache-2.0
"""An executor of one thread that takes little of the processor itself.

rclpy's own rebuilds its wait set from all entities of the node, once before each callback and once after it, and
wraps the callback into a task: several times what a short callback takes. This one keeps its wait set until entities
come or go, calls all that is ready in one turn, and looks at QoS events, two a subscription, twice a second.
"""

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.waitable import NumberOfEntities

from uav_vslam.ros.batches import take_waiting
from uav_vslam.types import NS_PER_S

EVENTS_PERIOD_S = 0.5
CLOCK = "/clock"


class LeanExecutor(SingleThreadedExecutor):
    """Calls the functions of timers and subscriptions itself; services and all else are rclpy's tasks.

    A turn takes one message of each subscription that has one, so that none starves the others. Simulated time wakes
    nobody: each turn begins with the newest. Entities must come and go in the executor's own thread.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._entities: _Entities | None = None  # None: they have changed
        self._looked_s = 0.0  # when it looked at events
        self._takes = {  # what begins the task of an entity, by its kind
            "service": self._take_service,
            "client": self._take_client,
            "guard_condition": self._take_guard_condition,
            "waitable": self._take_waitable,
        }

    def add_node(self, node: Node) -> bool:
        """Serve a node."""
        self._entities = None
        return bool(super().add_node(node))

    def remove_node(self, node: Node) -> None:
        """Serve a node no more."""
        self._entities = None
        super().remove_node(node)

    def wake(self) -> None:
        """Wake up: entities have come or gone."""
        self._entities = None
        super().wake()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait until something is ready, and call all that is.

        Args:
            timeout_sec: of the wait [s]; None for none.

        Raises:
            ExternalShutdownException: ROS has been shut down.
        """
        if self._is_shutdown:
            return
        entities = self._found_entities()
        entities.wait(-1 if timeout_sec is None else round(timeout_sec * NS_PER_S), events=self._looks_at_events())
        if self._entities is not entities:  # another thread has changed them, or ended ROS
            return
        for clock in entities.clocks:
            take_waiting(clock, 1)
        for timer in entities.ready("timer"):
            _call(timer)
        for subscription in entities.ready("subscription"):
            take_waiting(subscription, 1)
        for kind, take in self._takes.items():
            for entity in entities.ready(kind):
                self._make_handler(entity, None, take)
        self._go_on_with_tasks()

    def _take_waitable(self, waitable: Any) -> Any:
        """Take what a waitable has, unless an earlier callback of the same turn has destroyed it."""
        try:
            return super()._take_waitable(waitable)
        except InvalidHandle:
            return None

    def _found_entities(self) -> "_Entities":
        if self._entities is None:
            if not self._context.ok():
                raise ExternalShutdownException
            self._entities = _Entities(self.context, self.get_nodes(), [self._guard, self._sigint_gc])
        return self._entities

    def _looks_at_events(self) -> bool:
        now_s = time.monotonic()
        looks = now_s - self._looked_s >= EVENTS_PERIOD_S
        if looks:
            self._looked_s = now_s
        return looks

    def _go_on_with_tasks(self) -> None:
        if not self._tasks:
            return
        for task in [task for task, _, _ in self._tasks]:
            task()
            if task.done():
                task.result()  # raises what it has raised
        with self._tasks_lock:
            self._tasks: list[Any] = [entry for entry in self._tasks if not entry[0].done()]


class _Entities:
    """The entities of an executor's nodes, and the wait set for them.

    Attributes:
        clocks: subscriptions of simulated time.
    """

    def __init__(self, context: Any, nodes: Sequence[Node], own_guards: Sequence[Any]) -> None:
        """Collect them.

        Args:
            context: of the executor.
            nodes: of the executor.
            own_guards: guard conditions that end its wait.
        """
        subscriptions = [one for node in nodes for one in node.subscriptions]
        self.clocks = [one for one in subscriptions if one.topic_name == CLOCK]
        self._by_kind: dict[str, list[Any]] = {
            "subscription": [one for one in subscriptions if one not in self.clocks],
            "timer": [one for node in nodes for one in node.timers],
            "service": [one for node in nodes for one in node.services],
            "client": [one for node in nodes for one in node.clients],
            "guard_condition": [one for node in nodes for one in node.guards],
        }
        self._own_guards = [guard.handle for guard in own_guards]
        self._waitables = [one for node in nodes for one in node.waitables]
        self._waited: list[Any] = []  # the waitables in the wait set
        self._by_pointer = {one.handle.pointer: one for ones in self._by_kind.values() for one in ones}
        self._wait_set = self._room(context)
        self._groups: dict[CallbackGroup, list[tuple[Any, Callable[[Any], None]]]] = defaultdict(list)
        for kind, ones in self._by_kind.items():
            add = getattr(self._wait_set, f"add_{kind}")
            for one in ones:
                self._groups[one.callback_group].append((one, add))

    def _room(self, context: Any) -> Any:
        """Return a wait set with room for all."""
        room = sum((one.get_num_entities() for one in self._waitables), NumberOfEntities())
        number = {kind: len(ones) for kind, ones in self._by_kind.items()}
        return rclpy_implementation.WaitSet(
            number["subscription"] + room.num_subscriptions,
            number["guard_condition"] + room.num_guard_conditions + len(self._own_guards),
            number["timer"] + room.num_timers,
            number["client"] + room.num_clients,
            number["service"] + room.num_services,
            room.num_events,
            context.handle,
        )

    def wait(self, timeout_ns: int, *, events: bool) -> None:
        """Wait until one is ready; the callback groups say which ones may be.

        Args:
            timeout_ns: [ns]; negative for none.
            events: whether QoS events are looked at.
        """
        self._wait_set.clear_entities()
        for group, members in self._groups.items():
            if group.can_execute(members[0][0]):  # one for all: it depends on what else of the group runs
                for one, add in members:
                    add(one.handle)
        for guard in self._own_guards:
            self._wait_set.add_guard_condition(guard)
        self._waited = [one for one in self._waitables if events and one.callback_group.can_execute(one)]
        for waitable in self._waited:
            waitable.add_to_wait_set(self._wait_set)
        self._wait_set.wait(timeout_ns)

    def ready(self, kind: str) -> list[Any]:
        """Return the entities of a kind that are ready, those of a group in the order of their creation."""
        if kind == "waitable":
            return [one for one in self._waited if one.is_ready(self._wait_set)]
        found = (self._by_pointer.get(pointer) for pointer in self._wait_set.get_ready_entities(kind))
        return [one for one in found if one is not None]


def _call(timer: Any) -> None:
    """Call a timer back, unless a callback of the same turn has cancelled, reset or destroyed it."""
    try:
        with timer.handle:
            if not timer.handle.is_timer_ready():
                return
            timer.handle.call_timer()
    except InvalidHandle:
        return
    timer.callback()
