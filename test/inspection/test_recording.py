# SPDX-License-Identifier: Apache-2.0
"""Every fault planted into a recording is named, in one go, and nothing is found where nothing is wrong."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faulty import FAULTS, IMU, INFOS, LEFT, RIGHT, START, TOGETHER, TRUTH, Expected, later, missing
from ros1_frames import repeated_on_tf

from uav_vslam.calibration.files import write_calibration
from uav_vslam.cli.main import main
from uav_vslam.config import VehicleConfig, load_vehicle
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.cdr import RawMessage
from uav_vslam.datasets.message_builders import transforms_message
from uav_vslam.errors import BagError, CalibrationError
from uav_vslam.geometry.pose import Pose
from uav_vslam.inspection.finding import Finding, Severity
from uav_vslam.inspection.recording import Inspection, inspect_bags
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.studies.recordings.foreign import edited, kalibr_of, renamed, rewritten, turned, with_imu_edge, without

pytestmark = pytest.mark.slow

# Faults of which `check` says that the graph can run, and those that leave it nothing to run on.
RUNS = ["gap in the IMU", "gap in the images", "truth of another time", "IMU ends before the images"]
RUNS += ["a few IMU readings of NaN", "first image empty"]
REFUSED = ["no right images", "no camera_info", "no extrinsics", "images cropped", "baseline of zero"]
REFUSED += ["IMU frame that nothing connects", "camera_info of another size"]
MANY_BELOW_M = 71.0  # some two thirds of the points are nearer


def inspected(bag: Path, config: VehicleConfig | None = None) -> Inspection:
    return inspect_bags((bag,), "uav1", config or VehicleConfig())[1]


def faults(found: Iterable[Finding]) -> list[Finding]:
    return [finding for finding in found if finding.severity is not Severity.OK]


def assert_named(found: Inspection, expected: Iterable[Expected]) -> None:
    for severity, subject, words in expected:
        named = [f"{f.seen} {f.allowed} {f.remedy}" for f in faults(found.findings) if f.subject == subject]
        kinds = {f.severity.value for f in found.findings if f.subject == subject}
        assert severity in kinds, f"{subject!r} is not among {[f.subject for f in faults(found.findings)]}"
        for word in words:
            assert word in " ".join(named)


def test_a_clean_recording_has_no_fault(clean: Path) -> None:
    found = inspected(clean)
    assert faults(found.findings) == []
    assert found.block == ""


def test_two_flights_given_as_one_are_named(clean: Path, tmp_path: Path) -> None:
    another = rewritten(clean, tmp_path / "another")
    found = inspect_bags((clean, another), "uav1", VehicleConfig())[1]
    assert_named(found, [("warning", "recordings", ["both hold /uav1/imu/data_raw during the same"])])


def test_depths_of_which_many_would_not_be_used_are_named(clean: Path) -> None:
    found = inspected(clean, load_vehicle(None, overrides={"frontend.max_depth_m": MANY_BELOW_M}))
    (depth,) = (one for one in faults(found.findings) if one.subject == "depth")
    inside = int(depth.seen.rsplit("; ", 1)[1].split(" %")[0])
    assert 50 <= inside < 90
    assert "other points are not used" in depth.remedy


@pytest.mark.parametrize("seed", [1, 2, 4, 5])
def test_neither_have_other_flights(seed: int, tmp_path: Path) -> None:
    scenario = dataclasses.replace(SCENARIOS["kagaru"], vehicles=1, frames=24, scale=0.15, seed=seed)
    record(scenario, tmp_path / "flight")
    assert faults(inspected(tmp_path / "flight").findings) == []


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_named_and_decides_whether_the_graph_can_run(
    fault: str, clean: Path, tmp_path: Path
) -> None:
    changes, expected = FAULTS[fault]
    found = inspected(rewritten(clean, tmp_path / "bag", *changes()))
    assert_named(found, expected)
    if all(severity == "warning" for severity, _, _ in expected) and fault != "saturated accelerometer":
        assert found.usable
    if any(severity == "error" for severity, _, _ in expected):
        assert not found.usable


@pytest.mark.parametrize(
    ("fault", "subject"),
    [("a few IMU readings of NaN", "IMU readings"), ("a few IMU readings that are no motion", "IMU outliers")],
)
def test_readings_that_are_left_out_are_no_other_fault(fault: str, subject: str, clean: Path, tmp_path: Path) -> None:
    found = inspected(rewritten(clean, tmp_path / "bag", *FAULTS[fault][0]()))
    assert [fault.subject for fault in faults(found.findings)] == [subject]


@pytest.mark.parametrize(
    ("fault", "subject"), [("a gyroscope alone", "accelerometer"), ("an accelerometer alone", "gyroscope")]
)
def test_a_sensor_that_is_missing_is_no_other_fault(fault: str, subject: str, clean: Path, tmp_path: Path) -> None:
    """That gravity was removed, or that clocks and extrinsics are wrong, sent to the wrong place."""
    found = inspected(rewritten(clean, tmp_path / "bag", *FAULTS[fault][0]()))
    assert [fault.subject for fault in faults(found.findings)] == [subject]


@pytest.mark.parametrize("unit", ["millimetres", "kilometres"])
def test_truth_in_another_unit_is_the_cause_and_judges_nothing(unit: str, clean: Path, tmp_path: Path) -> None:
    """Its accelerations in mm/s^2 said that the IMU's axes were not those of the body, which was an error."""
    found = inspected(rewritten(clean, tmp_path / "bag", *FAULTS[f"truth in {unit}"][0]()))
    assert {fault.subject for fault in faults(found.findings)} <= {"scale", "truth motion"}


def test_truth_that_never_turns_is_the_cause_and_judges_no_axes(clean: Path, tmp_path: Path) -> None:
    found = inspected(rewritten(clean, tmp_path / "bag", *FAULTS["truth without an attitude"][0]()))
    assert [fault.subject for fault in faults(found.findings)] == ["truth attitude"]


@pytest.mark.parametrize("fault", [*RUNS, *REFUSED])
def test_what_can_run_is_run_and_what_lacks_something_is_refused(
    fault: str, clean: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = rewritten(clean, tmp_path / "bag", *FAULTS[fault][0]())
    results = ["--results", str(tmp_path / "results"), "--no-plots", "--no-maps", "--no-smoothing"]
    assert main(["run", str(bag), *results]) == (2 if fault in REFUSED else 0)
    if fault in REFUSED:
        assert f"uav-vslam check {bag}" in capsys.readouterr().err


@pytest.mark.parametrize("case", TOGETHER)
def test_of_several_faults_each_is_named(case: str, clean: Path, tmp_path: Path) -> None:
    planted = [FAULTS[fault] for fault in TOGETHER[case]]
    found = inspected(rewritten(clean, tmp_path / "bag", *(one for changes, _ in planted for one in changes())))
    for _, expected in planted:
        severity, subject, words = expected[0]  # others may need what another fault spoils: swapped cameras see nothing
        assert_named(found, [(severity, subject, words[:1])])


def test_foreign_topics_are_judged_as_well_and_the_block_makes_the_recording_usable(
    clean: Path, tmp_path: Path
) -> None:
    bag = rewritten(clean, tmp_path / "bag", renamed)
    found = inspected(bag)
    (only,) = faults(found.findings)
    assert only.subject == "topic names"
    assert "left /camera/infra1/image_rect_raw" in only.seen
    assert any(finding.subject == "scale" for finding in found.findings)
    config = tmp_path / "mine.yaml"
    config.write_text(found.block)
    again = inspected(bag, load_vehicle(config))
    assert faults(again.findings) == []
    assert again.block == ""


def test_images_whose_sides_the_names_do_not_tell_are_listed(clean: Path, tmp_path: Path) -> None:
    names = {LEFT: "/port/image", RIGHT: "/starboard/image"}
    bag = rewritten(
        clean, tmp_path / "bag", lambda raw: dataclasses.replace(raw, topic=names.get(raw.topic, raw.topic))
    )
    only = "of its type only /port/image, /starboard/image"
    assert_named(inspected(bag), [("error", f"{side} topic", (only,)) for side in ("left", "right")])


def test_an_imu_of_another_name_beside_usual_images_is_judged_as_well(clean: Path, tmp_path: Path) -> None:
    """As a driver in the vehicle's namespace publishes it: unread, it said that the vehicle moves at the start."""

    def named(raw: RawMessage) -> RawMessage:
        return dataclasses.replace(raw, topic="/uav1/imu/data") if raw.topic == IMU else raw

    bag = rewritten(clean, tmp_path / "bag", named)
    found = inspected(bag)
    (only,) = faults(found.findings)
    assert (only.subject, "judged instead: imu /uav1/imu/data" in only.seen) == ("topic names", True)
    assert found.noise
    config = tmp_path / "mine.yaml"
    config.write_text(found.block)
    assert faults(inspected(bag, load_vehicle(config)).findings) == []
    blind = inspected(rewritten(bag, tmp_path / "blind", without("/uav1/imu/data", START)))
    (start,) = [fault for fault in faults(blind.findings) if fault.subject == "start state"]
    assert "static for a vehicle at rest, in_flight for one that flies" in start.remedy


def test_a_body_of_another_name_is_found_from_the_sensors_frames(clean: Path, tmp_path: Path) -> None:
    """Drivers of depth cameras name it camera_link."""

    def renamed_body(transforms: Any) -> Any:
        for stamped in transforms.transforms:
            stamped.header.frame_id = stamped.header.frame_id.replace("uav1/base_link", "camera_link")
        return transforms

    def with_lidar(transforms: Any) -> Any:
        extra = transforms_message(0, [("uav1/base_link", "lidar", Pose.identity())])
        return dataclasses.replace(transforms, transforms=[*transforms.transforms, *extra.transforms])

    changes = [edited("/tf_static", lambda sent: renamed_body(with_imu_edge(sent))), edited(IMU, turned)]
    bag = rewritten(clean, tmp_path / "bag", *changes)
    with pytest.raises(CalibrationError, match=r"; input\.frames\.base: camera_link is connected with all$"):
        open_flight(bag, "uav1")
    found = inspected(bag)
    (only,) = faults(found.findings)
    assert only.subject == "body frame"
    assert found.block_of == "uav1"  # other vehicles have another body
    assert any(finding.subject == "scale" for finding in found.findings)
    config = tmp_path / "mine.yaml"
    config.write_text(found.block)
    assert faults(inspected(bag, load_vehicle(config)).findings) == []
    there = edited("/tf_static", lambda sent: with_lidar(sent))
    apart = inspected(rewritten(bag, tmp_path / "apart", there))  # a body that only lacks the edge to these sensors
    assert {"camera frames", "IMU frame"} <= {finding.subject for finding in faults(apart.findings)}
    assert "base" not in apart.block


def test_cameras_whose_lens_alone_is_in_files_have_the_frames_of_their_images(clean: Path, tmp_path: Path) -> None:
    """Such files were said to be missing, although they were given."""
    write_calibration(open_flight(clean, "uav1").rig, tmp_path)
    files = {"input.calibration": [str(tmp_path / "left.yaml"), str(tmp_path / "right.yaml")]}
    bag = rewritten(clean, tmp_path / "bag", without(*INFOS))
    with pytest.raises(
        BagError, match=r"lacks /uav1/left/camera_info.*or input\.frames\.left, as the files have no place"
    ):
        open_flight(bag, "uav1", load_vehicle(None, overrides=files).input)
    found = inspected(bag, load_vehicle(None, overrides=files))
    (only,) = faults(found.findings)
    assert (only.subject, "judged with that of the images, uav1/left_optical" in only.seen) == ("camera frames", True)
    config = tmp_path / "mine.yaml"
    config.write_text(found.block)
    assert faults(inspected(bag, load_vehicle(config, overrides=files)).findings) == []


def test_a_place_that_is_missing_is_told_from_those_that_are_there(clean: Path, tmp_path: Path) -> None:
    """Of a body of another name all places were said to be missing."""

    def without_the_imu(transforms: Any) -> Any:
        for stamped in transforms.transforms:
            stamped.header.frame_id = "camera_link"
        return transforms

    bag = rewritten(clean, tmp_path / "bag", edited("/tf_static", without_the_imu), edited(IMU, turned))
    held = "/tf_static holds camera_link -> uav1/left_optical, camera_link -> uav1/right_optical"
    assert_named(inspected(bag), [("error", "camera frames", (held,)), ("error", "IMU frame", ("imu_link", held))])


def test_rectified_images_with_the_lens_of_raw_ones_are_named(clean: Path, tmp_path: Path) -> None:
    """By drivers that publish both with the camera_info of the raw ones."""

    def rectified(raw: RawMessage) -> RawMessage:
        return dataclasses.replace(raw, topic=raw.topic.replace("image_raw", "image_rect"))

    def bent(info: Any) -> Any:
        return dataclasses.replace(info, d=np.array([-0.1, 0.05, 0.0, 0.0, 0.0]))

    named = rewritten(clean, tmp_path / "named", rectified)
    topics = {f"input.topics.{side}": f"{side}/image_rect" for side in ("left", "right")}
    assert faults(inspected(named, load_vehicle(None, overrides=topics)).findings) == []
    bag = rewritten(named, tmp_path / "bag", *(edited(topic, bent) for topic in INFOS))
    (warning,) = open_flight(bag, "uav1", load_vehicle(None, overrides=topics).input).warnings
    assert "/uav1/left/image_rect is rectified by its name" in warning
    found = inspected(bag)
    assert "rectified images" in {finding.subject for finding in faults(found.findings)}
    config = tmp_path / "mine.yaml"
    config.write_text(found.block)
    assert faults(inspected(bag, load_vehicle(config)).findings) == []
    raw = rewritten(clean, tmp_path / "raw", *(edited(topic, bent) for topic in INFOS))
    rectified_too = load_vehicle(None, overrides={"input.rectified": True})
    assert "/uav1/left/image_raw is raw by its name" in " ".join(open_flight(raw, "uav1", rectified_too.input).warnings)
    assert "rectified images" in {finding.subject for finding in faults(inspected(raw, rectified_too).findings)}


def test_constant_frames_on_tf_are_no_fault_and_moving_ones_are(clean: Path, tmp_path: Path) -> None:
    found = inspected(repeated_on_tf(clean, tmp_path / "bag"))
    assert faults(found.findings) == []
    assert any("/tf alone places uav1/left_optical, uav1/right_optical" in finding.seen for finding in found.findings)
    found = inspected(repeated_on_tf(clean, tmp_path / "moving", moving="uav1/right_optical"))
    assert "camera frames" in {finding.subject for finding in faults(found.findings)}


def test_a_calibration_file_stands_for_camera_info_and_frames(clean: Path, tmp_path: Path) -> None:
    infos = ("/uav1/left/camera_info", "/uav1/right/camera_info")
    bag = rewritten(clean, tmp_path / "bag", without("/tf_static", *infos))
    files = [str(kalibr_of(clean, tmp_path))]
    assert faults(inspected(bag, load_vehicle(None, overrides={"input.calibration": files})).findings) == []
    broken = tmp_path / "broken.yaml"
    broken.write_text("cam0: {camera_model: omni}")
    found = inspected(bag, load_vehicle(None, overrides={"input.calibration": [str(broken)]}))
    assert {"calibration files", "left_info topic", "camera frames"} <= {f.subject for f in faults(found.findings)}


def test_the_clock_offset_to_set_counts_the_one_of_the_calibration_file(clean: Path, tmp_path: Path) -> None:
    bag = rewritten(clean, tmp_path / "bag", later(IMU, 60_000_000))
    files = [str(kalibr_of(clean, tmp_path, timeshift_s=-0.02))]
    found = inspected(bag, load_vehicle(None, overrides={"input.calibration": files}))
    assert_named(found, [("error", "gyroscope against the cameras", ("80 ms late", "timeshift_cam_imu: 0.06 "))])


def test_an_offset_of_the_clocks_that_is_set_is_no_fault(clean: Path, tmp_path: Path) -> None:
    bag = rewritten(clean, tmp_path / "bag", *(later(topic, 50_000_000_000) for topic in (IMU, START, TRUTH)))
    files = [str(kalibr_of(clean, tmp_path, timeshift_s=50.0))]
    assert faults(inspected(bag, load_vehicle(None, overrides={"input.calibration": files})).findings) == []


@pytest.mark.parametrize("topic", ["/tf_static", LEFT, RIGHT, *INFOS, IMU, START, TRUTH])
@pytest.mark.parametrize("left", [0, 2])
def test_whatever_is_missing_the_rest_is_judged(topic: str, left: int, clean: Path, tmp_path: Path) -> None:
    change = missing(topic, range(left, 1000)) if left else without(topic)
    subjects = {finding.subject for finding in inspected(rewritten(clean, tmp_path / "bag", change)).findings}
    assert ("start state" in subjects) or ("start time" in subjects)
    assert {"truth", "truth time"} & subjects
    assert (topic == IMU and left == 0) or any(subject.startswith("gyroscope") for subject in subjects)
    assert topic == LEFT or any(subject.startswith("left image") for subject in subjects)


def test_a_truncated_recording_is_judged_up_to_the_damage(clean: Path, tmp_path: Path) -> None:
    (source,) = clean.glob("*.mcap")
    data = source.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(0.6 * len(data))])
    found = inspected(tmp_path / "cut.mcap")
    assert "recording" in {finding.subject for finding in faults(found.findings)}
    assert found.usable
