# SPDX-License-Identifier: Apache-2.0
"""A recording with foreign topics, frames, clocks and calibration gives the same events as the conventional one."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ros1_frames import repeated_on_tf

from uav_vslam.config import InputConfig, load_vehicle
from uav_vslam.config.input import FramesConfig, TopicsConfig
from uav_vslam.datasets.bag import open_flight, vehicles
from uav_vslam.datasets.cdr import RawMessage, decode, encode, message
from uav_vslam.errors import CalibrationError, UavVslamError
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.offline.track import track_vehicle
from uav_vslam.studies.recordings.foreign import (
    FOREIGN_TOPICS,
    UPSIDE_DOWN,
    Change,
    edited,
    kalibr_of,
    renamed,
    rewritten,
    shifted,
    turned,
    with_imu_edge,
    without,
)
from uav_vslam.types import NS_PER_S, ImuSample, StereoFrame


def events(bag: Path, config: InputConfig | None = None) -> list[ImuSample | StereoFrame]:
    return list(open_flight(bag, "uav1", config).iter_events())


def assert_same(found: Sequence[Any], expected: Sequence[Any], *, atol: float = 0.0) -> None:
    assert [event.stamp_ns for event in found] == [event.stamp_ns for event in expected]
    for ours, true in zip(found, expected, strict=True):
        if isinstance(true, ImuSample):
            np.testing.assert_allclose(ours.gyro, true.gyro, rtol=0, atol=atol)
            np.testing.assert_allclose(ours.accel, true.accel, rtol=0, atol=atol)
        else:
            np.testing.assert_array_equal(ours.left, true.left)
            np.testing.assert_array_equal(ours.right, true.right)


def test_topics_of_any_name(tiny_bag: Path, tmp_path: Path) -> None:
    bag = rewritten(tiny_bag, tmp_path / "bag", renamed)
    flight = open_flight(bag, "uav1", InputConfig(topics=FOREIGN_TOPICS))
    assert flight.frame_count == 6
    assert flight.initial_state is not None
    assert_same(list(flight.iter_events()), events(tiny_bag))


def test_stereo_stamps_three_milliseconds_apart(tiny_bag: Path, tmp_path: Path) -> None:
    bag = rewritten(
        tiny_bag, tmp_path / "bag", edited("/uav1/right/image_raw", lambda image: shifted(image, 3_000_000))
    )
    assert_same(events(bag), events(tiny_bag))
    config = InputConfig(pair_tolerance_s=0.002)
    flight = open_flight(bag, "uav1", config)
    assert not [event for event in flight.iter_events() if isinstance(event, StereoFrame)]
    assert "3 ms apart" in flight.unpaired_reason()


def test_cameras_of_different_clocks_are_named(tiny_bag: Path, tmp_path: Path) -> None:
    later = edited("/uav1/right/image_raw", lambda image: shifted(image, 1000 * NS_PER_S))
    flight = open_flight(rewritten(tiny_bag, tmp_path / "bag", later), "uav1")
    reason = flight.unpaired_reason()
    assert "s apart (median): their clocks differ" in reason
    assert "pair_tolerance_s" not in reason


def test_images_without_stamps_are_the_reason_for_a_start_that_is_not_found(tiny_bag: Path, tmp_path: Path) -> None:
    """ "None of 1 frames allowed a start", without a word about the others."""

    def unstamped(image: Any) -> Any:
        image.header.stamp.sec = image.header.stamp.nanosec = 0
        return image

    changes = [edited(f"/uav1/{side}/image_raw", unstamped) for side in ("left", "right")]
    flight = open_flight(rewritten(tiny_bag, tmp_path / "bag", *changes), "uav1")
    said = r"5 of 6 left images found no partner: 5 of 6 stamps of /uav1/left/image_raw are repeated"
    with pytest.raises(UavVslamError, match=said):
        track_vehicle(flight, load_vehicle(None, overrides={"start.method": "in_flight"}))


def test_a_flight_of_a_few_images_that_found_a_partner_is_no_quiet_success(tiny_bag: Path, tmp_path: Path) -> None:
    shifts_ns = itertools.chain([0, 0], itertools.repeat(30_000_000))
    bag = rewritten(
        tiny_bag, tmp_path / "bag", edited("/uav1/right/image_raw", lambda image: shifted(image, next(shifts_ns)))
    )
    track = track_vehicle(open_flight(bag, "uav1"), load_vehicle(None))
    assert len(track.outputs) == 2
    assert any("4 of 6 left images found no partner: " in text for text in track.warnings)


def test_a_kalibr_file_replaces_camera_info_and_static_frames(tiny_bag: Path, tmp_path: Path) -> None:
    infos = ("/uav1/left/camera_info", "/uav1/right/camera_info")
    bag = rewritten(tiny_bag, tmp_path / "bag", without("/tf_static", *infos))
    flight = open_flight(bag, "uav1", InputConfig(calibration=(kalibr_of(tiny_bag, tmp_path),)))
    assert_same(list(flight.iter_events()), events(tiny_bag))
    expected = open_flight(tiny_bag, "uav1").rig
    np.testing.assert_allclose(flight.rig.T_body_right.matrix, expected.T_body_right.matrix, atol=1e-12)


def test_a_camera_clock_that_lags_is_moved_to_the_imus(tiny_bag: Path, tmp_path: Path) -> None:
    changes = [edited(f"/uav1/{side}/image_raw", lambda image: shifted(image, 5_000_000)) for side in ("left", "right")]
    bag = rewritten(tiny_bag, tmp_path / "bag", *changes)
    calibration = kalibr_of(tiny_bag, tmp_path, timeshift_s=-0.005)
    assert_same(events(bag, InputConfig(calibration=(calibration,))), events(tiny_bag))


def test_an_imu_in_its_own_frame_is_turned_to_the_body(tiny_bag: Path, tmp_path: Path) -> None:
    changes = [edited("/uav1/imu/data_raw", turned), edited("/tf_static", with_imu_edge)]
    bag = rewritten(tiny_bag, tmp_path / "bag", *changes)
    assert_same(events(bag), events(tiny_bag), atol=1e-12)


def test_an_imu_frame_that_nothing_connects_is_refused_with_the_remedy(tiny_bag: Path, tmp_path: Path) -> None:
    bag = rewritten(tiny_bag, tmp_path / "bag", edited("/uav1/imu/data_raw", turned))
    with pytest.raises(CalibrationError, match=r"does not connect uav1/base_link and imu_link.*input\.frames"):
        open_flight(bag, "uav1")
    named = InputConfig(frames=FramesConfig(imu="uav1/base_link"))
    open_flight(bag, "uav1", named)


def test_a_start_state_of_another_body_than_the_files_is_refused_with_the_remedy(
    tiny_bag: Path, tmp_path: Path
) -> None:
    changes = [edited("/uav1/imu/data_raw", turned), edited("/tf_static", with_imu_edge)]
    bag = rewritten(tiny_bag, tmp_path / "bag", *changes)
    calibration = (kalibr_of(tiny_bag, tmp_path, T_body_imu=UPSIDE_DOWN),)
    with pytest.raises(CalibrationError, match=r"initial_state is of uav1/base_link.*input\.frames\.base"):
        open_flight(bag, "uav1", InputConfig(calibration=calibration))
    named = InputConfig(calibration=calibration, frames=FramesConfig(base="uav1/base_link", imu="imu_link"))
    flight, expected = open_flight(bag, "uav1", named), open_flight(tiny_bag, "uav1")
    assert_same(list(flight.iter_events()), events(tiny_bag), atol=1e-12)
    np.testing.assert_allclose(flight.rig.T_body_right.matrix, expected.rig.T_body_right.matrix, atol=1e-12)
    assert flight.warnings == ()


def test_constant_frames_on_tf_stand_for_those_of_tf_static(tiny_bag: Path, tmp_path: Path) -> None:
    flight, expected = open_flight(repeated_on_tf(tiny_bag, tmp_path / "bag"), "uav1"), open_flight(tiny_bag, "uav1")
    assert_same(list(flight.iter_events()), events(tiny_bag))
    for side in ("left", "right"):
        found, true = (getattr(one.rig, f"T_body_{side}").matrix for one in (flight, expected))
        np.testing.assert_allclose(found, true, atol=1e-12)
    with pytest.raises(CalibrationError, match="does not connect uav1/base_link and uav1/right_optical"):
        open_flight(repeated_on_tf(tiny_bag, tmp_path / "moving", moving="uav1/right_optical"), "uav1")


def rectified_infos(raw: StereoRig, frames: Sequence[str] = ("", "")) -> tuple[list[Change], Any, Any, Any]:
    """Return changes that give camera_info R and P of the rectified pair, and other frames; and R_left and both P."""
    size, T = (raw.left.width, raw.left.height), raw.T_right_left
    R_left, R_right, P_left, P_right, *_ = cv2.stereoRectify(
        raw.left.K, raw.left.distortion, raw.right.K, raw.right.distortion, size, T.R, T.t
    )

    def told(R: Any, P: Any, frame: str) -> Any:
        def tell(info: Any) -> Any:
            info.header.frame_id = frame or info.header.frame_id
            return dataclasses.replace(info, r=R.ravel(), p=P.ravel())

        return tell

    pairs = zip(("left", "right"), (R_left, R_right), (P_left, P_right), frames, strict=True)
    changes = [edited(f"/uav1/{side}/camera_info", told(*numbers)) for side, *numbers in pairs]
    return changes, R_left, P_left, P_right


def test_rectified_images_have_the_rig_of_p_and_r(tiny_bag: Path, tmp_path: Path) -> None:
    raw = open_flight(tiny_bag, "uav1").rig
    changes, R_left, P_left, P_right = rectified_infos(raw)
    bag = rewritten(tiny_bag, tmp_path / "bag", *changes)
    rig = open_flight(bag, "uav1", InputConfig(rectified=True)).rig
    np.testing.assert_allclose(rig.left.K, P_left[:, :3])
    np.testing.assert_allclose(rig.right.K, P_right[:, :3])
    np.testing.assert_allclose(rig.T_right_left.R, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(rig.T_right_left.t, P_right[:, 3] / max(P_right[0, 0], 1.0), atol=1e-9)
    assert_points = np.array([[1.0, 2.0, 40.0], [-3.0, 0.5, 70.0]])  # in the body both rigs see the same directions
    left = rig.T_body_left.inverse().apply(raw.T_body_left.apply(assert_points))
    np.testing.assert_allclose(left, assert_points @ R_left.T, atol=1e-9)


@pytest.mark.parametrize("rectified", [False, True])
def test_cameras_with_one_frame_are_apart_as_p_says(rectified: bool, tiny_bag: Path, tmp_path: Path) -> None:
    """Drivers of stereo cameras give both the left one's frame."""
    raw = open_flight(tiny_bag, "uav1").rig
    changes = rectified_infos(raw, frames=("uav1/left_optical", "uav1/left_optical"))[0]
    apart = rewritten(tiny_bag, tmp_path / "apart", *rectified_infos(raw)[0])
    together = rewritten(tiny_bag, tmp_path / "together", *changes)
    expected, found = (open_flight(bag, "uav1", InputConfig(rectified=rectified)).rig for bag in (apart, together))
    np.testing.assert_allclose(found.T_body_right.matrix, expected.T_body_right.matrix, atol=1e-9)


def test_cameras_with_one_frame_and_no_baseline_are_refused(tiny_bag: Path, tmp_path: Path) -> None:
    def left(info: Any) -> Any:
        info.header.frame_id = "uav1/left_optical"
        return info

    bag = rewritten(tiny_bag, tmp_path / "bag", edited("/uav1/right/camera_info", left))
    with pytest.raises(CalibrationError, match=r"both cameras have the frame 'uav1/left_optical'.*frames\.right"):
        open_flight(bag, "uav1")


def test_an_imu_without_a_frame_is_noticed(tiny_bag: Path, tmp_path: Path) -> None:
    def unnamed(reading: Any) -> Any:
        reading.header.frame_id = ""
        return reading

    bag = rewritten(tiny_bag, tmp_path / "bag", edited("/uav1/imu/data_raw", unnamed))
    (warning,) = open_flight(bag, "uav1").warnings
    assert "/uav1/imu/data_raw has no frame_id" in warning
    assert open_flight(tiny_bag, "uav1").warnings == ()


def test_vehicles_are_found_by_the_name_of_their_left_image(tiny_bag: Path, tmp_path: Path) -> None:
    def other(raw: RawMessage) -> RawMessage:
        return dataclasses.replace(raw, topic=raw.topic.replace("/left/image_raw", "/cam0/image"))

    bag = rewritten(tiny_bag, tmp_path / "bag", other)
    assert vehicles([bag]) == []
    config = InputConfig(topics=TopicsConfig(left="cam0/image"))
    assert vehicles([bag], config) == vehicles([tiny_bag])
    assert open_flight(bag, vehicles([bag], config)[0], config).frame_count == 6


@pytest.mark.parametrize("kind", ["PoseStamped", "TransformStamped"])
def test_truth_of_poses_alone_gets_its_velocity_by_differences(kind: str, tiny_bag: Path, tmp_path: Path) -> None:
    def posed(raw: RawMessage) -> RawMessage:
        if raw.topic != "/uav1/ground_truth/odometry":
            return raw
        full = decode(raw)
        pose, msgtype = full.pose.pose, f"geometry_msgs/msg/{kind}"
        if kind == "PoseStamped":
            built = message(msgtype, header=full.header, pose=pose)
        else:
            p = pose.position
            translation = message("geometry_msgs/msg/Vector3", x=p.x, y=p.y, z=p.z)
            transform = message("geometry_msgs/msg/Transform", translation=translation, rotation=pose.orientation)
            built = message(msgtype, header=full.header, child_frame_id="uav1/base_link", transform=transform)
        return dataclasses.replace(raw, topic="/vicon", msgtype=msgtype, data=encode(built))

    bag = rewritten(tiny_bag, tmp_path / "bag", posed)
    found = open_flight(bag, "uav1", InputConfig(topics=TopicsConfig(truth="/vicon"))).truth()
    expected = open_flight(tiny_bag, "uav1").truth()
    assert found is not None
    assert expected is not None
    np.testing.assert_array_equal(found.positions_world, expected.positions_world)
    inner = slice(1, -1)  # central differences; the ends are one-sided
    np.testing.assert_allclose(found.velocities_world[inner], expected.velocities_world[inner], atol=0.01)


def test_the_distance_of_the_stamps_is_that_to_the_nearest_partner(tiny_bag: Path, tmp_path: Path) -> None:
    later = edited("/uav1/right/image_raw", lambda image: shifted(image, 3_000_000))
    earlier = edited("/uav1/right/image_raw", lambda image: shifted(image, -4_000_000))
    for change, apart in ((later, 3_000_000), (earlier, 4_000_000)):
        flight = open_flight(rewritten(tiny_bag, tmp_path / str(apart), change), "uav1")
        np.testing.assert_array_equal(flight.stamps_apart_ns(), np.full(6, apart))
    empty = open_flight(rewritten(tiny_bag, tmp_path / "same"), "uav1")
    np.testing.assert_array_equal(empty.stamps_apart_ns(2), np.zeros(2))


def test_the_distance_of_the_stamps_does_not_depend_on_the_order_of_recording(tiny_bag: Path, tmp_path: Path) -> None:
    def last_first(raw: RawMessage) -> RawMessage:
        late = raw.topic == "/uav1/right/image_raw"
        return dataclasses.replace(raw, stamp_ns=4 * 10**18 - raw.stamp_ns) if late else raw

    flight = open_flight(rewritten(tiny_bag, tmp_path / "reversed", last_first), "uav1")
    np.testing.assert_array_equal(flight.stamps_apart_ns(), np.zeros(6))
