# SPDX-License-Identifier: Apache-2.0
"""A link finds a peer's frame, tracks it with few matches, and resets it when contradicted."""

import numpy as np
import pytest

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation import received_map
from uav_vslam.cooperation.frame_link import MISFITS, FrameLink
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy

CONFIG = FusionConfig()
COUNT = 24
T_OWN_PEER = Pose(rotation_from_rpy(0.0, 0.0, -2.8), np.array([30.0, 12.0, -4.0]))
MOVED = Pose(rotation_from_rpy(0.0, 0.0, 0.7), np.array([-90.0, 0.0, 9.0]))
TOLERANCE_M = 0.5  # of 24 landmarks of 0.1 m


@pytest.fixture
def meet(make_joint, sent_map):
    """Return a function that passes the link a packet with some landmarks of a common world."""
    rng = np.random.default_rng(0)
    world = np.column_stack([rng.uniform(-50, 50, (COUNT, 2)), rng.normal(0, 2, COUNT)])
    P = 0.1**2 * np.eye(6 + 3 * COUNT)

    def receive(
        link: FrameLink, rows=range(COUNT), *, wrong=0, T: Pose = T_OWN_PEER, session: int = 1, config=CONFIG, **key
    ):
        rows = np.asarray(rows)
        appearance = rows.copy()
        appearance[:wrong] = np.roll(rows[:wrong], 1)
        own = make_joint(world + rng.normal(0, 0.1, world.shape), P)
        packet = sent_map(
            T.inverse().apply(world[rows]) + rng.normal(0, 0.1, (len(rows), 3)),
            0.1**2 * np.eye(3 * len(rows)),
            make_joint(world[rows], np.eye(6 + 3 * len(rows)), identities=appearance).descriptors,
            session,
            identifiers=rows.astype(np.uint32),
            **key,
        )
        pairs = link.find_common(OwnLandmarks(own.positions, P[6:, 6:], own.descriptors), packet, config=config)
        return [(int(a), int(rows[b])) for a, b in pairs]

    return receive


@pytest.fixture
def each_for_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a link use the newest packet only."""
    monkeypatch.setattr(received_map, "RECEIVED_LANDMARKS", 0)


def assert_known(link: FrameLink, T: Pose) -> None:
    assert link.alignment is not None
    np.testing.assert_allclose(link.alignment.T_own_peer.t, T.t, rtol=0, atol=TOLERANCE_M)
    np.testing.assert_allclose(link.alignment.T_own_peer.R, T.R, rtol=0, atol=0.02)


def test_a_new_link_has_no_alignment() -> None:
    link = FrameLink()
    assert link.alignment is None
    assert link.reason == "no packet yet"


def test_a_frame_is_found_despite_wrong_matches_and_only_inliers_are_returned(meet) -> None:
    link = FrameLink()
    pairs = meet(link, wrong=8)
    assert_known(link, T_OWN_PEER)
    assert link.reason == ""
    assert len(pairs) >= COUNT - 9
    assert all(a == b for a, b in pairs)


def test_insufficient_evidence_gives_no_matches_and_a_reason(meet) -> None:
    link = FrameLink()
    assert meet(link, range(5)) == []
    assert link.alignment is None
    assert link.reason == "5 matches, 8 needed"


@pytest.mark.usefixtures("each_for_itself")
def test_a_known_frame_needs_few_matches(meet) -> None:
    link = FrameLink()
    meet(link)
    assert [a for a, _ in meet(link, range(5))] == list(range(5))
    assert_known(link, T_OWN_PEER)
    assert link.reason == "5 matches, 8 needed"  # why it was not updated
    assert meet(link, range(1)) == []
    assert link.alignment is not None


def test_a_restarted_peers_frame_is_found_again(meet) -> None:
    link = FrameLink()
    meet(link)
    assert meet(link, range(5), session=2, T=MOVED) == []
    assert link.alignment is None
    assert len(meet(link, session=2, T=MOVED)) >= COUNT - 1
    assert_known(link, MOVED)


def test_a_frame_that_jumps_is_replaced_at_once_given_enough_matches(meet) -> None:
    link = FrameLink()
    meet(link)
    assert len(meet(link, T=MOVED)) >= COUNT - 1
    assert_known(link, MOVED)


@pytest.mark.usefixtures("each_for_itself")
def test_a_repeatedly_contradicted_frame_is_reset(meet) -> None:
    """Five of ten matches agree with each other, and none with the known frame: too few for a new one."""
    link = FrameLink()
    meet(link)
    for _ in range(MISFITS - 1):
        assert meet(link, range(10), wrong=5, T=MOVED) == []
        assert link.alignment is not None
    meet(link, range(6))  # these fit: the count is reset
    for _ in range(MISFITS):
        assert link.alignment is not None
        assert meet(link, range(10), wrong=5, T=MOVED) == []
    assert link.alignment is None
    assert link.reason == "its landmarks contradicted the frame found before"


def test_contradiction_also_resets_the_received_map(meet) -> None:
    """Earlier packets still agree with the frame, but the new ones do not."""
    link = FrameLink()
    meet(link)
    for _ in range(MISFITS):
        assert link.alignment is not None
        assert meet(link, range(10), wrong=5, T=MOVED) == []
    assert link.alignment is None
    assert link.reason == "its landmarks contradicted the frame found before"
    meet(link, T=MOVED)
    assert_known(link, MOVED)


def test_a_packet_processed_repeatedly_contradicts_once(meet) -> None:
    link = FrameLink()
    meet(link)
    for _ in range(2 * MISFITS):
        assert meet(link, range(10), wrong=5, T=MOVED, order=(99, 1)) == []
    assert link.alignment is not None


@pytest.mark.usefixtures("each_for_itself")
def test_too_few_contradicting_matches_do_not_reset_the_frame(meet) -> None:
    link = FrameLink()
    meet(link)
    for _ in range(2 * MISFITS):
        assert meet(link, range(5), T=MOVED) == []
    assert_known(link, T_OWN_PEER)


def test_small_packets_together_are_enough(meet) -> None:
    """Six landmarks a packet: the second one's are matched, the first one's are evidence."""
    link = FrameLink()
    assert meet(link, range(6)) == []
    assert [a for a, _ in meet(link, range(6, 12))] == list(range(6, 12))
    assert_known(link, T_OWN_PEER)


def test_a_single_landmark_says_nothing_about_an_unknown_frame(meet) -> None:
    link, one = FrameLink(), FusionConfig(min_common=1)
    meet(link, range(6), config=one)
    meet(link, range(6, 12), config=one)
    assert meet(link, range(12, 13), config=one) == []
    assert meet(link, range(13, 15), config=one) == [(13, 13), (14, 14)]


def test_an_earlier_session_is_no_evidence(meet) -> None:
    link = FrameLink()
    meet(link, range(6))
    assert meet(link, range(6, 12), session=2) == []


def test_empty_maps_have_no_matches(sent_map) -> None:
    link, nothing = FrameLink(), np.zeros((0, 3))
    appearance = np.zeros((0, 128), np.uint8)
    packet = sent_map(nothing, np.zeros((0, 0)), appearance)
    pairs = link.find_common(OwnLandmarks(nothing, np.zeros((0, 0)), appearance), packet, config=CONFIG)
    assert pairs.shape == (0, 2)
    assert link.reason == "0 matches, 8 needed"
