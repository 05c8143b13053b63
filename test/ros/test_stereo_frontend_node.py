# SPDX-License-Identifier: Apache-2.0
import struct
import subprocess
import sys
import zlib
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from lone_node import deliver, lone_node  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import CameraInfo, CompressedImage, Image  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from uav_vslam.geometry.pose import Pose  # noqa: E402
from uav_vslam.ros.convert import flat, header, transform_to_msg  # noqa: E402
from uav_vslam.ros.qos import IMAGE, LATCHED, STATE  # noqa: E402
from uav_vslam.ros.stereo_frontend_node import MAX_ALONE, MAX_WAITING, RAW_AWAITED, StereoFrontendNode  # noqa: E402
from uav_vslam_msgs.msg import StereoFeatures  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros
QUIET_TURNS = 25  # enough for what should not come
STAMP_NS = 5_000_000_000
WIDTH, HEIGHT = 64, 48


@pytest.fixture
def graph(domain_id):
    """The node and a test node beside it in one executor."""
    rclpy.init(args=["--ros-args", "-r", "__ns:=/uav1"], domain_id=domain_id)
    front, other = StereoFrontendNode(), rclpy.create_node("tester")
    executor = SingleThreadedExecutor()
    executor.add_node(front)
    executor.add_node(other)
    yield front, other, executor
    front.destroy_node()
    other.destroy_node()
    rclpy.shutdown()


def blank_image(side):
    message = Image(
        header=header(STAMP_NS, f"{side}_optical"), height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH
    )
    message.data = flat(np.zeros(WIDTH * HEIGHT, np.uint8))
    return message


def calibration(side, lens=(0.0,) * 5):
    k = np.array([50.0, 0.0, 32.0, 0.0, 50.0, 24.0, 0.0, 0.0, 1.0])
    return CameraInfo(header=header(STAMP_NS, f"{side}_optical"), height=HEIGHT, width=WIDTH, k=k, d=lens)


def extrinsics(node):
    poses = {"left": Pose.identity(), "right": Pose(np.eye(3), np.array([0.1, 0.0, 0.0]))}
    edges = [
        transform_to_msg(pose, stamp_ns=0, parent=node.base_frame, child=f"{side}_optical")
        for side, pose in poses.items()
    ]
    return TFMessage(transforms=edges)


class Rig:
    """Cameras, calibrated or not yet, and the features from their images."""

    def __init__(self, graph, kinds=(Image,)) -> None:
        self.front, other, self.executor = graph
        self.received = []
        other.create_subscription(StereoFeatures, "stereo_features", self.received.append, STATE)
        self._other = other
        self.images = self._drivers(kinds)
        self._infos = {s: other.create_publisher(CameraInfo, f"{s}/camera_info", STATE) for s in ("left", "right")}
        self._transforms = other.create_publisher(TFMessage, "/tf_static", LATCHED)
        publishers = [*self.images.values(), *self._infos.values()]
        assert self.until(lambda: all(p.get_subscription_count() for p in publishers))

    def _drivers(self, kinds):
        names = {Image: "image_raw", CompressedImage: "image_raw/compressed"}
        return {
            (side, kind): self._other.create_publisher(kind, f"{side}/{names[kind]}", IMAGE)
            for side in ("left", "right")
            for kind in kinds
        }

    def replace_drivers(self, kind):
        for publisher in self.images.values():
            self._other.destroy_publisher(publisher)
        self.images = self._drivers([kind])
        assert self.until(lambda: all(p.get_subscription_count() for p in self.images.values()))

    def turn(self):
        self.executor.spin_once(timeout_sec=0.02)

    def until(self, condition):
        return wait_for(condition, self.turn)

    def rest(self):
        for _ in range(QUIET_TURNS):
            self.turn()

    def calibrate(self) -> None:
        for side, publisher in self._infos.items():
            publisher.publish(calibration(side))
        self._transforms.publish(extrinsics(self.front))


def encoded(image, data):
    return CompressedImage(header=image.header, format="png", data=data)


def test_images_that_arrive_before_their_calibration_are_processed_once_it_is_complete(graph):
    rig = Rig(graph)
    for (side, _), publisher in rig.images.items():
        publisher.publish(blank_image(side))
    assert rig.until(lambda: rig.front.counts["pairs"] == 1)
    assert not rig.received
    rig.calibrate()
    assert rig.until(lambda: len(rig.received) == 1)
    assert (rig.received[0].width, rig.received[0].height) == (WIDTH, HEIGHT)


def test_pairs_that_wait_in_vain_for_their_calibration_say_what_is_missing(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()

        def text_after_pairs(begin):
            for k in range(begin, begin + MAX_WAITING + 1):
                for side in ("left", "right"):
                    image = blank_image(side)
                    image.header = header(STAMP_NS + k * 100_000_000, f"{side}_optical")
                    deliver(node, f"{side}/image_raw", image)
            return node.alarms.get("calibration", "")

        deliver(node, "left/camera_info", calibration("left"))
        assert "no valid camera_info of the right camera" in text_after_pairs(0)
        deliver(node, "right/camera_info", calibration("right"))
        missing = "/tf_static has no uav1/base_link -> left_optical, uav1/base_link -> right_optical; publish it"
        assert missing in text_after_pairs(20)
        deliver(node, "/tf_static", extrinsics(node))
        assert text_after_pairs(40) == ""


HUGE = b"\x89PNG\r\n\x1a\n" + b"".join(  # a header that claims 65535 x 65535 px
    struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    for kind, data in ((b"IHDR", struct.pack(">IIBBBBB", 65535, 65535, 8, 0, 0, 0, 0)), (b"IEND", b""))
)


@pytest.mark.parametrize("data", [b"not a picture", HUGE])
def test_an_image_that_can_not_be_decoded_is_a_frame_without_features(graph, data):
    rig = Rig(graph, [CompressedImage])
    rig.calibrate()
    for (side, _), publisher in rig.images.items():
        publisher.publish(encoded(blank_image(side), data))
    assert rig.until(lambda: len(rig.received) == 1)
    assert len(rig.received[0].pixels) == 0
    assert rig.received[0].header.stamp.sec == STAMP_NS // 10**9
    assert rig.front.counts["dropped/image"] == 1


def test_a_camera_that_sends_each_image_raw_and_compressed_is_used_once(graph):
    rig = Rig(graph, [Image, CompressedImage])
    rig.calibrate()
    for (side, kind), publisher in rig.images.items():
        image = blank_image(side)
        png = cv2.imencode(".png", np.zeros((HEIGHT, WIDTH), np.uint8))[1].tobytes()
        publisher.publish(image if kind is Image else encoded(image, png))
    assert rig.until(lambda: len(rig.received) == 1)
    rig.rest()
    assert rig.front.counts["pairs"] == 1
    assert rig.front.counts["dropped/unpaired"] == 0
    assert all(list(choices) == [Image] for choices in rig.front._choices.values())


def test_compressed_images_are_used_if_raw_ones_are_advertised_but_never_arrive(graph):
    rig = Rig(graph, [Image, CompressedImage])
    rig.calibrate()
    png = cv2.imencode(".png", np.zeros((HEIGHT, WIDTH), np.uint8))[1].tobytes()

    def publish():
        for (side, kind), publisher in rig.images.items():
            if kind is CompressedImage:
                publisher.publish(encoded(blank_image(side), png))

    for _ in range(RAW_AWAITED):
        publish()
    rig.rest()
    assert rig.front.counts["pairs"] == 0
    publish()
    assert rig.until(lambda: len(rig.received) == 1)


def test_drivers_that_change_between_raw_and_compressed_images_in_flight_are_followed(graph):
    rig = Rig(graph, [Image])
    rig.calibrate()
    png = cv2.imencode(".png", np.zeros((HEIGHT, WIDTH), np.uint8))[1].tobytes()
    for flight, kind in enumerate((Image, CompressedImage, Image)):
        if flight:
            rig.replace_drivers(kind)
        for (side, _), publisher in rig.images.items():
            image = blank_image(side)
            image.header = header(STAMP_NS + flight * 100_000_000, f"{side}_optical")
            publisher.publish(image if kind is Image else encoded(image, png))
        assert rig.until(lambda pairs=flight + 1: len(rig.received) == pairs), flight


@pytest.mark.parametrize(("extractor", "text"), [("sfit", "use one of sift, asift"), ("surf", "pip install mahotas")])
def test_an_invalid_extractor_ends_the_node(extractor, text):
    hide = "import sys; sys.modules['mahotas.features'] = None; from uav_vslam.ros.stereo_frontend_node import main"
    command = [
        sys.executable,
        "-c",
        f"{hide}; sys.exit(main())",
        "--ros-args",
        "-r",
        "__ns:=/uav1",
        "-p",
        f"frontend.extractor:={extractor}",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert text in done.stderr


def test_static_transforms_of_one_publisher_per_camera_all_arrive(domain_id):
    """Each has latched its own message before the node starts, as static_transform_publisher does."""
    rclpy.init(args=["--ros-args", "-r", "__ns:=/uav1"], domain_id=domain_id)
    publishers = [rclpy.create_node(f"static_{k}") for k in range(5)]
    edges = extrinsics(SimpleNamespace(base_frame="uav1/base_link")).transforms
    other = [
        transform_to_msg(Pose.identity(), stamp_ns=0, parent="uav1/base_link", child=f"extra_{k}") for k in range(3)
    ]
    for node, edge in zip(publishers, [*edges, *other], strict=True):
        node.create_publisher(TFMessage, "/tf_static", LATCHED).publish(TFMessage(transforms=[edge]))
    front, tester = StereoFrontendNode(), rclpy.create_node("tester")
    executor = SingleThreadedExecutor()
    for node in (*publishers, front, tester):
        executor.add_node(node)
    infos = {side: tester.create_publisher(CameraInfo, f"{side}/camera_info", STATE) for side in ("left", "right")}
    try:
        for side, publisher in infos.items():
            assert wait_for(publisher.get_subscription_count, lambda: executor.spin_once(timeout_sec=0.02))
            publisher.publish(calibration(side))
        assert wait_for(lambda: front._rig.rig is not None, lambda: executor.spin_once(timeout_sec=0.02))
    finally:
        for node in (*publishers, front, tester):
            node.destroy_node()
        rclpy.shutdown()


def test_static_transforms_published_while_the_node_is_paused_count_afterwards(graph):
    front, other, executor = graph

    def until(condition):
        assert wait_for(condition, lambda: executor.spin_once(timeout_sec=0.02))

    transforms = other.create_publisher(TFMessage, "/tf_static", LATCHED)
    until(transforms.get_subscription_count)
    front.trigger_deactivate()
    transforms.publish(extrinsics(front))
    until(lambda: front.counts["paused"])
    front.trigger_activate()
    for side in ("left", "right"):
        deliver(front, f"{side}/camera_info", calibration(side))
    until(lambda: front._rig.rig is not None)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        (("input.topics.left:=left/image_rect/compressed",), "image_rect/compressed is rectified by its name"),
        (("input.rectified:=true",), "/uav1/left/image_raw is raw by its name"),
        ((), ""),
        (("input.topics.left:=left/image_rect", "input.topics.right:=right/image_rect", "input.rectified:=true"), ""),
    ],
)
def test_images_that_are_undistorted_twice_or_never_by_their_names_are_told_once(domain_id, parameters, said, capfd):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made(*parameters)
        for _ in range(2):
            for side in ("left", "right"):
                info = calibration(side, lens=(-0.1, 0.01, 0.0, 0.0, 0.0))
                info.r, info.p = np.eye(3).ravel(), np.array([50.0, 0, 32, 0, 0, 50, 24, 0, 0, 0, 1, 0])
                deliver(node, f"{side}/camera_info", info)
            deliver(node, "/tf_static", extrinsics(node))
    lines = [line for line in capfd.readouterr().err.splitlines() if "by its name" in line]
    assert len(lines) == bool(said)
    assert all(said in line for line in lines)
    assert ("lens" in node.notes) == bool(said)


def test_a_silent_camera_is_reported_again_after_a_reset(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node, image = made(), blank_image("left")
        for begin in (0, MAX_ALONE):
            for k in range(begin, begin + MAX_ALONE):
                image.header = header(STAMP_NS + k * 100_000_000, "left_optical")
                deliver(node, "left/image_raw", image)
            assert "one camera is silent" in node.alarms["pairs"]
            node.reset()
            assert "pairs" not in node.alarms


def test_images_without_a_stamp_are_named_as_that(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        for _ in range(MAX_ALONE):
            for side in ("left", "right"):
                image = blank_image(side)
                image.header = header(0, f"{side}_optical")
                deliver(node, f"{side}/image_raw", image)
        assert "their stamps repeat" in node.alarms["pairs"]
        assert "the newest is 0.000 s" in node.alarms["pairs"]


def calibrate(node: StereoFrontendNode) -> None:
    """Deliver the calibration of both cameras."""
    deliver(node, "/tf_static", extrinsics(node))
    for side in ("left", "right"):
        deliver(node, f"{side}/camera_info", calibration(side))


def test_a_calibration_that_changes_in_flight_is_named_and_used_after_a_reset(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        calibrate(node)
        used = node._rig.rig
        zoomed = calibration("left")
        zoomed.k[0] *= 1.1
        for told, failing in (
            (calibration("left"), False),
            (zoomed, True),
            (zoomed, True),
            (calibration("left"), False),
        ):
            deliver(node, "left/camera_info", told)
            assert ("calibration" in node.failures) == failing
        assert node._rig.rig is used
        moved = extrinsics(node)
        moved.transforms[1].transform.translation.x += 0.1
        deliver(node, "/tf_static", moved)
        deliver(node, "left/camera_info", zoomed)
        text = node.failures["calibration"]
        assert f"f ({zoomed.k[0]:.2f}, 50.00)" in text
        assert f"in use {WIDTH}x{HEIGHT} px, f ({used.left.fx:.2f}, 50.00)" in text
        assert "baseline" in text
        node.reset()
        assert "calibration" not in node.failures
        assert node._rig.rig.left.fx == zoomed.k[0]
        assert node._rig.rig.baseline_m != used.baseline_m
        zoomed.k[:] = 0.0
        deliver(node, "left/camera_info", zoomed)
        assert node.counts["dropped/calibration"] == 1
        assert node._rig.rig.left.fx > 0.0


def test_a_camera_info_without_frame_id_is_named(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        for side in ("left", "right"):
            info = calibration(side)
            info.header.frame_id = ""
            deliver(node, f"{side}/camera_info", info)
        assert (
            node.notes["transform"] == "/tf_static has no uav1/base_link -> a camera whose camera_info has no frame_id"
        )


def test_the_leading_slash_of_a_frame_is_left_out(domain_id):
    """tf2 takes no frame with one."""
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        deliver(node, "/tf_static", extrinsics(node))
        for side in ("left", "right"):
            info = calibration(side)
            info.header.frame_id = f"/{side}_optical"
            deliver(node, f"{side}/camera_info", info)
        assert node._rig.rig is not None
        assert node._rig.left_frame("") == "left_optical"


def test_an_invalid_transform_is_dropped_and_not_those_that_come_with_it(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        transforms = extrinsics(node)
        gps = transform_to_msg(Pose.identity(), stamp_ns=0, parent=node.base_frame, child="gps")
        gps.transform.rotation.w = 0.0
        transforms.transforms = [gps, *transforms.transforms]
        deliver(node, "/tf_static", transforms)
        for side in ("left", "right"):
            deliver(node, f"{side}/camera_info", calibration(side))
        assert node._rig.rig is not None
        assert node.counts["dropped/transform"] == 1


def test_a_loop_of_transforms_is_named(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        back = transform_to_msg(Pose.identity(), stamp_ns=0, parent="left_optical", child=node.base_frame)
        deliver(node, "/tf_static", TFMessage(transforms=[back]))
        calibrate(node)
        assert node.notes["transform"] == (
            "/tf_static has no uav1/base_link -> left_optical without a loop (each is the child of the next: "
            "left_optical, uav1/base_link, left_optical)"
        )


def test_a_lens_that_changes_in_flight_is_named(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        calibrate(node)
        lens = calibration("left")
        lens.distortion_model, lens.d = "equidistant", [0.1, 0.0, 0.0, 0.0]
        deliver(node, "left/camera_info", lens)
        told, in_use = node.failures["calibration"].split("in use")
        assert told.endswith("equidistant (0.1, 0, 0, 0), ")
        assert in_use.endswith("plumb_bob (0, 0, 0, 0, 0)")


def test_cameras_that_are_swapped_in_flight_are_logged_as_that(domain_id, capfd):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        calibrate(node)
        for _ in range(2):
            for side, other in (("left", "right"), ("right", "left")):
                deliver(node, f"{side}/camera_info", calibration(other))
        logged = [line for line in capfd.readouterr().err.splitlines() if "the calibration has changed" in line]
        assert len(logged) == 2
        assert "both cameras have the frame" in logged[0]  # both were the right one
        assert node.failures["calibration"] in logged[1]
        assert "places of the cameras" in logged[1]


def test_an_image_that_can_not_be_read_is_an_alarm_that_says_why(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        calibrate(node)
        left, right = blank_image("left"), blank_image("right")
        right.step = 0
        deliver(node, "left/image_raw", left)
        deliver(node, "right/image_raw", right)
        assert "the right image could not be read" in node.alarms["image"]
        assert f"a step of 0; its step must be at least {WIDTH} bytes" in node.alarms["image"]
        assert node.counts["dropped/image"] == 1
        left.step, left.header.stamp.sec = 0, left.header.stamp.sec + 1
        right.header = left.header
        deliver(node, "left/image_raw", left)
        deliver(node, "right/image_raw", right)
        assert node.alarms["image"].count("a step of 0") == 1  # though it is of both


def test_images_of_another_size_than_their_calibration_are_an_alarm_while_they_come(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        calibrate(node)
        for k, (width, told) in enumerate([(WIDTH, False), (WIDTH // 2, True), (WIDTH // 2, True), (WIDTH, False)]):
            for side in ("left", "right"):
                image = blank_image(side)
                image.header = header(STAMP_NS + k * 100_000_000, f"{side}_optical")
                image.height, image.width, image.step = HEIGHT * width // WIDTH, width, width
                deliver(node, f"{side}/image_raw", image)
            size = f"the left image is {WIDTH // 2}x{HEIGHT // 2} px, but its calibration is for {WIDTH}x{HEIGHT} px"
            assert (size in " ".join(node.alarms.values())) == told
        assert node.counts["dropped/image_size"] == 2


def test_a_calibration_that_changes_to_one_that_can_not_be_used_is_named_as_long_as_it_lasts(domain_id):
    with lone_node(StereoFrontendNode, domain_id) as made:
        node = made()
        calibrate(node)
        used = node._rig.rig
        elsewhere = calibration("left")
        elsewhere.header.frame_id = "gimbal"
        deliver(node, "left/camera_info", elsewhere)
        assert "can't be used: /tf_static does not connect uav1/base_link and gimbal" in node.failures["calibration"]
        node.reset()
        assert "calibration" in node.failures
        assert node._rig.rig is used
        deliver(node, "left/camera_info", calibration("left"))
        assert "calibration" not in node.failures
