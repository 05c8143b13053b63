# SPDX-License-Identifier: Apache-2.0
"""Each communication mode makes packets that its budget has room for."""

import numpy as np
import pytest

from uav_vslam.config import FusionConfig
from uav_vslam.slam.packet import ANCHOR, DENSE, PacketPolicy, make_packet, packet_policy, payload_bytes
from uav_vslam.vision.compact_descriptors import COMPACT, RAW


def test_wideband_sends_whole_covariances_and_raw_descriptors() -> None:
    policy = packet_policy(FusionConfig(mode="wideband", max_packet_landmarks=33))
    assert (policy.form, policy.max_landmarks, policy.descriptor_basis) == (DENSE, 33, RAW)


def test_narrowband_sends_at_most_twenty_landmarks_in_the_compact_form() -> None:
    policy = packet_policy(FusionConfig(mode="narrowband"), tag_bytes=16)
    assert (policy.form, policy.max_landmarks, policy.descriptor_basis) == (ANCHOR, 20, COMPACT)
    assert policy.tag_bytes == 16
    assert packet_policy(FusionConfig(mode="narrowband", max_packet_landmarks=5)).max_landmarks == 5


@pytest.mark.parametrize(("epoch_s", "landmarks"), [(0.5, 5), (1.0, 14), (2.0, 20), (5.0, 20)])
def test_narrowband_keeps_below_its_budget_and_one_frame_of_ethernet(make_joint, epoch_s, landmarks) -> None:
    joint = make_joint(np.random.default_rng(0).uniform(-50, 50, (40, 3)), np.eye(126))
    policy = packet_policy(FusionConfig(mode="narrowband", epoch_s=epoch_s))
    packet = make_packet(joint, sequence=1, policy=policy)
    assert len(packet) == landmarks
    assert payload_bytes(packet) <= 900 * epoch_s
    assert payload_bytes(packet) < 1400


def test_a_budget_of_ones_own_counts_for_any_mode() -> None:
    for mode in ("wideband", "narrowband"):
        assert packet_policy(FusionConfig(mode=mode, budget_bytes_per_s=700, epoch_s=0.5)).max_bytes == 350


def test_an_unknown_form_is_refused() -> None:
    with pytest.raises(ValueError, match="sparse"):
        PacketPolicy(form="sparse")
