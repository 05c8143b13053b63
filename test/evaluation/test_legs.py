# SPDX-License-Identifier: Apache-2.0
"""Planted legs are found, and what cannot be cut is refused."""

import numpy as np
import pytest

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.legs import SLOTS, Leg, Meeting, choose_legs, legs_by_hand, meeting_of
from uav_vslam.evaluation.overlap import Overlap
from uav_vslam.types import NS_PER_S

FLIGHT_S = 120
FIRST_NS = 1_700_000_000_000_000_000
LAST_NS = FIRST_NS + FLIGHT_S * NS_PER_S
SLOT_S = FLIGHT_S / SLOTS
STAMPS_NS = FIRST_NS + NS_PER_S * np.arange(FLIGHT_S + 1)


def planted(passes: list[tuple[int, int]], length_s: int, share: float = 0.6) -> Overlap:
    """Return a flight of a view a second in which stretches of these starts see the same places in the same order."""
    count = len(STAMPS_NS)
    found = Overlap(STAMPS_NS, np.eye(count), np.full((count, count), np.nan), np.full((count, count), 90.0))
    for one, other in passes:
        for k in range(length_s):
            for i, j in ((one + k, other + k), (other + k, one + k)):
                found.share[i, j], found.view_angle_deg[i, j], found.heading_deg[i, j] = share, 12.0, 175.0
    return found


def seconds(legs: list[Leg]) -> list[tuple[float, float]]:
    return [((leg.start_ns - FIRST_NS) / NS_PER_S, (leg.end_ns - FIRST_NS) / NS_PER_S) for leg in legs]


def choose(overlap: Overlap, vehicles: int = 2, **options: float) -> list[Leg]:
    return choose_legs(overlap, FIRST_NS, LAST_NS, vehicles=vehicles, **{"within_s": 5.0, **options})


def meet(overlap: Overlap, *legs: Leg, within_s: float = 5.0) -> Meeting:
    return meeting_of(overlap, *legs, within_s=within_s)


def test_planted_legs_of_a_given_duration_are_found() -> None:
    legs = choose(planted([(17, 83)], 20), duration_s=20.0)
    np.testing.assert_allclose(seconds(legs), [(17, 37), (83, 103)], atol=1.0 + SLOT_S)  # a view a second


def test_three_planted_legs_are_found() -> None:
    legs = choose(planted([(5, 50), (50, 95), (5, 95)], 20), vehicles=3, duration_s=20.0)
    np.testing.assert_allclose(seconds(legs), [(5, 25), (50, 70), (95, 115)], atol=1.0 + SLOT_S)


def test_a_flight_that_overlaps_all_over_is_cut_into_halves() -> None:
    everywhere = planted([], 0)
    everywhere.share[:] = 0.9
    np.testing.assert_allclose(seconds(choose(everywhere, min_overlap=0.5)), [(0, 60), (60, 120)], atol=1e-6)


@pytest.mark.slow
def test_the_longest_legs_that_overlap_enough_are_taken() -> None:
    overlap = planted([(17, 83)], 20, share=0.8)
    lengths = [seconds(choose(overlap, min_overlap=least))[0] for least in (0.3, 0.5, 0.7)]
    spans = [end - start for start, end in lengths]
    assert spans == sorted(spans, reverse=True)
    assert spans[0] > spans[-1]
    for least in (0.3, 0.5, 0.7):
        legs = choose(overlap, min_overlap=least)
        assert meet(overlap, *legs).overlap >= least
        assert legs[0].end_ns <= legs[1].start_ns


def test_room_is_left_for_the_third_leg() -> None:
    """The best pair alone would leave 40 s at neither end nor between."""
    legs = choose(planted([(20, 80)], 38), vehicles=3, duration_s=40.0)
    np.testing.assert_allclose(seconds(legs), [(0, 40), (40, 80), (80, 120)], atol=1e-6)


def test_a_flight_that_overlaps_nowhere_is_refused() -> None:
    with pytest.raises(UavVslamError, match=r"no 2 legs.*overlap by 25%.*--legs"):
        choose(planted([], 0), min_overlap=0.25)


def test_legs_that_do_not_fit_are_refused() -> None:
    with pytest.raises(UavVslamError, match="3 legs of 50 s do not fit into a flight of 120 s"):
        choose(planted([], 0), vehicles=3, duration_s=50.0)


def test_a_meeting_has_the_planted_figures() -> None:
    met = meet(planted([(10, 70)], 20, share=0.6), *legs_by_hand(FIRST_NS, [(10, 30), (65, 95)]))
    assert met.overlap == pytest.approx(0.5 * (0.6 + 0.6 * 20 / 30))  # each view of one leg, two thirds of the other
    assert met.shared == pytest.approx(40 / 50)
    assert (met.heading_deg, met.view_angle_deg, met.gap_s) == (175.0, 12.0, 60.0)


def test_only_what_is_seen_in_time_counts() -> None:
    """Flown at once, the second vehicle passes the places eight seconds after the first."""
    overlap, legs = planted([(10, 70)], 20), legs_by_hand(FIRST_NS, [(10, 50), (62, 102)])
    assert meet(overlap, *legs, within_s=7.0).overlap == 0.0
    assert meet(overlap, *legs, within_s=8.0).overlap == pytest.approx(0.5 * 0.6)


def test_legs_in_opposite_directions_meet_half_way() -> None:
    overlap, legs = planted([], 0), legs_by_hand(FIRST_NS, [(10, 30), (70, 90)])
    for one, other in zip(range(10, 30), range(89, 69, -1), strict=True):
        overlap.share[one, other] = overlap.share[other, one] = 0.6
    assert meet(overlap, *legs, within_s=20.0).overlap == pytest.approx(0.6)
    assert meet(overlap, *legs, within_s=2.0).overlap == pytest.approx(0.6 * 2 / 20)


def test_legs_that_do_not_meet_have_no_angles() -> None:
    met = meet(planted([], 0), *legs_by_hand(FIRST_NS, [(0, 30), (60, 90)]))
    assert met.overlap == met.shared == 0.0
    assert np.isnan([met.heading_deg, met.view_angle_deg, met.gap_s]).all()


def test_legs_by_hand_come_in_the_order_of_the_flight() -> None:
    assert seconds(legs_by_hand(FIRST_NS, [(70, 110), (0, 40.5)])) == [(0.0, 40.5), (70.0, 110.0)]


@pytest.mark.parametrize(
    "spans", [[(0, 40), (30, 60)], [(10, 10), (20, 30)], [(-1, 10), (20, 30)], [(30, 20), (40, 50)]]
)
def test_impossible_legs_by_hand_are_refused(spans: list[tuple[float, float]]) -> None:
    with pytest.raises(UavVslamError, match=r"leg .* s is empty"):
        legs_by_hand(FIRST_NS, spans)
