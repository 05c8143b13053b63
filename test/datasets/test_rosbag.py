# SPDX-License-Identifier: Apache-2.0
"""Bags are read in stamp order, up to the damage if they are damaged, and what is no bag is refused."""

import contextlib
import shutil
import sqlite3
from pathlib import Path

import pytest
import yaml

from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import RawMessage
from uav_vslam.datasets.rosbag import iter_raw, iter_readable, topics_of
from uav_vslam.errors import BagError


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


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "truncated"])
def test_names_without_a_slash_are_of_no_namespace(storage: str, tiny_bag: Path, tmp_path: Path) -> None:
    bag, expected = tmp_path / "bag", list(iter_raw([tiny_bag]))
    with RawRecorder(bag, storage="sqlite3" if storage == "sqlite3" else "mcap") as recorder:
        for raw in expected:
            recorder.write(raw.topic.removeprefix("/"), raw.msgtype, raw.data, raw.stamp_ns)
    if storage == "truncated":
        (bag / "bag.mcap").write_bytes((bag / "bag.mcap").read_bytes()[:-1])
    assert topics_of([bag]).keys() == topics_of([tiny_bag]).keys()
    imu = [raw.data for raw in iter_readable([bag], ["/uav1/imu/data_raw"])]
    assert imu == [raw.data for raw in expected if raw.topic == "/uav1/imu/data_raw"]


def test_metadata_with_another_qos_than_the_files_lose_no_message(tiny_bag: Path, tmp_path: Path) -> None:
    bag = shutil.copytree(tiny_bag, tmp_path / "bag")
    for half, name in enumerate(("first", "second")):  # a split recording, joined by hand
        with RawRecorder(tmp_path / name) as recorder:
            for number, raw in enumerate(iter_raw([tiny_bag])):
                if (number > 100) == half:
                    recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)  # none latched
        (tmp_path / name / f"{name}.mcap").rename(bag / f"{name}.mcap")
    tree = yaml.safe_load((bag / "metadata.yaml").read_text())
    information = tree["rosbag2_bagfile_information"]
    information["relative_file_paths"] = ["first.mcap", "second.mcap"]
    for topic in information["topics_with_message_count"]:
        topic["topic_metadata"]["offered_qos_profiles"][0]["reliability"] = "best_effort"
    (bag / "metadata.yaml").write_text(yaml.safe_dump(tree))
    (bag / "tiny.mcap").unlink()
    assert list(iter_raw([bag])) == list(iter_raw([tiny_bag]))
    counts = {topic: info.count for topic, info in topics_of([tiny_bag]).items()}
    assert {topic: info.count for topic, info in topics_of([bag]).items()} == counts


def test_a_missing_file_of_a_split_recording_is_named_with_what_reads_the_others(
    tiny_bag: Path, tmp_path: Path
) -> None:
    bag = shutil.copytree(tiny_bag, tmp_path / "bag")
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(text.replace("- tiny.mcap", "- tiny.mcap\n  - tiny_1.mcap"))
    with pytest.raises(BagError, match=r"missing: .*tiny_1\.mcap.*metadata\.yaml or remove it"):
        topics_of([bag])
    (bag / "metadata.yaml").unlink()
    assert topics_of([bag]) == topics_of([tiny_bag])


def test_a_folder_of_bags_is_refused_with_their_names(tiny_bag: Path) -> None:
    with pytest.raises(BagError, match=rf"given together: .*{tiny_bag}"):
        topics_of([tiny_bag.parent])


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_sqlite_bag_whose_recorder_was_killed_is_told_how_to_complete(
    share: float, tiny_bag: Path, tmp_path: Path
) -> None:
    """`ros2 bag record --storage-preset-profile resilient` writes ahead into a log."""
    messages = list(iter_raw([tiny_bag]))
    with RawRecorder(tmp_path / "whole", storage="sqlite3") as recorder:
        for raw in messages:
            recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
    (tmp_path / "killed").mkdir()
    file = tmp_path / "killed" / "killed.db3"
    with contextlib.closing(sqlite3.connect(tmp_path / "live.db3")) as live:
        live.execute("PRAGMA journal_mode = WAL")
        live.execute("PRAGMA wal_autocheckpoint = 0")
        live.execute("ATTACH ? AS whole", (str(tmp_path / "whole" / "whole.db3"),))
        for name, definition in live.execute(
            "SELECT name, sql FROM whole.sqlite_master WHERE type = 'table'"
        ).fetchall():
            live.execute(definition)
            if name != "messages":
                live.execute(f"INSERT INTO main.{name} SELECT * FROM whole.{name}")
        half = int(share * len(messages))
        live.execute("INSERT INTO main.messages SELECT * FROM whole.messages ORDER BY timestamp, id LIMIT ?", (half,))
        live.commit()
        if half:
            live.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        live.execute("INSERT INTO main.messages SELECT * FROM whole.messages WHERE id NOT IN (SELECT id FROM messages)")
        live.commit()
        for end in ("", "-wal"):  # as the killed recorder leaves them
            shutil.copy(tmp_path / f"live.db3{end}", f"{file}{end}")
    read: list[RawMessage] = []
    with pytest.raises(BagError, match=rf"messages are in .*killed\.db3-wal.*sqlite3 {file} 'PRAGMA wal_checkpoint"):
        read.extend(iter_raw([file.parent]))
    assert len(read) == half
    with contextlib.closing(sqlite3.connect(file)) as completed:
        completed.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    assert sorted(raw.data for raw in iter_raw([file.parent])) == sorted(raw.data for raw in messages)


def test_an_unfinished_bag_of_ros_1_is_told_how_to_repair(tmp_path: Path) -> None:
    (tmp_path / "flight.bag.active").write_bytes(b"#ROSBAG V2.0\n")
    for path in (tmp_path, tmp_path / "flight.bag.active"):
        with pytest.raises(
            BagError, match=r"flight\.bag\.active was not completed: `rosbag reindex`.* call it flight\.bag"
        ):
            topics_of([path])


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


def test_the_damage_of_one_file_costs_no_other(tiny_bag: Path, tmp_path: Path) -> None:
    messages = list(iter_raw([tiny_bag]))
    half = len(messages) // 2
    for name, part in (("a", messages[:half]), ("b", messages[half:])):
        with RawRecorder(tmp_path / name) as recorder:
            for raw in part:
                recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
    first = tmp_path / "a" / "a.mcap"
    first.write_bytes(first.read_bytes()[: first.stat().st_size // 2])
    read: list[RawMessage] = []
    with pytest.raises(BagError, match=f"bag {first} is damaged: read up to the damage"):
        read.extend(iter_raw([tmp_path / "a", tmp_path / "b"]))
    assert len(read) > half
    assert [raw.data for raw in read[-half // 2 :]] == [raw.data for raw in messages[-half // 2 :]]


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
