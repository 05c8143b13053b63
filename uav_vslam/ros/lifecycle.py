# SPDX-License-Identifier: Apache-2.0
"""Lifecycle of a vehicle's node: it starts by itself, can be paused and starts again when asked to.

~/reset           std_srvs/Trigger: start again, as a new process would
~/pause           std_srvs/SetBool: true deactivates the node, false activates it
~/change_state and the others of a managed node, for `ros2 lifecycle`: deactivate pauses, cleanup resets

A node that is not active receives its messages and ignores them, counted as `paused`. One that is shut down also
refuses settings, which it could not follow.
"""

from typing import Any

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from uav_vslam.errors import UavVslamError

UNCONFIGURED, INACTIVE, FINALIZED = "not configured", "paused", "finalized"
REMEDIES = {
    UNCONFIGURED: "configure and activate it",
    INACTIVE: "activate it",
    FINALIZED: "restart its process",
}


class PausableNode(LifecycleNode):
    """A managed node.

    Attributes:
        paused: why messages are ignored; empty if the node is active.
    """

    def __init__(self, name: str, **options: Any) -> None:
        """Wait for `begin`, or to be configured; the options are those of a node."""
        super().__init__(name, **options)
        self.paused = UNCONFIGURED
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.add_on_set_parameters_callback(self._check_state)
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    def reset(self) -> None:
        """Start again, as a new process would."""

    def begin(self) -> None:
        """Configure and activate."""
        self.trigger_configure()
        self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait to be activated."""
        self.paused = INACTIVE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Use messages."""
        self.paused = ""
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ignore messages; nothing else is lost."""
        self.paused = INACTIVE
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the flight; where that can't be, the node stays as it is."""
        try:
            self.reset()
        except (UavVslamError, OSError) as error:  # rclpy would not log it, and take the node for broken
            self.get_logger().error(f"not cleaned up: {error}")
            return TransitionCallbackReturn.FAILURE
        self.paused = UNCONFIGURED
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ignore messages for good; the process ends by a signal."""
        self.paused = FINALIZED
        return TransitionCallbackReturn.SUCCESS

    def _check_state(self, _: list[Parameter]) -> SetParametersResult:
        """Refuse settings for good once the node is shut down."""
        if self.paused != FINALIZED:
            return SetParametersResult(successful=True)
        return SetParametersResult(
            successful=False, reason=f"the node is {self.paused} and follows no setting: {REMEDIES[self.paused]}"
        )

    def _pause_text(self) -> str:
        return f"the node is {self.paused} and ignores messages: {REMEDIES[self.paused]}"

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self.reset()
            response.success, response.message = self.paused != FINALIZED, "started again"
            if self.paused:
                response.message = f"flight forgotten, but {self._pause_text()}"
            self.get_logger().warning(f"reset: {response.message}")
        except (UavVslamError, OSError) as error:
            response.success, response.message = False, str(error)
        return response

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        """Refuse a transition that the present state does not have: rclpy raises, which would end the node."""
        asked = request.transition
        possible = {label: number for number, label, *_ in self._state_machine.available_transitions}
        if (asked.label in possible) if asked.label else (asked.id in possible.values()):
            return self._change_state(request, response)
        state, known = self._state_machine.current_state[1], ", ".join(possible) or "none"
        self.get_logger().warning(f"no transition {asked.label or asked.id}: the node is {state}, which has {known}")
        response.success = False
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        number, _ = self._state_machine.current_state
        wanted = State.PRIMARY_STATE_INACTIVE if request.data else State.PRIMARY_STATE_ACTIVE
        if number not in (State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE):
            response.success, response.message = False, self._pause_text()
            return response
        if number != wanted:
            (self.trigger_deactivate if request.data else self.trigger_activate)()
        response.success, response.message = True, "paused" if request.data else "active"
        return response
