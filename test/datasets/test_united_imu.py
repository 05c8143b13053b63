# SPDX-License-Identifier: Apache-2.0
"""Recordings whose gyroscope and accelerometer have topics of their own are read as of one IMU."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from split_bag import ACCEL, GYRO, forces_at, split

from uav_vslam.cli.main import main
from uav_vslam.config import InputConfig, VehicleConfig
from uav_vslam.config.input import TopicsConfig
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.cdr import RawMessage, decode
from uav_vslam.datasets.messages import imu_of
from uav_vslam.datasets.rosbag import iter_raw
from uav_vslam.datasets.survey import survey_flight
from uav_vslam.datasets.united_imu import united
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.inspection.recording import inspect_bags
from uav_vslam.inspection.topics import check_frames
from uav_vslam.ros.recording import Recording
from uav_vslam.studies.recordings.foreign import IMU_FRAME, edited, rewritten, with_imu_edge
from uav_vslam.studies.recordings.ros1 import write_ros1
from uav_vslam.types import ImuSample

ROOT = Path(__file__).parents[2]
APART = InputConfig(topics=TopicsConfig(imu=GYRO, accel=ACCEL))


def readings(bag: Path, config: InputConfig | None = None) -> list[ImuSample]:
    return [event for event in open_flight(bag, "uav1", config).iter_events() if isinstance(event, ImuSample)]


def test_each_angular_rate_has_the_specific_force_between_its_neighbours(tiny_bag: Path, tmp_path: Path) -> None:
    bag = split(tiny_bag, tmp_path / "bag")
    before, found = readings(tiny_bag), readings(bag, APART)
    inner = [one for one in before if found[0].stamp_ns <= one.stamp_ns <= found[-1].stamp_ns]
    assert len(before) - len(inner) <= 3  # at both ends there is none on one side
    assert [one.stamp_ns for one in found] == [one.stamp_ns for one in inner]
    np.testing.assert_array_equal([one.gyro for one in found], [one.gyro for one in inner])
    expected = forces_at(np.array([one.stamp_ns for one in found]), bag)
    np.testing.assert_allclose([one.accel for one in found], expected, rtol=0, atol=1e-12)


def test_a_ros_1_bag_has_the_same_readings(tiny_bag: Path, tmp_path: Path) -> None:
    bag = split(tiny_bag, tmp_path / "bag")
    old = write_ros1(bag, tmp_path / "flight.bag")
    np.testing.assert_array_equal(
        [one.accel for one in readings(old, APART)], [one.accel for one in readings(bag, APART)]
    )


def test_the_replay_publishes_the_readings_that_the_offline_reader_has(tiny_bag: Path, tmp_path: Path) -> None:
    bag = split(tiny_bag, tmp_path / "bag")
    recording = Recording([bag], ["uav1"], inputs={"uav1": APART})
    assert GYRO in recording.topics
    assert ACCEL not in recording.topics
    sent = [
        imu_of(decode(RawMessage(one.topic, "sensor_msgs/msg/Imu", 0, one.payload)))
        for one in recording.messages()
        if one.topic == GYRO
    ]
    own = readings(bag, APART)
    assert [one.stamp_ns for one in sent] == [one.stamp_ns for one in own]
    np.testing.assert_array_equal([one.accel for one in sent], [one.accel for one in own])


def test_the_survey_judges_the_united_readings(tiny_bag: Path, tmp_path: Path) -> None:
    bag = split(tiny_bag, tmp_path / "bag")
    survey = survey_flight([bag], "uav1", APART, on_message=lambda: None)
    own = readings(bag, APART)
    np.testing.assert_array_equal(survey.imu.stamps_ns, [one.stamp_ns for one in own])
    np.testing.assert_array_equal(survey.imu.accel, [one.accel for one in own])
    assert survey.unmatched <= 2
    forces = [imu_of(decode(raw)).accel for raw in iter_raw([bag], [ACCEL])]
    np.testing.assert_array_equal(survey.forces.accel, forces)


def test_the_noise_of_the_accelerometer_is_that_of_its_own_readings(tmp_path: Path) -> None:
    """Half as many readings with the same scatter; those in between are smooth."""
    bag = split(ROOT / "bags" / "sample", tmp_path / "bag")
    levels = [
        inspect_bags((path,), "uav1", VehicleConfig(input=config))[1].noise["accelerometer"].recommended
        for path, config in ((ROOT / "bags" / "sample", InputConfig()), (bag, APART))
    ]
    assert levels[1] == pytest.approx(np.sqrt(2.0) * levels[0], rel=0.1)


def test_a_cut_has_one_topic_for_both(tiny_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = split(tiny_bag, tmp_path / "bag")
    topics = f"{{imu: {GYRO}, accel: {ACCEL}}}"
    (tmp_path / "apart.yaml").write_text(f"/**: {{ros__parameters: {{input: {{topics: {topics}}}}}}}\n")
    legs = ["--legs", "0-0.3,0.3-0.6"]
    code = main(["cut", str(bag), str(tmp_path / "cut"), "--config", str(tmp_path / "apart.yaml"), *legs])
    assert code == 0, capsys.readouterr().err
    first = readings(tmp_path / "cut")
    original = {tuple(one.accel) for one in readings(bag, APART)}
    assert len(first) > 50
    assert {tuple(one.accel) for one in first} <= original


def test_a_message_that_can_not_be_read_is_reported(tiny_bag: Path, tmp_path: Path) -> None:
    bag = split(tiny_bag, tmp_path / "bag")
    messages = list(iter_raw([bag], [ACCEL, GYRO]))
    broken = next(k for k, raw in enumerate(messages) if raw.topic == ACCEL and k > 10)
    messages[broken] = dataclasses.replace(messages[broken], data=b"\0\1\0\0")
    found = list(united(messages, {ACCEL: GYRO}))
    (kept,) = (raw for raw in found if len(raw.data) == 4)
    assert kept.topic == GYRO  # where whoever reads them counts it


def in_frame(frame: str) -> Callable[[Any], Any]:
    def edit(message: Any) -> Any:
        message.header.frame_id = frame
        return message

    return edit


def test_an_accelerometer_with_other_axes_is_refused(tiny_bag: Path, tmp_path: Path) -> None:
    edge = edited("/tf_static", with_imu_edge)
    bag = rewritten(split(tiny_bag, tmp_path / "bag"), tmp_path / "turned", edge, edited(ACCEL, in_frame(IMU_FRAME)))
    with pytest.raises(CalibrationError, match=f"{IMU_FRAME} is turned by 180.0 deg against uav1/base_link"):
        open_flight(bag, "uav1", APART)
    survey = survey_flight([bag], "uav1", APART, on_message=lambda: None)
    assert "accelerometer frame" in [found.subject for found in check_frames(survey)]


def test_an_accelerometer_that_was_not_recorded_is_refused(tiny_bag: Path, tmp_path: Path) -> None:
    elsewhere = InputConfig(topics=TopicsConfig(imu=GYRO, accel="/imu/accel"))
    bag = split(tiny_bag, tmp_path / "bag")
    with pytest.raises(BagError, match="/imu/accel"):
        open_flight(bag, "uav1", elsewhere)
    with pytest.raises(BagError, match=r"no /imu/accel for vehicle uav1; correct input\.topics\.accel"):
        Recording([bag], ["uav1"], inputs={"uav1": elsewhere})
