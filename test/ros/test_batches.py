# SPDX-License-Identifier: Apache-2.0
import time

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from std_msgs.msg import String  # noqa: E402

from uav_vslam.ros.batches import Batches, take_waiting  # noqa: E402
from uav_vslam.ros.qos import SENSOR  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros

SENT = [str(number) for number in range(50)]
PATIENCE_S = 0.5


@pytest.fixture
def executor(listener):
    made = rclpy.executors.SingleThreadedExecutor(context=listener.context)
    made.add_node(listener)
    yield made
    made.shutdown()


@pytest.fixture
def topic(listener):
    """A subscription of which a test may take batches, its group, and what has been received."""
    received, group = [], Batches(at_once=False)
    on_message = lambda message, info: received.append(message.data)  # noqa: E731
    subscription = listener.create_subscription(String, "fast", on_message, SENSOR, callback_group=group)
    publisher = listener.create_publisher(String, "fast", SENSOR)
    assert wait_for(lambda: publisher.get_subscription_count() == 1)
    for text in SENT:
        publisher.publish(String(data=text))
    return subscription, group, received


def share_of_a_core(executor):
    """Return the processor time, over wall time, of waiting for something else."""
    begin_s, used_s = time.monotonic(), time.thread_time()
    executor.spin_once(timeout_sec=PATIENCE_S)
    return (time.thread_time() - used_s) / (time.monotonic() - begin_s)


def test_messages_wait_without_waking_the_executor_and_are_taken_in_order(topic, executor):
    subscription, _, received = topic
    assert share_of_a_core(executor) < 0.3  # nearly all of it, were the wait to end again and again
    assert received == []
    assert wait_for(lambda: received == SENT, lambda: take_waiting(subscription))


def test_at_once_they_wake_the_executor_as_usual(topic, executor):
    _, group, received = topic
    group.at_once = True
    assert wait_for(lambda: received == SENT, lambda: executor.spin_once(timeout_sec=0.02))
