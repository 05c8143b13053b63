# SPDX-License-Identifier: Apache-2.0
"""The newest estimate of each landmark counts, and the size is bounded."""

import numpy as np

from uav_vslam.cooperation.received_map import RECEIVED_LANDMARKS, updated_map


def packet_of(sent_map, ids, height: float, *, basis: int = 0, size: int = 128):
    count = len(ids)
    positions = np.column_stack([np.asarray(ids, float), np.zeros(count), np.full(count, height)])
    covariance = height**2 * (np.eye(3 * count) + 0.5)
    return sent_map(positions, covariance, np.full((count, size), ids[0], np.uint8), 1, basis, np.array(ids, np.uint32))


def test_the_newest_packet_comes_first_and_replaces_repeated_landmarks(sent_map) -> None:
    first = updated_map(packet_of(sent_map, [1, 2, 3], 1.0), None)
    both = updated_map(packet_of(sent_map, [3, 4], 2.0), first)
    np.testing.assert_array_equal(both.ids, [3, 4, 1, 2])
    np.testing.assert_array_equal(both.positions[:, 0], [3, 4, 1, 2])
    np.testing.assert_array_equal(both.positions[:, 2], [2, 2, 1, 1])
    np.testing.assert_array_equal(both.descriptors[:, 0], [3, 3, 1, 1])
    assert both.covariance[0, 3] == 2.0  # within a packet
    assert both.covariance[6, 9] == 0.5
    assert both.covariance[0, 6] == 0.0  # between packets
    assert len(both) == 4


def test_the_same_packet_again_changes_nothing(sent_map) -> None:
    packet = packet_of(sent_map, [5, 6], 1.0)
    once = updated_map(packet, updated_map(packet_of(sent_map, [1], 1.0), None))
    twice = updated_map(packet, once)
    np.testing.assert_array_equal(twice.ids, once.ids)
    np.testing.assert_array_equal(twice.covariance, once.covariance)


def test_the_oldest_landmarks_are_removed_first(sent_map) -> None:
    known = None
    for k in range(5):
        known = updated_map(packet_of(sent_map, list(range(20 * k, 20 * k + 20)), 1.0), known)
    assert len(known) == RECEIVED_LANDMARKS
    np.testing.assert_array_equal(known.ids[:20], np.arange(80, 100))
    np.testing.assert_array_equal(known.ids[-4:], np.arange(20, 24))
    large = updated_map(packet_of(sent_map, list(range(200, 280)), 1.0), known)
    assert len(large) == 80


def test_descriptors_of_different_kinds_are_not_mixed(sent_map) -> None:
    known = updated_map(packet_of(sent_map, [1, 2], 1.0), None)
    np.testing.assert_array_equal(updated_map(packet_of(sent_map, [3], 1.0, basis=1, size=32), known).ids, [3])
