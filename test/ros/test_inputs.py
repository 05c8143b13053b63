# SPDX-License-Identifier: Apache-2.0
import time

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from uav_vslam.ros.inputs import Input, silent, unmatched  # noqa: E402
from uav_vslam.ros.qos import STATE  # noqa: E402

pytestmark = pytest.mark.ros
PATIENCE_S = 10.0
DOMAIN_ID = 93


@pytest.fixture
def node():
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN_ID)
    made = rclpy.create_node("listener", context=context)
    yield made
    made.destroy_node()
    rclpy.shutdown(context=context)


def spin_until(node, condition, step=lambda: None):
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    deadline = time.monotonic() + PATIENCE_S
    met = condition()
    while not met and time.monotonic() < deadline:
        step()
        executor.spin_once(timeout_sec=0.05)
        met = condition()
    executor.remove_node(node)
    return met


def make_input(node, topic, heard):
    made = Input(String, topic, heard.append, STATE, topic)
    made.subscribe(node)
    return made


def test_an_input_follows_a_driver_that_offers_best_effort_only(node):
    heard = []
    one = make_input(node, "driver", heard)
    driver = node.create_publisher(String, "driver", QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT))
    assert spin_until(node, lambda: one.follow(node))
    assert spin_until(node, lambda: bool(heard), lambda: driver.publish(String(data="frame")))
    assert one.qos.reliability == ReliabilityPolicy.BEST_EFFORT
    assert not one.follow(node)  # once is enough


def test_an_input_stays_reliable_where_that_is_offered(node):
    heard = []
    one = make_input(node, "good", heard)
    publisher = node.create_publisher(String, "good", STATE)
    assert spin_until(node, lambda: one.subscription.get_publisher_count() > 0)
    assert not one.follow(node)
    assert spin_until(node, lambda: bool(heard), lambda: publisher.publish(String(data="x")))


def test_what_is_missing_is_named_unless_a_stand_in_speaks(node):
    raw = make_input(node, "image", [])
    compressed = Input(String, "image/compressed", lambda _: None, STATE, "image")
    compressed.subscribe(node)
    assert silent([raw, compressed]) == ["image"]
    assert unmatched([raw, compressed]) == ["/image"]
    publisher = node.create_publisher(String, "image/compressed", STATE)
    assert spin_until(node, lambda: compressed.heard, lambda: publisher.publish(String(data="x")))
    assert silent([raw, compressed]) == []
    assert unmatched([raw, compressed]) == []
