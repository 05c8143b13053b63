# SPDX-License-Identifier: Apache-2.0
"""Topics of strangers' recordings are guessed from names and types."""

import pytest
import yaml

from uav_vslam.config import InputConfig
from uav_vslam.datasets.rosbag import TopicInfo
from uav_vslam.inspection.topics import configuration_block, guess_topics, topics_to_set

IMAGE, IMU = "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu"
INFO, POSE = "sensor_msgs/msg/CameraInfo", "geometry_msgs/msg/PoseStamped"


def recorded(**kinds: list[str]) -> dict[str, TopicInfo]:
    types = {"images": IMAGE, "imus": IMU, "infos": INFO, "poses": POSE}
    return {topic: TopicInfo(types[kind], 100, False) for kind, topics in kinds.items() for topic in topics}


RECORDINGS = {
    "realsense": (
        recorded(
            images=["/camera/infra2/image_rect_raw", "/camera/depth/image_rect_raw", "/camera/infra1/image_rect_raw"],
            infos=["/camera/infra1/camera_info", "/camera/infra2/camera_info", "/camera/depth/camera_info"],
            imus=["/camera/imu"],
        ),
        {
            "left": "/camera/infra1/image_rect_raw",
            "right": "/camera/infra2/image_rect_raw",
            "left_info": "/camera/infra1/camera_info",
            "right_info": "/camera/infra2/camera_info",
            "imu": "/camera/imu",
        },
    ),
    "realsense, sensors apart": (
        recorded(
            images=["/camera/infra2/image_rect_raw", "/camera/infra1/image_rect_raw"],
            imus=["/camera/accel/sample", "/camera/gyro/sample"],
        ),
        {
            "left": "/camera/infra1/image_rect_raw",
            "right": "/camera/infra2/image_rect_raw",
            "imu": "/camera/gyro/sample",
            "accel": "/camera/accel/sample",
        },
    ),
    "euroc": (
        recorded(images=["/cam1/image_raw", "/cam0/image_raw"], imus=["/imu0"], poses=["/vicon/firefly", "/goal"]),
        {"left": "/cam0/image_raw", "right": "/cam1/image_raw", "imu": "/imu0", "truth": "/vicon/firefly"},
    ),
    "zed": (
        recorded(
            images=["/zed/zed_node/left_raw/image_raw_gray", "/zed/zed_node/right_raw/image_raw_gray"],
            infos=["/zed/zed_node/left_raw/camera_info", "/zed/zed_node/right_raw/camera_info"],
            imus=["/zed/zed_node/imu/data", "/zed/zed_node/imu/data_raw"],
        ),
        {
            "left": "/zed/zed_node/left_raw/image_raw_gray",
            "right": "/zed/zed_node/right_raw/image_raw_gray",
            "left_info": "/zed/zed_node/left_raw/camera_info",
            "right_info": "/zed/zed_node/right_raw/camera_info",
            "imu": "/zed/zed_node/imu/data_raw",
        },
    ),
    "zed, rectified": (
        recorded(
            images=[
                f"/zed/{name}" for name in ("right/image_rect_color", "left/image_rect_color", "rgb/image_rect_color")
            ],
            imus=["/zed/imu/data"],
        ),
        {"left": "/zed/left/image_rect_color", "right": "/zed/right/image_rect_color", "imu": "/zed/imu/data"},
    ),
    "tumvi": (
        recorded(images=["/cam1/image_raw", "/cam0/image_raw"], imus=["/imu0"], poses=["/vrpn_client/raw_transform"]),
        {"left": "/cam0/image_raw", "right": "/cam1/image_raw", "imu": "/imu0", "truth": "/vrpn_client/raw_transform"},
    ),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_usual_names_are_recognised(name: str) -> None:
    topics, expected = RECORDINGS[name]
    assert guess_topics(topics, "uav1").best == expected


def test_the_block_to_paste_is_a_valid_configuration_and_names_alternatives() -> None:
    topics, expected = RECORDINGS["zed"]
    guess = guess_topics(topics, "uav1")
    to_set = topics_to_set(topics, guess, "uav1", InputConfig())
    block = configuration_block(to_set, guess, {"imu.accel_noise": 0.02})
    assert "# or /zed/zed_node/imu/data" in block
    tree = yaml.safe_load(block)["/**"]["ros__parameters"]
    assert tree == {"input": {"topics": expected}, "imu": {"accel_noise": 0.02}}


def test_vehicles_are_no_pair() -> None:
    names = [f"/{vehicle}/{side}/image" for vehicle in ("uav1", "uav2") for side in ("left", "right")]
    pairs = [(f"/{vehicle}/left/image", f"/{vehicle}/right/image") for vehicle in ("uav1", "uav2")]
    assert guess_topics(recorded(images=names), "ghost").stereo == pairs
    names = [f"/uav{k}/cam{i}/image" for k in (1, 2) for i in (0, 1)]
    assert guess_topics(recorded(images=names), "ghost").stereo == [(names[0], names[1]), (names[2], names[3])]


def test_an_imu_beside_the_cameras_namespace_is_found_and_that_of_another_vehicle_is_not() -> None:
    images = ["/stereo/left/image_raw", "/stereo/right/image_raw", "/uav2/left/image_raw"]
    alone = recorded(images=images, imus=["/snappy_imu", "/uav2/imu/data"])
    assert guess_topics(alone, "stereo").others["imu"] == ["/snappy_imu"]
    its_own = recorded(images=images, imus=["/snappy_imu", "/stereo/imu"])
    assert guess_topics(its_own, "stereo").others["imu"] == ["/stereo/imu"]


def test_two_rigs_are_both_named_and_one_camera_is_no_pair() -> None:
    topics = recorded(images=["/front/cam0/image", "/front/cam1/image", "/down/cam0/image", "/down/cam1/image"])
    guess = guess_topics(topics, "uav1")
    assert sorted(guess.stereo) == [
        ("/down/cam0/image", "/down/cam1/image"),
        ("/front/cam0/image", "/front/cam1/image"),
    ]
    assert guess_topics(recorded(images=["/camera/image_raw"]), "uav1").stereo == []
