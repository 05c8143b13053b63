# SPDX-License-Identifier: Apache-2.0
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from uav_vslam.ros.inputs import STREAM, Input, image_topics, mismatch, silent, stopped, unmatched  # noqa: E402
from uav_vslam.ros.qos import LATCHED, LATCHED_BY_MANY, RESUMABLE, STATE  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros


def spin_until(listener, condition, step=lambda: None):
    executor = rclpy.executors.SingleThreadedExecutor(context=listener.context)
    executor.add_node(listener)

    def turn():
        step()
        executor.spin_once(timeout_sec=0.02)

    met = wait_for(condition, turn)
    executor.remove_node(listener)
    return met


def make_input(listener, topic, received):
    made = Input(String, topic, received.append, STATE, topic)
    made.subscribe(listener)
    return made


def test_an_input_follows_a_driver_that_offers_best_effort_only(listener):
    received = []
    one = make_input(listener, "driver", received)
    driver = listener.create_publisher(String, "driver", QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT))
    assert spin_until(listener, lambda: one.follow(listener))
    assert spin_until(listener, lambda: bool(received), lambda: driver.publish(String(data="frame")))
    assert one.qos.reliability == ReliabilityPolicy.BEST_EFFORT
    assert not one.follow(listener)  # once is enough


def test_an_input_follows_the_driver_that_takes_the_place_of_another_and_offers_less(listener):
    received = []
    one = make_input(listener, "replaced", received)
    first = listener.create_publisher(String, "replaced", STATE)
    assert spin_until(listener, lambda: bool(received), lambda: first.publish(String(data="first")))
    assert not one.follow(listener)
    listener.destroy_publisher(first)
    second = listener.create_publisher(
        String, "replaced", QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    assert spin_until(listener, lambda: one.follow(listener))
    assert spin_until(listener, lambda: received[-1].data == "second", lambda: second.publish(String(data="second")))
    assert not one.follow(listener)


@pytest.mark.parametrize("qos", [LATCHED, RESUMABLE], ids=["latched", "resumable"])
def test_an_input_that_wants_what_was_published_before_it_does_without_if_nobody_offers_it(listener, qos):
    received = []
    one = Input(String, "plain", received.append, qos, "plain")
    one.subscribe(listener)
    plain = listener.create_publisher(String, "plain", 10)
    assert spin_until(listener, lambda: one.follow(listener))
    assert one.qos.reliability == ReliabilityPolicy.RELIABLE
    assert spin_until(listener, lambda: bool(received), lambda: plain.publish(String(data="start")))


def test_an_input_takes_what_was_latched_before_it_came_though_it_did_not_ask(listener):
    """As a driver may publish its camera_info: once, for late joiners."""
    received = []
    latched = listener.create_publisher(String, "latched_info", LATCHED)
    latched.publish(String(data="earlier"))
    one = make_input(listener, "latched_info", received)
    assert spin_until(listener, lambda: one.follow(listener))
    assert spin_until(listener, lambda: bool(received))
    assert not one.follow(listener)
    assert one.once  # to be asked for again by a node that dropped it before it was active
    listener.destroy_publisher(latched)


@pytest.mark.parametrize("qos", [LATCHED, LATCHED_BY_MANY])
def test_an_input_keeps_what_a_latched_publisher_offers(listener, qos):
    received = []
    latched = listener.create_publisher(String, "latched", LATCHED)
    latched.publish(String(data="earlier"))
    one = Input(String, "latched", received.append, qos, "latched")
    one.subscribe(listener)
    assert spin_until(listener, lambda: bool(received))
    assert not one.follow(listener)


def test_of_many_latched_publishers_a_plain_one_does_not_stop_the_others(listener):
    one = Input(String, "many", [].append, LATCHED_BY_MANY, "many", shared=True)
    one.subscribe(listener)
    plain = listener.create_publisher(String, "many", 10)
    assert spin_until(listener, lambda: listener.count_publishers("many") == 1)
    assert not one.follow(listener)
    listener.destroy_publisher(plain)


def test_an_input_stays_reliable_where_that_is_offered(listener):
    received = []
    one = make_input(listener, "good", received)
    publisher = listener.create_publisher(String, "good", STATE)
    assert spin_until(listener, lambda: one.subscription.get_publisher_count() > 0)
    assert not one.follow(listener)
    assert spin_until(listener, lambda: bool(received), lambda: publisher.publish(String(data="x")))


def test_a_stream_that_came_over_dds_and_ended_has_stopped(listener):
    one = make_input(listener, "stream", [])
    publisher = listener.create_publisher(String, "stream", STATE)
    assert spin_until(listener, lambda: one.received >= STREAM, lambda: publisher.publish(String(data="x")))
    assert stopped([one], time.monotonic()) == {}
    assert list(stopped([one], time.monotonic() + 60.0)) == ["stream"]


def stream(topic, *, times_s, stands_for=None, may_pause=False):
    one = Input(String, topic, lambda _: None, STATE, stands_for or topic, may_pause=may_pause)
    one.received, one.first_s, one.last_s = len(times_s), times_s[0], times_s[-1]
    return one


def test_a_stream_that_stops_is_reported_and_one_that_never_started_is_not():
    imu = stream("imu", times_s=np.arange(0.0, 10.0, 0.005))
    info = stream("camera_info", times_s=[0.0])
    peer = stream("peer", times_s=np.arange(0.0, 10.0, 1.0), may_pause=True)
    assert stopped([imu, info, peer], now_s=14.0) == {}
    assert stopped([imu, info, peer], now_s=16.0) == {"imu": pytest.approx(6.005)}


def test_a_slow_stream_may_take_longer():
    slow = stream("image", times_s=np.arange(0.0, 40.0, 4.0))
    assert slow.received == STREAM
    assert stopped([slow], now_s=75.0) == {}
    assert stopped([slow], now_s=77.0) == {"image": 41.0}


def test_a_stream_continues_in_its_substitute():
    raw = stream("image", times_s=np.arange(0.0, 10.0, 0.1))
    compressed = stream("image/compressed", times_s=np.arange(10.0, 20.0, 0.1), stands_for="image")
    assert stopped([raw, compressed], now_s=24.0) == {}
    assert list(stopped([raw, compressed], now_s=26.0)) == ["image"]


def test_a_missing_topic_is_reported_unless_a_substitute_is_received(listener):
    raw = make_input(listener, "image", [])
    compressed = Input(String, "image/compressed", lambda _: None, STATE, "image")
    compressed.subscribe(listener)
    assert silent([raw, compressed]) == ["image"]
    assert unmatched([raw, compressed]) == ["/image"]
    publisher = listener.create_publisher(String, "image/compressed", STATE)
    assert spin_until(listener, lambda: compressed.received, lambda: publisher.publish(String(data="x")))
    assert silent([raw, compressed]) == []
    assert unmatched([raw, compressed]) == []


@pytest.mark.parametrize(
    ("remappings", "compressed"),
    [
        ([], "/uav1/left/compressed"),
        (["left:=/cam/left"], "/cam/left/compressed"),
        (["left:=/cam/left", "left/compressed:=/jpeg"], "/jpeg"),
    ],
    ids=["as configured", "with the raw one", "by itself"],
)
def test_compressed_images_are_remapped_with_the_raw_ones(listener, remappings, compressed):
    rules = [argument for rule in remappings for argument in ("-r", rule)]
    node = rclpy.create_node("front", namespace="uav1", context=listener.context, cli_args=["--ros-args", *rules])
    received = []
    name = image_topics(node, "left")[CompressedImage]
    Input(CompressedImage, name, received.append, STATE, "left").subscribe(node)
    camera = listener.create_publisher(CompressedImage, compressed, STATE)
    assert spin_until(node, lambda: bool(received), lambda: camera.publish(CompressedImage()))
    node.destroy_node()


def test_compressed_images_under_the_name_of_raw_ones_are_of_the_mismatch(listener, domain_id):
    raw = Input(Image, "image", lambda _: None, STATE, "image")
    compressed = Input(CompressedImage, "image/compressed", lambda _: None, STATE, "image")
    for one in (raw, compressed):
        one.subscribe(listener)
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)
    driver = rclpy.create_node("driver", context=context)
    said = (
        "published as sensor_msgs/msg/CompressedImage; it takes sensor_msgs/msg/Image or "
        "sensor_msgs/msg/CompressedImage as /image/compressed"
    )
    try:
        driver.create_publisher(CompressedImage, "image", STATE)
        assert spin_until(listener, lambda: mismatch([raw, compressed], "image", listener) == said)
        driver.create_publisher(CompressedImage, "image/compressed", STATE)
        assert spin_until(listener, lambda: not mismatch([raw, compressed], "image", listener))
    finally:
        driver.destroy_node()
        rclpy.shutdown(context=context)


def test_transforms_that_are_published_without_being_kept_for_late_joiners_are_named(listener):
    one = Input(String, "static", lambda _: None, LATCHED_BY_MANY, "static", shared=True)
    one.subscribe(listener)
    assert mismatch([one], "static", listener) == ""
    plain = listener.create_publisher(String, "static", 10)
    said = "published as RELIABLE, VOLATILE; it needs RELIABLE, TRANSIENT_LOCAL"
    assert spin_until(listener, lambda: mismatch([one], "static", listener) == said)
    listener.create_publisher(String, "static", LATCHED)
    assert spin_until(listener, lambda: mismatch([one], "static", listener) == "")
    listener.destroy_publisher(plain)


def test_qos_that_is_overridden_is_that_of_one_topic_and_outlasts_its_driver(listener):
    depth = ["--ros-args", "-p", "qos_overrides./deep.subscription.depth:=77"]
    node = rclpy.create_node("overridden", context=listener.context, cli_args=depth)
    deep, other = (make_input(node, topic, []) for topic in ("/deep", "/other"))
    assert (deep.qos.depth, other.qos.depth, STATE.depth) == (77, 10, 10)
    listener.create_publisher(String, "/deep", QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT))
    assert spin_until(node, lambda: deep.follow(node))
    assert deep.qos.depth == 77
    node.destroy_node()
