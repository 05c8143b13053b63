# SPDX-License-Identifier: Apache-2.0
"""Nodes start by themselves, pause and reset by services, and obey the lifecycle of managed nodes."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from lifecycle_msgs.msg import State, Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from lone_node import lone_node  # noqa: E402
from node_flight import NodeFlight  # noqa: E402
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.client import Client  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402

from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle  # noqa: E402

pytestmark = pytest.mark.ros
FRAMES = 20
CLIENTS, CLIENT_S = 6, 20.0  # how many are tried, each for so long
NODES = ("ins_propagator", "slam_backend", "fusion")
Make = Callable[..., NodeFlight]


@pytest.fixture(scope="module")
def vehicle() -> SimulatedVehicle:
    return simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, vehicles=1), 0)


@pytest.fixture
def make(vehicle: SimulatedVehicle, domain_id: int) -> Iterator[Make]:
    """Return a factory of the nodes with parameters."""
    with lone_node(partial(NodeFlight, vehicle), domain_id) as made:
        yield made


def call(flight: NodeFlight, kind: Any, service: str, request: Any) -> Any:
    client = ready_client(flight, kind, f"/uav1/{service}")
    future = client.call_async(request)
    assert flight.spin(future.done)
    flight.player.destroy_client(client)
    return future.result()


def ready_client(flight: NodeFlight, kind: Any, service: str) -> Client:
    """Return a client that has found its service; rarely one never does (ros2/rmw_fastrtps, issue 792)."""
    for _ in range(CLIENTS):
        client, give_up_s = flight.player.create_client(kind, service), time.monotonic() + CLIENT_S
        if flight.spin(client.service_is_ready, alive=lambda end_s=give_up_s: time.monotonic() < end_s):
            return client
        flight.player.destroy_client(client)
    raise AssertionError(f"{service} was found by none of {CLIENTS} clients")


def state_of(flight: NodeFlight, node: str) -> int:
    return int(call(flight, GetState, f"{node}/get_state", GetState.Request()).current_state.id)


def change(flight: NodeFlight, node: str, transition: int) -> bool:
    request = ChangeState.Request(transition=Transition(id=transition))
    return bool(call(flight, ChangeState, f"{node}/change_state", request).success)


def reset_all(flight: NodeFlight) -> None:
    for node in NODES:
        assert call(flight, Trigger, f"{node}/reset", Trigger.Request()).success


def status(flight: NodeFlight, node: str) -> tuple[bytes, str]:
    """Return level and text of diagnostics that are newer than this call."""
    flight.statuses.pop(node, None)
    assert flight.spin(lambda: node in flight.statuses)
    return flight.statuses[node].level, flight.statuses[node].message


def test_nodes_start_by_themselves_and_a_paused_one_says_so_and_goes_on_as_after_a_loss(make: Make) -> None:
    flight = make()
    flight.start()
    flight.fly(0, 8)
    assert [state_of(flight, node) for node in NODES] == [State.PRIMARY_STATE_ACTIVE] * 3
    for node in NODES:
        answer = call(flight, SetBool, f"{node}/pause", SetBool.Request(data=True))
        assert (answer.success, answer.message) == (True, "paused")
    flight.fly(8, 11)
    assert len(flight.odometry) == 8
    assert status(flight, "slam_backend") == (DiagnosticStatus.WARN, "paused: messages are ignored")
    assert flight.backend.counts["paused"] == 2 * 3  # camera_info and features
    assert not any(count for key, count in flight.backend.counts.items() if key.startswith("dropped/stamp"))
    for node in NODES:
        assert call(flight, SetBool, f"{node}/pause", SetBool.Request(data=False)).success
    flight.fly(11)
    assert len(flight.odometry) == FRAMES - 3
    assert flight.fused[-1].header.stamp == flight.odometry[-1].header.stamp


def test_recoveries_and_gaps_in_the_readings_are_alarms_while_they_are_recent(make: Make, monkeypatch) -> None:
    flight = make()
    flight.start()
    flight.fly(0, 6)
    assert (flight.backend.alarms, flight.ins.alarms) == ({}, {})
    flight.backend._stage._flight.backend._filter.belief.Y[3, 3] = -1.0
    with monkeypatch.context() as patch:
        patch.setattr(flight, "_read", lambda *_: None)
        flight.fly(6, 8)
    flight.fly(8, 12)
    assert flight.backend.alarms["recovery"].startswith("the filter was re-initialised 1x in the last 10 s, the last")
    assert flight.backend.counts["recoveries"] == 1
    assert flight.ins.alarms["imu"].endswith(" increments of the last 10 s lack IMU readings")


def test_reset_begins_a_session_that_waits_for_a_start_state(make: Make) -> None:
    flight = make("session:=1")
    flight.start()
    flight.fly(0, 10)
    reset_all(flight)
    assert flight.backend._stage.session > 1
    assert flight.backend._stage.initial is None
    flight.odometry.clear()
    flight.fly(10, 14)
    assert flight.odometry == []
    reset_all(flight)
    flight.start()
    flight.fly()
    assert len(flight.odometry) == FRAMES
    assert len(flight.fused) >= FRAMES - 1


def test_a_transition_that_the_state_does_not_have_is_refused_and_the_node_goes_on(make: Make) -> None:
    flight = make()
    flight.start()
    for node in NODES:
        assert not change(flight, node, Transition.TRANSITION_ACTIVATE)  # it is active
        assert not change(flight, node, 99)
    assert [state_of(flight, node) for node in NODES] == [State.PRIMARY_STATE_ACTIVE] * 3
    flight.fly()
    assert len(flight.odometry) == FRAMES


def test_cleanup_forgets_the_flight_and_a_node_runs_again_once_it_is_activated(make: Make) -> None:
    flight = make("session:=1")
    flight.start()
    flight.fly(0, 8)
    for node in NODES:
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
            assert change(flight, node, transition)
        assert state_of(flight, node) == State.PRIMARY_STATE_UNCONFIGURED
        assert not call(flight, SetBool, f"{node}/pause", SetBool.Request(data=False)).success
    assert flight.backend._stage.initial is None
    for node in NODES:
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            assert change(flight, node, transition)
    flight.odometry.clear()
    flight.start()
    flight.fly()
    assert len(flight.odometry) == FRAMES


def test_without_autostart_a_node_waits_until_it_is_activated_and_uses_the_start_given_before(make: Make) -> None:
    flight = make("autostart:=false")
    flight.start()
    flight.fly(0, 4)
    assert flight.odometry == []
    assert status(flight, "ins_propagator")[1] == "not configured: messages are ignored"
    for node in NODES:
        assert state_of(flight, node) == State.PRIMARY_STATE_UNCONFIGURED
        assert change(flight, node, Transition.TRANSITION_CONFIGURE)
        assert change(flight, node, Transition.TRANSITION_ACTIVATE)
    flight.fly()
    assert len(flight.odometry) == FRAMES


def test_a_reset_says_whether_the_node_runs_afterwards(make: Make) -> None:
    flight = make()
    forgotten = "flight forgotten, but the node is {} and ignores messages: {}"
    assert change(flight, "fusion", Transition.TRANSITION_DEACTIVATE)
    answer = call(flight, Trigger, "fusion/reset", Trigger.Request())
    assert (answer.success, answer.message) == (True, forgotten.format("paused", "activate it"))
    assert change(flight, "fusion", Transition.TRANSITION_CLEANUP)
    answer = call(flight, Trigger, "fusion/reset", Trigger.Request())
    assert (answer.success, answer.message) == (True, forgotten.format("not configured", "configure and activate it"))
    assert change(flight, "fusion", Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    answer = call(flight, Trigger, "fusion/reset", Trigger.Request())
    assert (answer.success, answer.message) == (False, forgotten.format("finalized", "restart its process"))


def test_a_pause_that_the_state_does_not_have_is_refused_with_what_to_do(make: Make) -> None:
    flight = make("autostart:=false")
    for state, remedy in (("not configured", "configure and activate it"), ("finalized", "restart its process")):
        for paused in (True, False):
            answer = call(flight, SetBool, "fusion/pause", SetBool.Request(data=paused))
            text = f"the node is {state} and ignores messages: {remedy}"
            assert (answer.success, answer.message) == (False, text)
        change(flight, "fusion", Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)


def test_a_node_that_is_shut_down_ignores_messages_for_good(make: Make) -> None:
    flight = make()
    assert change(flight, "fusion", Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert status(flight, "fusion") == (DiagnosticStatus.WARN, "finalized: messages are ignored")
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="none")
    request = SetParameters.Request(parameters=[Parameter(name="fusion.mode", value=value)])
    (result,) = call(flight, SetParameters, "fusion/set_parameters", request).results
    text = "the node is finalized and follows no setting: restart its process"
    assert (result.successful, result.reason) == (False, text)
