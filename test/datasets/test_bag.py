# SPDX-License-Identifier: Apache-2.0
"""A recorded flight reads back as simulated, and an incomplete recording is refused by name."""

import copy
import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uav_vslam.config import VehicleConfig
from uav_vslam.datasets.bag import open_flight, vehicles
from uav_vslam.datasets.bag_flight import in_stamp_order
from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import RawMessage, decode, encode
from uav_vslam.datasets.flight_writer import ImageCoding
from uav_vslam.datasets.message_builders import camera_info_message, image_message, transforms_message
from uav_vslam.datasets.messages import stamp_ns_of, transforms_of
from uav_vslam.datasets.rosbag import UpToDamage, iter_raw
from uav_vslam.datasets.truth import truth_warnings
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.offline.track import track_vehicle
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.types import ImuSample, StereoFrame

JPEG_MEAN_GREY = 4.0  # mean absolute error of quality 90 on noisy grass


def rewrite(source: Path, out: Path, change: Callable[[RawMessage], RawMessage | None]) -> Path:
    """Copy a bag; `change` edits or (None) drops messages."""
    with RawRecorder(out) as recorder:
        for raw in iter_raw([source]):
            changed = change(raw)
            if changed is not None:
                recorder.write(changed.topic, changed.msgtype, changed.data, changed.stamp_ns)
    return out


def drop(topic: str) -> Callable[[RawMessage], RawMessage | None]:
    return lambda raw: None if raw.topic == topic else raw


@pytest.mark.parametrize("index", [0, 1])
def test_a_recorded_flight_is_the_simulated_one(tiny: Scenario, tiny_bag: Path, index: int) -> None:
    vehicle = simulate_vehicle(tiny, index)
    flight = open_flight(tiny_bag, vehicle.name)
    assert (flight.vehicle, flight.frame_count, flight.image_size) == (vehicle.name, 6, (160, 120))
    np.testing.assert_array_equal(flight.rig.left.K, vehicle.rig.left.K)
    np.testing.assert_array_equal(flight.rig.right.K, vehicle.rig.right.K)
    np.testing.assert_allclose(flight.rig.T_right_left.matrix, vehicle.rig.T_right_left.matrix, atol=1e-12)
    np.testing.assert_allclose(flight.rig.T_body_left.matrix, vehicle.rig.T_body_left.matrix, atol=1e-12)
    assert flight.initial_state is not None
    state, expected = flight.initial_state.state, vehicle.initial.state
    assert state.stamp_ns == expected.stamp_ns == vehicle.frame_stamps_ns[0]
    np.testing.assert_allclose(state.T_map_body.matrix, expected.T_map_body.matrix, atol=1e-12)
    np.testing.assert_array_equal(state.v_map, expected.v_map)
    np.testing.assert_array_equal(flight.initial_state.covariance, vehicle.initial.covariance)


def test_events_comein_stamp_order_with_every_bit(tiny: Scenario, tiny_bag: Path) -> None:
    vehicle = simulate_vehicle(tiny, 0)
    events = list(open_flight(tiny_bag, "uav1").iter_events())
    stamps = [event.stamp_ns for event in events]
    assert stamps == sorted(stamps)
    samples = [event for event in events if isinstance(event, ImuSample)]
    assert [s.stamp_ns for s in samples] == vehicle.imu.stamps_ns.tolist()
    np.testing.assert_array_equal(np.array([s.gyro for s in samples]), vehicle.imu.gyro)
    np.testing.assert_array_equal(np.array([s.accel for s in samples]), vehicle.imu.accel)
    frames = [event for event in events if isinstance(event, StereoFrame)]
    for frame, expected in zip(frames, RenderedFlight(vehicle), strict=True):
        assert frame.stamp_ns == expected.stamp_ns
        np.testing.assert_array_equal(frame.left, expected.left)
        np.testing.assert_array_equal(frame.right, expected.right)


def test_every_frame_has_ground_truth(tiny: Scenario, tiny_bag: Path) -> None:
    vehicle = simulate_vehicle(tiny, 1)
    truth = open_flight(tiny_bag, "uav2").truth()
    assert truth is not None
    assert set(vehicle.frame_stamps_ns) <= set(truth.stamps_ns)
    t = vehicle.truth.time_s(truth.stamps_ns)
    np.testing.assert_allclose(truth.positions_world, vehicle.truth.position(t), atol=1e-12)
    np.testing.assert_allclose(truth.R_world_body, vehicle.truth.rotation(t), atol=1e-12)
    np.testing.assert_allclose(truth.velocities_world, vehicle.truth.velocity(t), atol=1e-12)


def test_the_same_seed_gives_the_same_bag(tiny: Scenario, tiny_bag: Path, tmp_path: Path) -> None:
    record(tiny, tmp_path / "tiny")
    assert (tmp_path / "tiny" / "tiny.mcap").read_bytes() == (tiny_bag / "tiny.mcap").read_bytes()


def test_start_state_and_truth_come_before_the_first_image(tiny_bag: Path) -> None:
    first: dict[str, int] = {}
    for number, raw in enumerate(iter_raw([tiny_bag])):
        first.setdefault(raw.topic, number)
    assert first["/tf_static"] == 0
    for name in ("uav1", "uav2"):
        assert first[f"/{name}/initial_state"] < first[f"/{name}/left/camera_info"] < first[f"/{name}/left/image_raw"]
        assert first[f"/{name}/ground_truth/odometry"] < first[f"/{name}/left/image_raw"]


def test_namespaces_are_discovered(tiny_bag: Path) -> None:
    assert vehicles([tiny_bag]) == ["uav1", "uav2"]


@pytest.mark.parametrize("fmt", ["png", "jpeg"])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_compressed_images_read_back(tiny: Scenario, tmp_path: Path, fmt: str, storage: str) -> None:
    short = dataclasses.replace(tiny, frames=2, vehicles=1)
    record(short, tmp_path / "bag", coding=ImageCoding(fmt, 90), storage=storage)
    flight = open_flight(tmp_path / "bag", "uav1")
    assert flight.left_topic == "/uav1/left/image_raw/compressed"
    expected = RenderedFlight(simulate_vehicle(short, 0)).frame(1)
    read = [event for event in flight.iter_events() if isinstance(event, StereoFrame)][1]
    error = np.abs(read.left.astype(int) - expected.left)
    assert error.max() == 0 if fmt == "png" else error.mean() < JPEG_MEAN_GREY


def test_colour_and_deep_images_keep_their_pixels(tiny_bag: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pictures = {
        "left": rng.integers(0, 255, (120, 160, 3), dtype=np.uint8),
        "right": rng.integers(0, 65535, (120, 160), dtype=np.uint16),
    }

    def change(raw: RawMessage) -> RawMessage:
        for side, picture in pictures.items():
            if raw.topic == f"/uav1/{side}/image_raw":
                built = image_message(stamp_ns_of(decode(raw)), "uav1/x", picture)
                return dataclasses.replace(raw, data=encode(built))
        return raw

    flight = open_flight(rewrite(tiny_bag, tmp_path / "bag", change), "uav1")
    frame = next(event for event in flight.iter_events() if isinstance(event, StereoFrame))
    np.testing.assert_array_equal(frame.left, pictures["left"])
    np.testing.assert_array_equal(frame.right, pictures["right"])


def test_extrinsics_may_span_several_frames(tiny_bag: Path, tmp_path: Path) -> None:
    T_base_mount = Pose(so3_exp([0.0, 0.1, 0.0]), np.array([0.1, 0.0, 0.0]))
    T_mount_left = Pose(so3_exp([np.pi, 0.0, 0.0]), np.array([0.0, 0.2, 0.0]))

    def change(raw: RawMessage) -> RawMessage:
        if raw.topic != "/tf_static":
            return raw
        edges = [
            ("uav1/base_link", "uav1/mount", T_base_mount),
            ("uav1/mount", "uav1/left_optical", T_mount_left),
            ("uav1/mount", "uav1/right_optical", T_mount_left @ Pose(np.eye(3), np.array([0.5, 0.0, 0.0]))),
        ]
        return dataclasses.replace(raw, data=encode(transforms_message(raw.stamp_ns, edges)))

    rig = open_flight(rewrite(tiny_bag, tmp_path / "bag", change), "uav1").rig
    np.testing.assert_allclose(rig.T_body_left.matrix, (T_base_mount @ T_mount_left).matrix, atol=1e-12)
    assert rig.baseline_m == pytest.approx(0.5)


@pytest.mark.parametrize(
    "topic",
    [
        "/uav1/left/image_raw",
        "/uav1/right/image_raw",
        "/uav1/left/camera_info",
        "/uav1/right/camera_info",
        "/uav1/imu/data_raw",
        "/tf_static",
    ],
)
def test_a_missing_topic_is_named_with_those_present(tiny_bag: Path, tmp_path: Path, topic: str) -> None:
    bag = rewrite(tiny_bag, tmp_path / "bag", drop(topic))
    with pytest.raises(BagError, match=f"lacks {topic}.*it holds .*/uav1/ground_truth/odometry") as missing:
        open_flight(bag, "uav1")
    assert "\n" not in str(missing.value)


def test_an_unknown_vehicle_is_refused_with_the_topics_present(tiny_bag: Path) -> None:
    with pytest.raises(BagError, match=r"lacks /uav9/left/image_raw .*it holds .*/uav1/imu/data_raw"):
        open_flight(tiny_bag, "uav9")


def test_missing_extrinsics_are_named(tiny_bag: Path, tmp_path: Path) -> None:
    def change(raw: RawMessage) -> RawMessage:
        if raw.topic != "/tf_static":
            return raw
        edges = [("uav2/base_link", "uav2/left_optical", Pose.identity())]
        return dataclasses.replace(raw, data=encode(transforms_message(raw.stamp_ns, edges)))

    bag = rewrite(tiny_bag, tmp_path / "bag", change)
    with pytest.raises(
        CalibrationError, match="does not connect uav1/base_link and uav1/left_optical; it holds uav2/base_link"
    ):
        open_flight(bag, "uav1")


def test_a_flight_without_start_state_or_ground_truth_opens(tiny_bag: Path, tmp_path: Path) -> None:
    bag = rewrite(tiny_bag, tmp_path / "bag", drop("/uav1/initial_state"))
    bag = rewrite(bag, tmp_path / "bag2", drop("/uav1/ground_truth/odometry"))
    flight = open_flight(bag, "uav1")
    assert flight.initial_state is None
    assert flight.truth() is None


def test_a_camera_info_that_was_not_filled_in_yet_gives_way_to_the_next(tiny_bag: Path, tmp_path: Path) -> None:
    def empty(info: Any, number: int) -> None:
        if number < 2:
            info.k = np.zeros(9)

    topic = "/uav1/right/camera_info"
    flight = open_flight(rewrite(tiny_bag, tmp_path / "bag", edited(topic, empty)), "uav1")
    assert flight.rig.right.fx == open_flight(tiny_bag, "uav1").rig.right.fx
    (warning,) = flight.warnings
    assert warning.startswith(f"{topic}: its first message can't be used, and a later one counts: focal length")


TRUTH = "/uav1/ground_truth/odometry"


def edited(topic: str, change: Callable[[Any, int], None]) -> Callable[[RawMessage], RawMessage]:
    """Return a `rewrite` that edits the messages of a topic, given their number."""
    numbers = itertools.count()

    def edit(raw: RawMessage) -> RawMessage:
        if raw.topic != topic:
            return raw
        built = decode(raw)
        change(built, next(numbers))
        return dataclasses.replace(raw, data=encode(built))

    return edit


def test_true_poses_that_are_not_finite_are_left_out_and_counted(tiny_bag: Path, tmp_path: Path) -> None:
    def spoil(built: Any, number: int) -> None:
        if number == 1:
            built.pose.pose.position.x = np.nan
        if number == 3:
            q = built.pose.pose.orientation
            q.w = q.x = q.y = q.z = 0.0

    whole = open_flight(tiny_bag, "uav1").truth()
    truth = open_flight(rewrite(tiny_bag, tmp_path / "bag", edited(TRUTH, spoil)), "uav1").truth()
    assert whole is not None
    assert truth is not None
    assert (truth.left_out, len(truth)) == (2, len(whole) - 2)
    assert np.isfinite(truth.positions_world).all()
    assert any("2 poses of the ground truth" in text for text in truth_warnings(truth))
    assert list(truth_warnings(whole)) == []


def test_a_twist_that_was_never_filled_in_gives_way_to_differences(tiny_bag: Path, tmp_path: Path) -> None:
    def empty(built: Any, _: int) -> None:
        built.twist.twist.linear.x = built.twist.twist.linear.y = built.twist.twist.linear.z = 0.0

    whole = open_flight(tiny_bag, "uav1").truth()
    truth = open_flight(rewrite(tiny_bag, tmp_path / "bag", edited(TRUTH, empty)), "uav1").truth()
    assert whole is not None
    assert truth is not None
    np.testing.assert_allclose(truth.velocities_world[1:-1], whole.velocities_world[1:-1], atol=0.2)


def test_truth_of_another_type_is_told_and_not_read(tiny_bag: Path, tmp_path: Path) -> None:
    with RawRecorder(tmp_path / "bag") as recorder:
        for raw in iter_raw([tiny_bag]):
            if raw.topic != TRUTH:
                recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns, latched=raw.topic == "/tf_static")
            if raw.topic == "/uav1/imu/data_raw":
                recorder.write(TRUTH, raw.msgtype, raw.data, raw.stamp_ns)
    flight = open_flight(tmp_path / "bag", "uav1")
    assert flight.truth() is None
    assert any("sensor_msgs/msg/Imu and is not read" in text for text in flight.warnings)


def test_static_frames_of_another_type_or_not_finite_are_refused(tiny_bag: Path, tmp_path: Path) -> None:
    def far(built: Any, _: int) -> None:
        built.transforms[0].transform.translation.x = np.inf

    with pytest.raises(CalibrationError, match="left_optical: the transform holds NaN or infinity"):
        open_flight(rewrite(tiny_bag, tmp_path / "far", edited("/tf_static", far)), "uav1")
    reading = next(iter_raw([tiny_bag], ["/uav1/imu/data_raw"]))

    def replaced(raw: RawMessage) -> RawMessage:
        same = raw.topic == "/tf_static"
        return dataclasses.replace(reading, topic=raw.topic, stamp_ns=raw.stamp_ns) if same else raw

    with pytest.raises(CalibrationError, match="/tf_static holds sensor_msgs/msg/Imu; record tf2_msgs/msg/TFMessage"):
        open_flight(rewrite(tiny_bag, tmp_path / "other", replaced), "uav1")


def test_an_invalid_transform_of_another_sensor_is_left_out_and_told(tiny_bag: Path, tmp_path: Path) -> None:
    def with_lidar(built: Any, _: int) -> None:
        lidar = copy.deepcopy(built.transforms[0])
        lidar.child_frame_id, lidar.transform.rotation.w = "lidar", np.nan
        built.transforms.insert(0, lidar)

    flight = open_flight(rewrite(tiny_bag, tmp_path / "bag", edited("/tf_static", with_lidar)), "uav1")
    assert flight.rig.baseline_m == open_flight(tiny_bag, "uav1").rig.baseline_m
    (warning,) = [text for text in flight.warnings if "lidar" in text]
    assert warning.startswith("/tf_static, uav1/base_link to lidar: ")


def test_transforms_that_change_are_all_read_and_told(tiny_bag: Path, tmp_path: Path) -> None:
    ((edges, _),) = (transforms_of(decode(raw)) for raw in iter_raw([tiny_bag]) if raw.topic == "/tf_static")
    longer = [(parent, child, Pose(T.R, 1.3 * T.t)) for parent, child, T in edges]
    with RawRecorder(tmp_path / "bag") as recorder:
        for raw in iter_raw([tiny_bag]):
            if raw.topic == "/tf_static":
                wrong = encode(transforms_message(raw.stamp_ns, longer))
                recorder.write(raw.topic, raw.msgtype, wrong, raw.stamp_ns, latched=True)
            recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns, latched=raw.topic == "/tf_static")
    flight, right = open_flight(tmp_path / "bag", "uav1"), open_flight(tiny_bag, "uav1")
    assert flight.rig.baseline_m == right.rig.baseline_m
    assert any("uav1/right_optical" in text and "the last one counts" in text for text in flight.warnings)
    assert right.warnings == ()


@pytest.mark.parametrize("apart_m", [0.0, 0.01])
def test_a_frame_below_two_parents_is_told_only_if_they_place_it_differently(
    apart_m: float, tiny_bag: Path, tmp_path: Path
) -> None:
    """RealSense's driver has that of the left camera below two frames that coincide."""
    step = Pose(so3_exp([0.1, 0.2, 0.3]), np.array([0.0, 0.0, apart_m]))

    def twice(raw: RawMessage) -> RawMessage:
        if raw.topic != "/tf_static":
            return raw
        edges = transforms_of(decode(raw))[0]
        (place,) = [T for _, child, T in edges if child == "uav1/left_optical"]
        turned = Pose(step.R, np.zeros(3))
        below = [("uav1/base_link", "aligned", place @ step), ("aligned", "uav1/left_optical", turned.inverse())]
        return dataclasses.replace(raw, data=encode(transforms_message(raw.stamp_ns, [*edges, *below])))

    flight = open_flight(rewrite(tiny_bag, tmp_path / "bag", twice), "uav1")
    assert any("uav1/left_optical differently" in text for text in flight.warnings) == (apart_m > 0)


def test_bags_of_two_flights_are_told_and_parts_of_one_are_not(tiny_bag: Path, tmp_path: Path) -> None:
    middle_ns = sorted(raw.stamp_ns for raw in iter_raw([tiny_bag]))[100]
    again = rewrite(tiny_bag, tmp_path / "again", lambda raw: raw)
    early = rewrite(tiny_bag, tmp_path / "early", lambda raw: raw if raw.stamp_ns < middle_ns else None)
    late = rewrite(tiny_bag, tmp_path / "late", lambda raw: raw if raw.stamp_ns >= middle_ns else None)
    (warning,) = open_flight([tiny_bag, again], "uav1").warnings
    assert warning.startswith(f"{tiny_bag} and {again} both hold /uav1/imu/data_raw during the same ")
    assert open_flight([early, late], "uav1").warnings == ()


@pytest.mark.parametrize(("topic", "refused"), [("/uav1/initial_state", True), (TRUTH, False)])
def test_a_state_of_a_frame_that_is_not_the_body_is_told(
    tiny_bag: Path, tmp_path: Path, topic: str, refused: bool
) -> None:
    def move(built: Any, _: int) -> None:
        built.child_frame_id = "uav1/left_optical"

    bag = rewrite(tiny_bag, tmp_path / "bag", edited(topic, move))
    text = f"{topic} is of uav1/left_optical, which /tf_static places elsewhere than the body, uav1/base_link"
    if refused:
        with pytest.raises(CalibrationError, match=text):
            open_flight(bag, "uav1")
    else:
        assert any(text in warning for warning in open_flight(bag, "uav1").warnings)


def test_cameras_of_different_size_are_refused(tiny_bag: Path, tmp_path: Path) -> None:
    def change(raw: RawMessage) -> RawMessage:
        if raw.topic != "/uav1/right/camera_info":
            return raw
        camera = dataclasses.replace(open_flight(tiny_bag, "uav1").rig.right, width=80, height=60)
        return dataclasses.replace(raw, data=encode(camera_info_message(raw.stamp_ns, "uav1/right_optical", camera)))

    with pytest.raises(CalibrationError, match="160x120 px but right ones 80x60"):
        open_flight(rewrite(tiny_bag, tmp_path / "bag", change), "uav1")


def test_images_of_another_size_than_calibrated_are_refused(tiny_bag: Path, tmp_path: Path) -> None:
    def change(raw: RawMessage) -> RawMessage:
        if raw.topic != "/uav1/right/image_raw":
            return raw
        built = image_message(stamp_ns_of(decode(raw)), "uav1/right_optical", np.zeros((60, 80), np.uint8))
        return dataclasses.replace(raw, data=encode(built))

    flight = open_flight(rewrite(tiny_bag, tmp_path / "bag", change), "uav1")
    with pytest.raises(CalibrationError, match="right/image_raw are 80x60 px but the calibration says 160x120"):
        flight.check_images()


@pytest.mark.parametrize(("failed", "opens"), [(2, True), (6, False)])
def test_failed_first_exposures_are_no_reason_to_refuse_a_recording(
    failed: int, opens: bool, tiny_bag: Path, tmp_path: Path
) -> None:
    images = list(iter_raw([tiny_bag], ["/uav1/right/image_raw"]))

    def change(raw: RawMessage) -> RawMessage:
        if raw not in images[:failed]:
            return raw
        return dataclasses.replace(raw, data=encode(dataclasses.replace(decode(raw), width=0, height=0)))

    flight = open_flight(rewrite(tiny_bag, tmp_path / "bag", change), "uav1")
    if opens:
        flight.check_images()
        assert track_vehicle(flight, VehicleConfig()).dropped == {"image": failed}
    else:
        with pytest.raises(BagError, match="right/image_raw: image of 0x0 px is empty"):
            flight.check_images()


def test_late_recorded_messages_are_put_in_order(tiny_bag: Path, tmp_path: Path) -> None:
    def change(raw: RawMessage) -> RawMessage:
        late_ns = 80_000_000 if "image_raw" in raw.topic else 0
        return dataclasses.replace(raw, stamp_ns=raw.stamp_ns + late_ns)

    late = list(open_flight(rewrite(tiny_bag, tmp_path / "bag", change), "uav1").iter_events())
    on_time = list(open_flight(tiny_bag, "uav1").iter_events())
    assert [(e.stamp_ns, type(e)) for e in late] == [(e.stamp_ns, type(e)) for e in on_time]


def test_a_lost_image_costs_only_its_pair(tiny_bag: Path, tmp_path: Path) -> None:
    images = list(iter_raw([tiny_bag], ["/uav1/right/image_raw"]))
    bag = rewrite(tiny_bag, tmp_path / "bag", lambda raw: None if raw == images[2] else raw)
    stamps = [e.stamp_ns for e in open_flight(bag, "uav1").iter_events() if isinstance(e, StereoFrame)]
    assert stamps == [raw.stamp_ns for raw in images if raw != images[2]]


def test_an_undecodable_image_becomes_an_empty_one(tiny_bag: Path, tmp_path: Path) -> None:
    images = list(iter_raw([tiny_bag], ["/uav1/right/image_raw"]))

    def change(raw: RawMessage) -> RawMessage:
        if raw != images[2]:
            return raw
        message = decode(raw)
        message.encoding = "nv12"
        return dataclasses.replace(raw, data=encode(message))

    flight = open_flight(rewrite(tiny_bag, tmp_path / "bag", change), "uav1")
    pairs = [event for event in flight.iter_events() if isinstance(event, StereoFrame)]
    assert [pair.right.size > 0 for pair in pairs] == [raw != images[2] for raw in images]
    track = track_vehicle(flight, VehicleConfig())
    assert (track.frames_in, track.dropped) == (len(images), {"image": 1})


def test_messages_that_cannot_be_read_cost_only_themselves_and_are_counted(tiny_bag: Path, tmp_path: Path) -> None:
    spoilt = list(iter_raw([tiny_bag], ["/uav1/imu/data_raw"]))[3:5] + list(iter_raw([tiny_bag], [TRUTH]))[2:3]

    def change(raw: RawMessage) -> RawMessage:
        return dataclasses.replace(raw, data=raw.data[:40]) if raw in spoilt else raw

    flight = open_flight(rewrite(tiny_bag, tmp_path / "bag", change), "uav1")
    events: list[ImuSample | StereoFrame] = []
    with pytest.raises(BagError, match="2 messages can't be read and were left out, the first: /uav1/imu/data_raw at"):
        events.extend(flight.iter_events())
    left_out = {raw.stamp_ns for raw in spoilt[:2]}
    whole = open_flight(tiny_bag, "uav1").iter_events()
    expected = [e.stamp_ns for e in whole if isinstance(e, StereoFrame) or e.stamp_ns not in left_out]
    assert [e.stamp_ns for e in events] == expected
    truth = flight.truth()
    assert truth is not None
    assert truth.left_out == 1


@pytest.mark.parametrize("topic", ["/uav1/imu/data_raw", "/uav1/left/image_raw", TRUTH])
def test_so_is_the_first_one_of_a_topic(topic: str, tiny_bag: Path, tmp_path: Path) -> None:
    first = next(iter_raw([tiny_bag], [topic]))
    short = dataclasses.replace(first, data=b"\0\1")
    bag = rewrite(tiny_bag, tmp_path / "bag", lambda raw: short if raw == first else raw)
    whole, flight = (open_flight(path, "uav1") for path in (tiny_bag, bag))
    assert flight.pair_tolerance_ns(8) == whole.pair_tolerance_ns(8)
    expected, events = list(whole.iter_events()), UpToDamage(flight.iter_events())
    assert len(list(events)) == len(expected) - (topic != TRUTH)
    assert (events.error is None) == (topic == TRUTH)


def test_a_truncated_bag_opens_and_replays_up_to_the_damage(tiny_bag: Path, tmp_path: Path) -> None:
    data = (tiny_bag / "tiny.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) - 2000])
    flight = open_flight(cut, "uav1")
    events: list[ImuSample | StereoFrame] = []
    with pytest.raises(BagError, match="damaged"):
        events.extend(flight.iter_events())
    whole = list(open_flight(tiny_bag, "uav1").iter_events())
    assert [e.stamp_ns for e in events] == [e.stamp_ns for e in whole[: len(events)]]
    assert len(events) > 0.5 * len(whole)


def test_late_events_are_sorted_and_a_clock_that_was_set_back_keeps_the_recorded_order() -> None:
    stamps_ms = [0, 200, 100, 400, 300, 10_000, 10_200, 10_100, 500, 700, 600]
    events = [ImuSample(stamp_ms * 1_000_000, np.zeros(3), np.zeros(3)) for stamp_ms in stamps_ms]
    ordered = [event.stamp_ns // 1_000_000 for event in in_stamp_order(iter(events))]
    assert ordered == [0, 100, 200, 300, 400, 10_000, 10_100, 10_200, 500, 600, 700]
