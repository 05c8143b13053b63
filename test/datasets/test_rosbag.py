# SPDX-License-Identifier: Apache-2.0
"""Raw recording and replay keep every byte, and report what is wrong with a bag."""

import dataclasses
from pathlib import Path

import pytest
import yaml

from uav_vslam.datasets.rosbag import RawMessage, RawRecorder, decode, encode, iter_raw, message, topics_of, typestore
from uav_vslam.errors import BagError
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import Scenario

OWN_MESSAGES = sorted((Path(__file__).resolve().parents[2] / "uav_vslam_msgs" / "msg").glob("*.msg"))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_raw_bytes_survive_a_copy(tiny_bag: Path, tmp_path: Path, storage: str) -> None:
    original = list(iter_raw([tiny_bag]))
    latched = {topic for topic, info in topics_of([tiny_bag]).items() if info.latched}
    with RawRecorder(tmp_path / "copy", storage=storage) as recorder:
        for raw in original:
            recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns, latched=raw.topic in latched)
    copied = list(iter_raw([tmp_path / "copy"]))
    key = lambda raw: (raw.stamp_ns, raw.topic, raw.data)  # noqa: E731
    assert sorted(copied, key=key) == sorted(original, key=key)
    assert topics_of([tmp_path / "copy"]) == topics_of([tiny_bag])


def test_compressed_chunks_hold_the_same_messages(tiny: Scenario, tiny_bag: Path, tmp_path: Path) -> None:
    record(tiny, tmp_path / "tiny", zstd=True)
    assert list(iter_raw([tmp_path / "tiny"])) == list(iter_raw([tiny_bag]))
    assert (tmp_path / "tiny" / "tiny.mcap").stat().st_size < 0.8 * (tiny_bag / "tiny.mcap").stat().st_size


def test_topics_filter_and_stamps_rise(tiny_bag: Path) -> None:
    stamps = [raw.stamp_ns for raw in iter_raw([tiny_bag])]
    assert stamps == sorted(stamps)
    assert {raw.topic for raw in iter_raw([tiny_bag], ["/uav1/imu/data_raw"])} == {"/uav1/imu/data_raw"}
    assert list(iter_raw([tiny_bag], ["/nothing"])) == []


def test_several_bags_are_merged_by_stamp(tiny_bag: Path, tmp_path: Path) -> None:
    parts = {"/uav1": tmp_path / "one", "/uav2": tmp_path / "two"}
    for prefix, path in parts.items():
        with RawRecorder(path) as recorder:
            for raw in iter_raw([tiny_bag]):
                if raw.topic.startswith(prefix):
                    recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
    merged = list(iter_raw(list(parts.values())))
    assert [raw.stamp_ns for raw in merged] == sorted(raw.stamp_ns for raw in merged)
    assert len(merged) == sum(1 for raw in iter_raw([tiny_bag]) if raw.topic.startswith("/uav"))
    assert topics_of(list(parts.values())).keys() == topics_of([tiny_bag]).keys() - {"/tf_static"}


def test_every_message_of_ours_has_a_known_type() -> None:
    assert OWN_MESSAGES
    for path in OWN_MESSAGES:
        assert f"uav_vslam_msgs/msg/{path.stem}" in typestore().types


def test_latched_topics_are_offered_as_transient_local(tiny_bag: Path) -> None:
    metadata = yaml.safe_load((tiny_bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    durability = {
        entry["topic_metadata"]["name"]: entry["topic_metadata"]["offered_qos_profiles"][0]["durability"]
        for entry in metadata["topics_with_message_count"]
    }
    latched = {topic for topic, value in durability.items() if value == "transient_local"}
    assert latched == {"/tf_static", "/uav1/initial_state", "/uav2/initial_state"}
    assert set(durability.values()) == {"transient_local", "volatile"}
    assert {topic for topic, info in topics_of([tiny_bag]).items() if info.latched} == latched


def read_to_the_damage(path: Path) -> tuple[list[RawMessage], str]:
    read: list[RawMessage] = []
    try:
        read.extend(iter_raw([path]))  # extend keeps what came before the error
    except BagError as error:
        return read, str(error)
    raise AssertionError("the damage was not reported")


@pytest.mark.parametrize("share", [0.3, 0.8, 0.999])
def test_a_truncated_recording_is_read_up_to_the_damage(tiny_bag: Path, tmp_path: Path, share: float) -> None:
    whole = (tiny_bag / "tiny.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: int(share * len(whole))])
    read, error = read_to_the_damage(tmp_path)
    original = list(iter_raw([tiny_bag]))
    assert read == original[: len(read)]
    assert len(read) > 0.8 * share * len(original)
    assert f"is damaged: read up to the damage after stamp {read[-1].stamp_ns} ns" in error
    assert "\n" not in error
    assert topics_of([tmp_path])["/uav1/imu/data_raw"].msgtype == "sensor_msgs/msg/Imu"


def test_a_truncated_file_beside_its_metadata_is_detected(tiny_bag: Path, tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_bytes((tiny_bag / "metadata.yaml").read_bytes())
    data = (tiny_bag / "tiny.mcap").read_bytes()
    (tmp_path / "tiny.mcap").write_bytes(data[: len(data) // 2])
    with pytest.raises(BagError, match="damaged"):
        list(iter_raw([tmp_path]))


def test_a_truncated_sqlite_bag_is_named(tiny_bag: Path, tmp_path: Path) -> None:
    with RawRecorder(tmp_path / "whole", storage="sqlite3") as recorder:
        for raw in iter_raw([tiny_bag]):
            recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
    file = tmp_path / "whole" / "whole.db3"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(BagError, match=r"whole.* is damaged"):
        list(iter_raw([tmp_path / "whole"]))


def test_a_path_that_is_not_a_bag_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "note.txt").write_text("hello")
    (tmp_path / "fake.mcap").write_text("hello")
    (tmp_path / "fake.db3").write_text("hello")
    for name, text in {
        "nowhere": "does not exist",
        "empty": "not a bag",
        "note.txt": "not a bag",
        "fake.mcap": "damaged",
        "fake.db3": "damaged",
    }.items():
        with pytest.raises(BagError, match=text) as refused:
            list(iter_raw([tmp_path / name]))
        assert "\n" not in str(refused.value)
        assert name in str(refused.value)


def test_a_recording_overwrites_nothing(tiny_bag: Path) -> None:
    with pytest.raises(BagError, match="exists"):
        RawRecorder(tiny_bag)


def test_a_failed_recording_leaves_no_bag(tiny_bag: Path, tmp_path: Path) -> None:
    first = next(iter_raw([tiny_bag]))

    def record() -> None:
        with RawRecorder(tmp_path / "half") as recorder:
            for msgtype in (first.msgtype, "another/msg/Type"):
                recorder.write(first.topic, msgtype, first.data, first.stamp_ns)

    with pytest.raises(BagError):
        record()
    assert not (tmp_path / "half").exists()


def test_an_unknown_type_or_a_second_type_is_refused(tmp_path: Path) -> None:
    data = encode(message("std_msgs/msg/String", data="x"))
    with RawRecorder(tmp_path / "bag") as recorder:
        recorder.write("/a", "std_msgs/msg/String", data, 1)
        with pytest.raises(BagError, match=r"odd_msgs/msg/Odd is not known"):
            recorder.write("/b", "odd_msgs/msg/Odd", b"", 2)
        with pytest.raises(BagError, match="can't also hold"):
            recorder.write("/a", "std_msgs/msg/Header", b"", 3)


def test_bytes_that_do_not_fit_their_type_are_refused(tiny_bag: Path) -> None:
    raw = next(iter_raw([tiny_bag], ["/uav1/imu/data_raw"]))
    with pytest.raises(BagError, match="not a valid sensor_msgs/msg/Imu"):
        decode(dataclasses.replace(raw, data=raw.data[:20]))
