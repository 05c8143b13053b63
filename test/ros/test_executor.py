# SPDX-License-Identifier: Apache-2.0
"""The executor calls what rclpy's own would, and keeps its wait set while the entities stay the same."""

import time

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.clock import Clock, ClockType  # noqa: E402
from rclpy.event_handler import SubscriptionEventCallbacks  # noqa: E402
from rclpy.executors import ExternalShutdownException  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from rosgraph_msgs.msg import Clock as ClockMsg  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from uav_vslam.ros.executor import LeanExecutor  # noqa: E402
from uav_vslam.ros.qos import SENSOR  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros

TURN_S = 0.02


@pytest.fixture
def executor(listener):
    made = LeanExecutor(context=listener.context)
    made.add_node(listener)
    yield made
    made.shutdown()


@pytest.fixture
def turn(executor):
    return lambda: executor.spin_once(timeout_sec=TURN_S)


def published(listener, topic, texts):
    """Publish on a topic once its subscription has been found."""
    publisher = listener.create_publisher(String, topic, SENSOR)
    assert wait_for(lambda: publisher.get_subscription_count() == 1)
    for text in texts:
        publisher.publish(String(data=text))


def test_messages_are_called_back_in_order_one_of_each_subscription_in_a_turn(listener, turn):
    received = []
    for topic in ("first", "second"):
        listener.create_subscription(String, topic, lambda message: received.append(message.data), SENSOR)
    published(listener, "first", ["a1", "a2", "a3"])
    published(listener, "second", ["b1", "b2", "b3"])
    time.sleep(0.2)  # all of them wait
    assert wait_for(lambda: len(received) == 6, turn)
    assert received == ["a1", "b1", "a2", "b2", "a3", "b3"]


def test_the_wait_set_is_kept_until_entities_come_or_go(listener, executor, turn):
    turn()
    kept = executor._entities
    for _ in range(3):
        turn()
    assert executor._entities is kept
    received = []
    late = listener.create_subscription(String, "late", lambda message: received.append(message.data), SENSOR)
    published(listener, "late", ["text"])
    assert wait_for(lambda: received == ["text"], turn)
    kept = executor._entities
    listener.destroy_subscription(late)
    turn()
    assert executor._entities is not kept


def test_what_a_callback_destroys_or_cancels_is_not_called_in_the_same_turn(listener, turn):
    called, clock = [], Clock(clock_type=ClockType.STEADY_TIME)

    def first():
        called.append("first")
        timers[0].cancel()
        timers[1].cancel()
        listener.destroy_timer(timers[2])
        listener.destroy_subscription(subscription)

    subscription = listener.create_subscription(String, "topic", lambda message: called.append(message.data), SENSOR)
    published(listener, "topic", ["text"])
    others = [lambda: called.append("cancelled"), lambda: called.append("destroyed")]
    timers = [listener.create_timer(0.001, call, clock=clock) for call in (first, *others)]
    time.sleep(0.2)  # all of them are ready
    for _ in range(5):
        turn()
    assert called == ["first"]


def test_services_answer_and_clients_hear(listener, turn):
    def answer(_, response):
        response.message = "here"
        return response

    listener.create_service(Trigger, "ask", answer)
    client = listener.create_client(Trigger, "ask")
    assert client.wait_for_service(timeout_sec=10.0)
    answered = client.call_async(Trigger.Request())
    assert wait_for(answered.done, turn)
    assert answered.result().message == "here"


def test_a_guard_condition_calls_back_once(listener, turn):
    called = []
    guard = listener.create_guard_condition(lambda: called.append(1))
    turn()
    guard.trigger()
    for _ in range(3):
        turn()
    assert called == [1]


def test_qos_events_are_heard(listener, turn):
    events = []
    callbacks = SubscriptionEventCallbacks(incompatible_qos=events.append)
    listener.create_subscription(String, "picky", lambda _: None, SENSOR, event_callbacks=callbacks)
    listener.create_publisher(String, "picky", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    assert wait_for(lambda: len(events) == 1, turn)


def test_the_qos_event_of_what_a_callback_destroys_is_not_called_in_the_same_turn(listener, executor, turn):
    events = []
    callbacks = SubscriptionEventCallbacks(incompatible_qos=events.append)
    picky = listener.create_subscription(String, "picky", lambda _: None, SENSOR, event_callbacks=callbacks)
    guard = listener.create_guard_condition(lambda: listener.destroy_subscription(picky))
    turn()
    listener.create_publisher(String, "picky", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    time.sleep(0.3)  # the event waits
    guard.trigger()
    executor._looked_s = 0.0  # and is looked at in the turn of the guard condition
    for _ in range(3):
        turn()
    assert events == []


def test_simulated_time_wakes_nobody_and_is_there_at_the_next_turn(listener, executor):
    stamps, called = [], []
    listener.create_subscription(ClockMsg, "/clock", lambda message: stamps.append(message.clock.sec), 1)
    publisher = listener.create_publisher(ClockMsg, "/clock", 1)
    assert wait_for(lambda: publisher.get_subscription_count() == 1)
    executor.spin_once(timeout_sec=0.0)  # the entities are new
    publisher.publish(ClockMsg())
    publisher.publish(ClockMsg(clock=rclpy.time.Time(seconds=7).to_msg()))
    begin_s = time.monotonic()
    executor.spin_once(timeout_sec=0.3)
    assert time.monotonic() - begin_s > 0.25
    assert stamps == [7]
    publisher.publish(ClockMsg(clock=rclpy.time.Time(seconds=8).to_msg()))
    clock = Clock(clock_type=ClockType.STEADY_TIME)
    timer = listener.create_timer(0.01, lambda: called.append(stamps[-1]), clock=clock)
    assert wait_for(lambda: called, lambda: executor.spin_once(timeout_sec=TURN_S))
    timer.cancel()
    assert called[0] == 8


@pytest.mark.parametrize("entity", ["timer", "service"])
def test_what_a_callback_raises_is_raised(listener, turn, entity):
    def fail(*_):
        raise ZeroDivisionError

    if entity == "timer":
        listener.create_timer(0.001, fail, clock=Clock(clock_type=ClockType.STEADY_TIME))
    else:
        listener.create_service(Trigger, "fail", fail)
        client = listener.create_client(Trigger, "fail")
        assert client.wait_for_service(timeout_sec=10.0)
        client.call_async(Trigger.Request())
    with pytest.raises(ZeroDivisionError):
        wait_for(lambda: False, turn)


def test_it_ends_with_ros():
    context = rclpy.Context()
    rclpy.init(context=context)
    executor = LeanExecutor(context=context)
    executor.spin_once(timeout_sec=0.0)
    rclpy.shutdown(context=context)
    with pytest.raises(ExternalShutdownException):
        executor.spin_once(timeout_sec=TURN_S)
    executor.shutdown()
