# SPDX-License-Identifier: Apache-2.0
"""A link finds a peer's frame, follows it on thin evidence, and forgets it when it no longer holds."""

import numpy as np
import pytest

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation import received_map
from uav_vslam.cooperation.frame_link import MISFITS, FrameLink
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy

CONFIG = FusionConfig()
COUNT = 24
T_OWN_PEER = Pose(rotation_from_rpy(0.0, 0.0, -2.8), np.array([30.0, 12.0, -4.0]))
MOVED = Pose(rotation_from_rpy(0.0, 0.0, 0.7), np.array([-90.0, 0.0, 9.0]))
TOLERANCE_M = 0.5  # of 24 landmarks of 0.1 m


@pytest.fixture
def meet(make_joint, sent_map):
    """Return a meeting: the link is shown a packet over some landmarks of a common world."""
    rng = np.random.default_rng(0)
    world = np.column_stack([rng.uniform(-50, 50, (COUNT, 2)), rng.normal(0, 2, COUNT)])
    P = 0.1**2 * np.eye(6 + 3 * COUNT)

    def show(link: FrameLink, rows=range(COUNT), *, wrong: int = 0, T: Pose = T_OWN_PEER, session: int = 1, **key):
        rows = np.asarray(rows)
        looks = rows.copy()
        looks[:wrong] = np.roll(rows[:wrong], 1)
        own = make_joint(world + rng.normal(0, 0.1, world.shape), P)
        packet = sent_map(
            T.inverse().apply(world[rows]) + rng.normal(0, 0.1, (len(rows), 3)),
            0.1**2 * np.eye(3 * len(rows)),
            make_joint(world[rows], np.eye(6 + 3 * len(rows)), identities=looks).descriptors,
            session,
            told=rows.astype(np.uint32),
            **key,
        )
        pairs = link.find_common(own.positions, P[6:, 6:], own.descriptors, packet, config=CONFIG)
        return [(int(a), int(rows[b])) for a, b in pairs]

    return show


@pytest.fixture
def each_for_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a link judge by the newest packet alone."""
    monkeypatch.setattr(received_map, "RECEIVED_LANDMARKS", 0)


def assert_known(link: FrameLink, T: Pose) -> None:
    assert link.alignment is not None
    np.testing.assert_allclose(link.alignment.T_own_peer.t, T.t, rtol=0, atol=TOLERANCE_M)
    np.testing.assert_allclose(link.alignment.T_own_peer.R, T.R, rtol=0, atol=0.02)


def test_a_link_begins_knowing_nothing() -> None:
    link = FrameLink()
    assert link.alignment is None
    assert link.reason == "no packet yet"
    assert link.found == 0


def test_a_frame_is_found_among_wrong_matches_and_only_right_ones_are_shared(meet) -> None:
    link = FrameLink()
    pairs = meet(link, wrong=8)
    assert_known(link, T_OWN_PEER)
    assert (link.reason, link.found) == ("", 1)
    assert len(pairs) >= COUNT - 9
    assert all(a == b for a, b in pairs)


def test_thin_evidence_shares_nothing_and_says_why(meet) -> None:
    link = FrameLink()
    assert meet(link, range(5)) == []
    assert link.alignment is None
    assert link.reason == "5 matches, 8 needed"


@pytest.mark.usefixtures("each_for_itself")
def test_once_known_a_frame_needs_few_matches(meet) -> None:
    link = FrameLink()
    meet(link)
    assert [a for a, _ in meet(link, range(5))] == list(range(5))
    assert_known(link, T_OWN_PEER)
    assert link.reason == "5 matches, 8 needed"  # why it was not renewed
    assert meet(link, range(1)) == []
    assert link.alignment is not None


def test_a_restarted_peers_frame_is_found_anew(meet) -> None:
    link = FrameLink()
    meet(link)
    assert meet(link, range(5), session=2, T=MOVED) == []
    assert link.alignment is None
    assert len(meet(link, session=2, T=MOVED)) >= COUNT - 1
    assert_known(link, MOVED)
    assert link.found == 2


def test_a_frame_that_jumps_is_replaced_at_once_by_thick_evidence(meet) -> None:
    link = FrameLink()
    meet(link)
    assert len(meet(link, T=MOVED)) >= COUNT - 1
    assert_known(link, MOVED)


@pytest.mark.usefixtures("each_for_itself")
def test_a_frame_that_matches_keep_contradicting_is_forgotten(meet) -> None:
    """Five of ten matches agree with each other, and none with the known frame: too thin for a new one."""
    link = FrameLink()
    meet(link)
    for _ in range(MISFITS - 1):
        assert meet(link, range(10), wrong=5, T=MOVED) == []
        assert link.alignment is not None
    meet(link, range(6))  # these fit: the count begins anew
    for _ in range(MISFITS):
        assert link.alignment is not None
        assert meet(link, range(10), wrong=5, T=MOVED) == []
    assert link.alignment is None
    assert link.reason == "its landmarks contradicted the frame found before"


def test_old_evidence_does_not_outlive_contradiction(meet) -> None:
    """What was heard before still agrees with the frame, but nothing that is heard now does."""
    link = FrameLink()
    meet(link)
    for _ in range(MISFITS):
        assert link.alignment is not None
        assert meet(link, range(10), wrong=5, T=MOVED) == []
    assert link.alignment is None
    assert link.reason == "its landmarks contradicted the frame found before"
    meet(link, T=MOVED)
    assert_known(link, MOVED)


def test_one_packet_contradicts_once_however_often_it_is_looked_at(meet) -> None:
    link = FrameLink()
    meet(link)
    for _ in range(2 * MISFITS):
        assert meet(link, range(10), wrong=5, T=MOVED, order=(99, 1)) == []
    assert link.alignment is not None


@pytest.mark.usefixtures("each_for_itself")
def test_few_matches_that_contradict_a_frame_prove_nothing(meet) -> None:
    link = FrameLink()
    meet(link)
    for _ in range(2 * MISFITS):
        assert meet(link, range(5), T=MOVED) == []
    assert_known(link, T_OWN_PEER)


def test_small_packets_together_are_enough(meet) -> None:
    """Six landmarks a packet: the second one's are shared, and the first one's were evidence."""
    link = FrameLink()
    assert meet(link, range(6)) == []
    assert [a for a, _ in meet(link, range(6, 12))] == list(range(6, 12))
    assert_known(link, T_OWN_PEER)


def test_what_an_earlier_session_told_is_no_evidence(meet) -> None:
    link = FrameLink()
    meet(link, range(6))
    assert meet(link, range(6, 12), session=2) == []


def test_empty_maps_share_nothing(sent_map) -> None:
    link, nothing = FrameLink(), np.zeros((0, 3))
    looks = np.zeros((0, 128), np.uint8)
    packet = sent_map(nothing, np.zeros((0, 0)), looks)
    pairs = link.find_common(nothing, np.zeros((0, 0)), looks, packet, config=CONFIG)
    assert pairs.shape == (0, 2)
    assert link.reason == "0 matches, 8 needed"
