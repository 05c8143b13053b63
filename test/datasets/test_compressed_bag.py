# SPDX-License-Identifier: Apache-2.0
"""Bags that were compressed as a whole are read like the bags themselves."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
import zstandard
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import typestore
from uav_vslam.datasets.compressed_bag import FOLDER
from uav_vslam.datasets.rosbag import is_bag, iter_raw, iter_readable, topics_of
from uav_vslam.errors import BagError


def compressed(bag: Path, out: Path) -> Path:
    """Compress the storage file of a bag as `ros2 bag record --compression-mode file` does."""
    shutil.copytree(bag, out)
    (file,) = [path for path in out.iterdir() if path.suffix in (".mcap", ".db3")]
    packed = file.with_name(file.name + ".zstd")
    packed.write_bytes(zstandard.compress(file.read_bytes()))
    file.unlink()
    metadata = out / "metadata.yaml"
    tree = yaml.safe_load(metadata.read_text())
    told = tree["rosbag2_bagfile_information"]
    told |= {"compression_format": "zstd", "compression_mode": "FILE", "relative_file_paths": [packed.name]}
    metadata.write_text(yaml.safe_dump(tree))
    return out


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_compressed_bag_has_the_messages_of_the_plain_one(storage: str, tiny_bag: Path, tmp_path: Path) -> None:
    with RawRecorder(tmp_path / "plain", storage=storage) as recorder:
        for raw in iter_raw([tiny_bag]):
            recorder.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
    bag = compressed(tmp_path / "plain", tmp_path / "bag")
    assert topics_of([bag]) == topics_of([tmp_path / "plain"])
    assert list(iter_raw([bag])) == list(iter_raw([tiny_bag]))


def test_a_compressed_file_alone_is_a_bag_and_one_beside_its_plain_copy_is_not_read_twice(
    tiny_bag: Path, tmp_path: Path
) -> None:
    bag = compressed(tiny_bag, tmp_path / "bag")
    (file,) = bag.glob("*.zstd")
    (bag / "metadata.yaml").unlink()
    assert is_bag(bag)
    assert is_bag(file)
    expected = list(iter_raw([tiny_bag]))
    assert list(iter_raw([file])) == expected
    (bag / file.stem).write_bytes((tiny_bag / file.stem).read_bytes())
    assert list(iter_raw([bag])) == expected


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_messages_that_were_compressed_are_read_without_the_metadata_that_say_so(
    storage: StoragePlugin, tiny_bag: Path, tmp_path: Path
) -> None:
    expected, connections = list(iter_raw([tiny_bag])), {}
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=storage)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        for raw in expected:
            if raw.topic not in connections:
                connections[raw.topic] = writer.add_connection(raw.topic, raw.msgtype, typestore=typestore())
            writer.write(connections[raw.topic], raw.stamp_ns, raw.data)
    assert list(iter_raw([tmp_path / "bag"])) == expected
    (tmp_path / "bag" / "metadata.yaml").unlink()
    assert list(iter_raw([tmp_path / "bag"])) == expected
    if storage is StoragePlugin.MCAP:  # as of a recorder that was killed
        (file,) = (tmp_path / "bag").iterdir()
        file.write_bytes(file.read_bytes()[:-20])
        assert list(iter_readable([file], list(connections))) == expected


def test_child_processes_read_the_copy_of_their_parent_which_removes_it(tiny_bag: Path, tmp_path: Path) -> None:
    bag = compressed(tiny_bag, tmp_path / "bag")
    child = f"from uav_vslam.datasets.compressed_bag import unpacked; print(unpacked(Path({str(bag)!r})))"
    script = f"""
import subprocess, sys
from pathlib import Path
from uav_vslam.datasets.compressed_bag import unpacked
own = unpacked(Path({str(bag)!r}))
print(own)
print(subprocess.run([sys.executable, "-c", "from pathlib import Path; " + {child!r}], stdout=-1, text=True).stdout)
"""
    environment = {name: value for name, value in os.environ.items() if name != FOLDER}
    done = subprocess.run([sys.executable, "-c", script], stdout=-1, text=True, check=True, env=environment)
    own, of_child = done.stdout.split()
    assert own == of_child
    assert not Path(own).exists()


def test_a_damaged_compressed_file_is_named(tiny_bag: Path, tmp_path: Path) -> None:
    (file,) = compressed(tiny_bag, tmp_path / "bag").glob("*.zstd")
    file.write_bytes(b"no zstd" + file.read_bytes())
    with pytest.raises(BagError, match=r"mcap\.zstd can't be unpacked"):
        topics_of([file])


def test_a_damaged_copy_is_named_as_the_bag_that_was_given(tiny_bag: Path, tmp_path: Path) -> None:
    bag = compressed(tiny_bag, tmp_path / "bag")
    (file,) = bag.glob("*.zstd")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(BagError, match=rf"^bag {bag} is damaged: read up to the damage"):
        list(iter_raw([bag]))


@pytest.mark.parametrize("text", ["", "a: [1", "other: 1", "rosbag2_bagfile_information: 1"])
def test_damaged_metadata_are_named_with_what_to_do(tiny_bag: Path, tmp_path: Path, text: str) -> None:
    bag = compressed(tiny_bag, tmp_path / "bag")
    (bag / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match=r"bag/metadata\.yaml is damaged .*correct it, or remove it"):
        topics_of([bag])
