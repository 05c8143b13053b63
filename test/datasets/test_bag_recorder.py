# SPDX-License-Identifier: Apache-2.0
"""A recorder keeps every byte, overwrites nothing and leaves no half bag."""

from pathlib import Path

import pytest
import yaml

from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import encode, message
from uav_vslam.datasets.rosbag import iter_raw, topics_of
from uav_vslam.errors import BagError
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import Scenario


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


@pytest.mark.parametrize("name", ["a#b", "a?b", "a%20b"])
def test_a_name_that_sqlite_would_change_is_refused(name: str, tiny_bag: Path, tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"SQLite takes .* for no part of a name; choose a path without, or use mcap"):
        RawRecorder(tmp_path / name, storage="sqlite3")
    assert list(tmp_path.iterdir()) == []
    for storage in ("sqlite3", "mcap"):
        with RawRecorder(tmp_path / f"100 %{storage}", storage=storage) as recorder:
            for raw in iter_raw([tiny_bag], ["/tf_static"]):
                recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
        moved = (tmp_path / f"100 %{storage}").rename(tmp_path / f"{storage}{name}")
        if storage == "sqlite3":
            with pytest.raises(BagError, match="SQLite takes"):
                topics_of([moved])
        else:
            assert list(topics_of([moved])) == ["/tf_static"]
