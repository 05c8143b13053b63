# SPDX-License-Identifier: Apache-2.0
"""Each communication mode makes packets within its budget."""

import numpy as np
import pytest

from uav_vslam.config import FusionConfig
from uav_vslam.slam.packet import ANCHOR, DENSE, PacketPolicy, make_packet, packet_policy, payload_bytes
from uav_vslam.vision.compact_descriptors import COMPACT, RAW


def test_wideband_sends_whole_covariances_and_raw_descriptors() -> None:
    policy = packet_policy(FusionConfig(mode="wideband", max_packet_landmarks=33))
    assert (policy.form, policy.max_landmarks, policy.descriptor_basis) == (DENSE, 33, RAW)


def test_narrowband_sends_the_compact_form() -> None:
    policy = packet_policy(FusionConfig(mode="narrowband"), tag_bytes=16)
    assert (policy.form, policy.descriptor_basis, policy.tag_bytes) == (ANCHOR, COMPACT, 16)
    assert packet_policy(FusionConfig(mode="narrowband", max_packet_landmarks=5)).max_landmarks == 5


@pytest.mark.parametrize(("byte_limit", "landmarks"), [(450, 4), (900, 13), (1800, 22), (None, 22)])
def test_a_narrowband_packet_fills_one_ethernet_frame(make_joint, byte_limit, landmarks) -> None:
    joint = make_joint(np.random.default_rng(0).uniform(-50, 50, (40, 3)), np.eye(126))
    policy = packet_policy(FusionConfig(mode="narrowband"))
    packet = make_packet(joint, sequence=1, policy=policy, byte_limit=byte_limit)
    assert len(packet) == landmarks
    assert payload_bytes(packet) <= min(byte_limit or 1340, 1340)


def test_a_wideband_packet_is_an_epochs_share_of_the_budget() -> None:
    assert packet_policy(FusionConfig(budget_bytes_per_s=700, epoch_s=0.5)).max_bytes == 350


def test_an_unknown_form_is_refused() -> None:
    with pytest.raises(ValueError, match="sparse"):
        PacketPolicy(form="sparse")
