# SPDX-License-Identifier: Apache-2.0
"""A bag that is opened again is not parsed again, unless its metadata have changed."""

import shutil
from pathlib import Path

import pytest
from rosbags.interfaces import Connection, QosDurability

from uav_vslam.datasets import bag_reader
from uav_vslam.datasets.bag_reader import Reader
from uav_vslam.datasets.rosbag import topics_of
from uav_vslam.errors import BagError


def connections_of(bag: Path) -> list[Connection]:
    with Reader(bag) as opened:
        return [connection._replace(owner=None) for connection in opened.connections]


def test_a_second_opening_parses_nothing_and_finds_the_same(tiny_bag: Path) -> None:
    bag_reader._parsed.cache_clear()
    first = connections_of(tiny_bag)
    parsed = bag_reader._parsed.cache_info().misses
    assert parsed > 1  # the metadata, and a QoS at least
    assert connections_of(tiny_bag) == first
    assert bag_reader._parsed.cache_info().misses == parsed
    latched = {c.topic for c in first if c.ext.offered_qos_profiles[0].durability is QosDurability.TRANSIENT_LOCAL}
    assert latched == {topic for topic, info in topics_of([tiny_bag]).items() if info.latched} != set()


def test_metadata_that_have_changed_are_read_again(tiny_bag: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny_bag, tmp_path / "bag")
    assert topics_of([tmp_path / "bag"]) == topics_of([tiny_bag])
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("tiny.mcap", "gone.mcap"))
    with pytest.raises(BagError, match=r"gone\.mcap"):
        topics_of([tmp_path / "bag"])
