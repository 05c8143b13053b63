# SPDX-License-Identifier: Apache-2.0
"""Vehicles are told from drivers of their sensors by the topics of their namespaces."""

from collections.abc import Sequence

from uav_vslam.config import InputConfig
from uav_vslam.datasets.rosbag import TopicInfo
from uav_vslam.inspection.vehicles import vehicles_of

IMAGE, IMU = "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu"


def recorded(*, images: Sequence[str] = (), imus: Sequence[str] = ()) -> dict[str, TopicInfo]:
    return {topic: TopicInfo(kind, 100, False) for kind, topics in ((IMAGE, images), (IMU, imus)) for topic in topics}


def test_vehicles_are_found_by_any_of_their_topics() -> None:
    topics = recorded(images=["/uav2/right/image_raw/compressed"], imus=["/uav1/imu/data_raw", "/imu"])
    assert vehicles_of(topics, InputConfig()) == ["uav1", "uav2"]
    assert vehicles_of(recorded(imus=["/imu"]), InputConfig()) == ["uav1"]


def test_a_second_imu_of_a_vehicle_is_no_vehicle() -> None:
    """MAVROS has it in a namespace of its own."""
    names = ["/uav1/mavros/imu/data_raw", "/uav1/imu/data_raw", "/fleet/uav2/imu/data_raw"]
    topics = recorded(images=["/uav1/left/image_raw", "/fleet/uav2/left/image_raw"], imus=names)
    assert vehicles_of(topics, InputConfig()) == ["fleet/uav2", "uav1"]
    driver = recorded(images=["/zed/zed_node/left/image_rect"], imus=["/zed/zed_node/imu/data_raw"])
    assert vehicles_of(driver, InputConfig()) == ["uav1"]
    beside = ["/stereo/left/image_raw", "/stereo/right/image_raw"]
    assert vehicles_of(recorded(images=beside, imus=["/mavros/imu/data_raw"]), InputConfig()) == ["stereo"]
    without_cameras = recorded(images=beside, imus=["/stereo/imu/data_raw", "/uav2/imu/data_raw"])
    assert vehicles_of(without_cameras, InputConfig()) == ["stereo", "uav2"]
    drivers = recorded(
        images=[f"/uav{k}/stereo/{side}/image_raw" for k in (1, 2) for side in ("left", "right")],
        imus=["/uav1/mavros/imu/data_raw", "/uav2/mavros/imu/data"],
    )
    assert vehicles_of(drivers, InputConfig()) == ["uav1", "uav2"]
    fleet = recorded(images=["/fleet/uav1/left/image_raw", "/fleet/uav2/left/image_raw"], imus=["/fleet/uav1/imu/data"])
    assert vehicles_of(fleet, InputConfig()) == ["fleet/uav1", "fleet/uav2"]
    inner = recorded(images=["/uav1/left/image_raw", "/uav1/payload/left/image_raw"])
    assert vehicles_of(inner, InputConfig()) == ["uav1", "uav1/payload"]


def test_vehicles_of_other_names_are_those_whose_cameras_are_named_alike() -> None:
    images = [f"/drone{k}/camera/infra{i}/image_rect_raw" for k in (1, 2) for i in (1, 2)]
    imus = ["/drone1/camera/imu", "/drone2/mavros/imu/data"]
    assert vehicles_of(recorded(images=images, imus=imus), InputConfig()) == ["drone1", "drone2"]
    rigs = recorded(images=[f"/{rig}/cam{k}/image_raw" for rig in ("down", "front") for k in (0, 1)], imus=["/imu"])
    assert vehicles_of(rigs, InputConfig()) == ["uav1"]
