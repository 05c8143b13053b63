# SPDX-License-Identifier: Apache-2.0
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from uav_vslam.geometry.pose import Pose  # noqa: E402
from uav_vslam.ros.convert import flat, header, transform_to_msg  # noqa: E402
from uav_vslam.ros.qos import IMAGE, LATCHED, STATE  # noqa: E402
from uav_vslam.ros.stereo_frontend_node import StereoFrontendNode  # noqa: E402
from uav_vslam_msgs.msg import StereoFeatures  # noqa: E402

pytestmark = pytest.mark.ros
DOMAIN_ID = 94
PATIENCE_S = 15.0
STAMP_NS = 5_000_000_000
WIDTH, HEIGHT = 64, 48


@pytest.fixture
def graph():
    """The node and a test node beside it in one executor."""
    rclpy.init(domain_id=DOMAIN_ID)
    front, other = StereoFrontendNode(), rclpy.create_node("tester")
    executor = SingleThreadedExecutor()
    executor.add_node(front)
    executor.add_node(other)
    yield front, other, executor
    front.destroy_node()
    other.destroy_node()
    rclpy.shutdown()


def spin_until(executor, condition):
    deadline = time.monotonic() + PATIENCE_S
    while not condition() and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.05)
    return condition()


def blank_image(side):
    message = Image(
        header=header(STAMP_NS, f"{side}_optical"), height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH
    )
    message.data = flat(np.zeros(WIDTH * HEIGHT, np.uint8))
    return message


def calibration(side):
    k = np.array([50.0, 0.0, 32.0, 0.0, 50.0, 24.0, 0.0, 0.0, 1.0])
    return CameraInfo(header=header(STAMP_NS, f"{side}_optical"), height=HEIGHT, width=WIDTH, k=k, d=np.zeros(5))


def extrinsics(node):
    poses = {"left": Pose.identity(), "right": Pose(np.eye(3), np.array([0.1, 0.0, 0.0]))}
    edges = [
        transform_to_msg(pose, stamp_ns=0, parent=node.base_frame, child=f"{side}_optical")
        for side, pose in poses.items()
    ]
    return TFMessage(transforms=edges)


def test_images_that_come_before_their_calibration_are_processed_once_it_is_complete(graph):
    front, other, executor = graph
    heard = []
    other.create_subscription(StereoFeatures, "stereo_features", heard.append, STATE)
    images = {side: other.create_publisher(Image, f"{side}/image_raw", IMAGE) for side in ("left", "right")}
    infos = {side: other.create_publisher(CameraInfo, f"{side}/camera_info", STATE) for side in ("left", "right")}
    transforms = other.create_publisher(TFMessage, "/tf_static", LATCHED)
    publishers = [*images.values(), *infos.values()]
    assert spin_until(executor, lambda: all(p.get_subscription_count() for p in publishers))
    for side, publisher in images.items():
        publisher.publish(blank_image(side))
    assert spin_until(executor, lambda: front.counts["pairs"] == 1)
    assert not heard
    for side, publisher in infos.items():
        publisher.publish(calibration(side))
    transforms.publish(extrinsics(front))
    assert spin_until(executor, lambda: len(heard) == 1)
    assert (heard[0].width, heard[0].height) == (WIDTH, HEIGHT)
