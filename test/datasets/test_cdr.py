# SPDX-License-Identifier: Apache-2.0
"""Every message of ours has a type, and wrong bytes are refused."""

import dataclasses
from pathlib import Path

import pytest

from uav_vslam.datasets.cdr import decode, typestore
from uav_vslam.datasets.rosbag import iter_raw
from uav_vslam.errors import BagError

OWN_MESSAGES = sorted((Path(__file__).resolve().parents[2] / "uav_vslam_msgs" / "msg").glob("*.msg"))


def test_every_message_of_ours_has_a_known_type() -> None:
    assert OWN_MESSAGES
    for path in OWN_MESSAGES:
        assert f"uav_vslam_msgs/msg/{path.stem}" in typestore().types


def test_bytes_that_do_not_fit_their_type_are_refused(tiny_bag: Path) -> None:
    raw = next(iter_raw([tiny_bag], ["/uav1/imu/data_raw"]))
    with pytest.raises(BagError, match="not a valid sensor_msgs/msg/Imu"):
        decode(dataclasses.replace(raw, data=raw.data[:20]))
