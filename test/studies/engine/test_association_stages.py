# SPDX-License-Identifier: Apache-2.0
"""What each stage leaves, and how it is counted."""

import numpy as np
import pytest

from uav_vslam.config import FusionConfig
from uav_vslam.slam.packet import PacketPolicy, make_packet
from uav_vslam.studies.engine.association_stages import (
    STAGES,
    UNKNOWN_FRAME,
    Identities,
    Score,
    pairs_by_stage,
    score,
    stage_rows,
)

COUNT = 12
POLICY = PacketPolicy(max_landmarks=COUNT)
TRUTH = Identities(own={k + 1: k for k in range(COUNT)}, peer={k + 1: k for k in range(COUNT)}, mistaken={1, 2})


@pytest.fixture
def meeting(make_joint):
    """Return two beliefs over the same landmarks; the peer's first two look like each other."""
    points = np.column_stack([np.random.default_rng(0).uniform(-40, 40, (COUNT, 2)), np.zeros(COUNT)])
    P = 0.2**2 * np.eye(6 + 3 * COUNT)
    looks = np.arange(COUNT)
    looks[:2] = 1, 0
    peer = make_joint(points, P, vehicle="uav2", identities=looks)
    return make_joint(points, P), make_packet(peer, sequence=1, policy=POLICY)


def test_each_stage_leaves_a_part_of_what_the_one_before_left(meeting) -> None:
    joint, packet = meeting
    stages = pairs_by_stage(joint, packet, FusionConfig())
    assert tuple(stages) == STAGES
    left = [set(map(tuple, stages[stage].tolist())) for stage in STAGES]
    assert left[0] >= left[1] > left[2] >= left[3]
    assert len(left[1]) == COUNT  # the looks alone agree everywhere
    assert len(left[3]) == COUNT - 2  # places don't


def test_right_pairs_and_findable_landmarks_are_counted(meeting) -> None:
    joint, packet = meeting
    stages = pairs_by_stage(joint, packet, FusionConfig())
    assert score(stages["+ mutual"], joint, packet, TRUTH) == Score(COUNT, COUNT - 2, COUNT - 2, COUNT - 2)
    assert score(stages["+ gate"], joint, packet, TRUTH).wrong == 0
    assert score(np.zeros((0, 2), np.intp), joint, packet, TRUTH) == Score(0, 0, 0, COUNT - 2)


def test_a_landmark_that_is_held_twice_is_found_once(make_joint) -> None:
    points, P = np.zeros((2, 3)), np.eye(12)
    joint = make_joint(points, P, identities=[5, 5])
    packet = make_packet(make_joint(points[:1], np.eye(9), vehicle="uav2"), sequence=1, policy=POLICY)
    truth = Identities(own={1: 5, 2: 5}, peer={1: 5})
    assert score(np.array([[0, 0], [1, 0]]), joint, packet, truth) == Score(2, 2, 1, 1)


def test_scores_add_up_to_rows_by_share_and_stage() -> None:
    one, other = Score(10, 8, 8, 16), Score(10, 10, 8, 16)
    rows = stage_rows(
        [(0.3, {UNKNOWN_FRAME: one}), (0.0, {"ratio": one}), (0.3, {"ratio": one}), (0.3, {"ratio": other})]
    )
    assert [(row["condition"], row["method"]) for row in rows] == [
        ("0% mistaken", "ratio"),
        ("30% mistaken", "ratio"),
        ("30% mistaken", UNKNOWN_FRAME),
    ]
    assert rows[1] == {
        "method": "ratio",
        "condition": "30% mistaken",
        "pairs": 20,
        "precision": 0.9,
        "recall": 0.5,
    }
    assert stage_rows([(0.0, {"ratio": Score()})])[0]["precision"] is None
