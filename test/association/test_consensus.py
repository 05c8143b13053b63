# SPDX-License-Identifier: Apache-2.0
import numpy as np

from uav_vslam.association.consensus import consensus
from uav_vslam.association.guided import gate

PROBABILITY = 0.99
PIXEL_VARIANCE = 0.25
COMMON_VARIANCE = 400.0  # common error of all predictions: sigma 20 px


def joint_case(count, rng):
    """Innovations that share one unknown shift, as under a pose error."""
    common = np.tile(np.eye(4), (count, 1)) * np.sqrt(COMMON_VARIANCE)
    S = common @ common.T + PIXEL_VARIANCE * np.eye(4 * count)
    shift = rng.normal(0.0, np.sqrt(COMMON_VARIANCE), 4)
    return shift + rng.normal(0.0, np.sqrt(PIXEL_VARIANCE), (count, 4)), S


def test_wrong_matches_inside_a_wide_gate_are_rejected_by_consensus():
    rng = np.random.default_rng(3)
    nu, S = joint_case(30, rng)
    wrong = np.arange(0, 30, 3)
    nu[wrong] += rng.uniform(5.0, 10.0, (len(wrong), 4)) * rng.choice([-1.0, 1.0], (len(wrong), 4))
    own = S.reshape(30, 4, 30, 4)[np.arange(30), :, np.arange(30), :]
    alone = [gate(np.zeros((1, 4)), own[k : k + 1], nu[k : k + 1], probability=PROBABILITY)[0, 0] for k in wrong]
    assert np.mean(alone) > 0.5  # most of them pass the gate alone
    kept = consensus(nu, S, probability=PROBABILITY)
    assert not set(kept) & set(wrong)
    assert len(kept) >= 18  # of 20: the conditional gate rejects 1 %, and the conditioning match is noisy


def test_correct_matches_are_kept():
    nu, S = joint_case(40, np.random.default_rng(4))
    assert len(consensus(nu, S, probability=PROBABILITY)) >= 38


def test_a_wrong_match_that_passes_the_gate_given_one_match_but_not_given_all_is_rejected():
    """Each landmark is uncertain, so pairs agree easily; thirty together determine the common shift."""
    rng = np.random.default_rng(6)
    count, variance = 30, 16.0
    common = np.tile(np.eye(4), (count, 1)) * np.sqrt(COMMON_VARIANCE)
    S = common @ common.T + variance * np.eye(4 * count)
    nu = rng.normal(0.0, np.sqrt(COMMON_VARIANCE), 4) + rng.normal(0.0, np.sqrt(variance), (count, 4))
    off = 9.0 * np.array([[1.0, -1.0, 1.0, -1.0], [-1.0, 1.0, 1.0, 1.0]])
    nu[[4, 20]] = nu.mean(axis=0) + off  # the gate is at 13.3: 4 * 81 / 16 = 20 given all, half of it given one alone
    kept = consensus(nu, S, probability=PROBABILITY)
    assert not set(kept) & {4, 20}
    assert len(kept) >= 26  # of 28: either gate rejects 1 %


def test_zero_and_one_match():
    assert len(consensus(np.zeros((0, 4)), np.zeros((0, 0)), probability=PROBABILITY)) == 0
    np.testing.assert_array_equal(consensus(np.ones((1, 4)), np.eye(4), probability=PROBABILITY), [0])


def test_the_input_is_not_modified():
    nu, S = joint_case(5, np.random.default_rng(5))
    before = nu.copy(), S.copy()
    consensus(nu, S, probability=PROBABILITY)
    np.testing.assert_array_equal(nu, before[0])
    np.testing.assert_array_equal(S, before[1])
