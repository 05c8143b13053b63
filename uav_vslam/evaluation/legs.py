# SPDX-License-Identifier: Apache-2.0
"""Which stretches of one flight can stand for several vehicles (section 7.4.2 of [thesis]).

All legs last equally long and are flown at once: what a leg shares with another counts if both see it within `within_s`
of each other then. The flight is divided into SLOTS of equal length, on which legs are placed so that they do not
intersect and their mean overlap is largest: for each view of a leg the share that the other leg's best view sees,
averaged over the views, in both directions. Without a given duration, the longest legs that overlap enough are taken.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.overlap import Overlap
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

SLOTS = 120  # divisible by the usual numbers of vehicles
SHORTENING = 0.9  # from one duration to the next that is tried
SHORTEST_S = 10.0  # of a leg that is found; given ones may be shorter
SHARED = 0.1  # of a view: from there on, two vehicles have points in common


@dataclass(frozen=True, slots=True)
class Leg:
    """A stretch of the flight, [start_ns, end_ns)."""

    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class Meeting:
    """What two legs have in common.

    Attributes:
        overlap: mean share of a view that the other leg's best view sees in time, both directions.
        shared: share of the views of which that is at least `SHARED`.
        heading_deg, view_angle_deg, gap_s: at those views, median difference of the headings [deg], of the directions
            in which the common points are seen [deg], and of the times in the recording [s]; NaN for none.
    """

    overlap: float
    shared: float
    heading_deg: float
    view_angle_deg: float
    gap_s: float


def legs_by_hand(first_ns: int, spans_s: list[tuple[float, float]]) -> list[Leg]:
    """Return legs from their ends since the first image [s].

    Raises:
        UavVslamError: a leg ends before it starts, or two intersect.
    """
    spans = sorted(spans_s)
    wrong = [span for span in spans if not 0 <= span[0] < span[1]]
    wrong += [later for earlier, later in itertools.pairwise(spans) if later[0] < earlier[1]]
    if wrong:
        raise UavVslamError(
            f"leg {wrong[0][0]:g}-{wrong[0][1]:g} s is empty, begins before the first image, or intersects another"
        )
    return [Leg(first_ns + round(start * NS_PER_S), first_ns + round(end * NS_PER_S)) for start, end in spans]


def choose_legs(
    overlap: Overlap,
    first_ns: int,
    last_ns: int,
    *,
    vehicles: int,
    within_s: float,
    duration_s: float | None = None,
    min_overlap: float = 0.0,
) -> list[Leg]:
    """Return the legs of a flight, in the order of the flight.

    Args:
        overlap: of the flight's views.
        first_ns, last_ns: stamps of the first and of the last image [ns].
        vehicles: how many legs.
        within_s: largest time between two vehicles' views of a place, when the legs are flown at once [s].
        duration_s: of each leg; None for the longest that overlap by `min_overlap`.
        min_overlap: least mean overlap where no duration is given.

    Raises:
        UavVslamError: so many legs or legs of that duration do not fit in, or none overlap so much.
    """
    flight_s = (last_ns - first_ns) / NS_PER_S
    length_ns = last_ns + 1 - first_ns
    edges_ns = [first_ns + k * length_ns // SLOTS for k in range(SLOTS + 1)]
    slot = (overlap.stamps_ns - first_ns) * SLOTS // length_ns
    within = min(round(within_s / flight_s * SLOTS), SLOTS)
    best_mean, best_s = 0.0, 0.0
    for slots in _durations(flight_s, vehicles, duration_s):
        starts = _placed(_scores(slot, overlap.share, slots, within), slots, vehicles)
        legs = [Leg(edges_ns[start], edges_ns[start + slots]) for start in sorted(starts)]
        pairs = itertools.combinations(legs, 2)
        mean = float(np.mean([meeting_of(overlap, *pair, within_s=within_s).overlap for pair in pairs]))
        if mean >= min_overlap or (duration_s is not None and mean > 0):
            return legs
        if mean >= best_mean:
            best_mean, best_s = mean, slots * flight_s / SLOTS
    raise UavVslamError(
        f"no {vehicles} legs of this flight of {flight_s:.0f} s overlap by {min_overlap:.0%} within {within_s:g} s; "
        f"the best overlap by {best_mean:.0%} and last {best_s:.0f} s: lower the limit (--overlap), allow more time "
        "(--within), or name legs by hand (--legs)"
    )


def meeting_of(overlap: Overlap, one: Leg, other: Leg, *, within_s: float) -> Meeting:
    """Return what two legs have in common, if they are flown at once."""
    stamps_ns = overlap.stamps_ns
    rows, columns = (np.flatnonzero((stamps_ns >= leg.start_ns) & (stamps_ns < leg.end_ns)) for leg in (one, other))
    if len(rows) == 0 or len(columns) == 0:
        return Meeting(0.0, 0.0, float("nan"), float("nan"), float("nan"))
    apart_ns = (stamps_ns[rows, None] - one.start_ns) - (stamps_ns[None, columns] - other.start_ns)
    in_time = np.abs(apart_ns) <= within_s * NS_PER_S
    there, back = (
        _best(overlap.share, rows, columns, in_time),
        _best(overlap.share, columns, rows, in_time.T),
    )
    share, i, j = np.hstack([there, back])
    i, j = i.astype(int), j.astype(int)
    common = share >= SHARED
    gap_s = np.abs(stamps_ns[i] - stamps_ns[j]) / NS_PER_S
    medians = (_median(values[common]) for values in (overlap.heading_deg[i, j], overlap.view_angle_deg[i, j], gap_s))
    return Meeting(0.5 * float(there[0].mean() + back[0].mean()), float(common.mean()), *medians)


def _best(share: Array, rows: NDArray[np.intp], columns: NDArray[np.intp], in_time: NDArray[np.bool_]) -> Array:
    """Return (3, R): of each row the largest share, the row, and the column that has it."""
    allowed = np.where(in_time, share[np.ix_(rows, columns)], 0.0)
    return np.array([allowed.max(axis=1), rows, columns[allowed.argmax(axis=1)]])


def _median(values: Array) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _durations(flight_s: float, vehicles: int, duration_s: float | None) -> list[int]:
    """Return the numbers of slots to try, longest first."""
    longest = SLOTS // vehicles
    if longest < 1:
        raise UavVslamError(f"{vehicles} legs are too many for one flight; use at most {SLOTS}")
    if duration_s is not None:
        slots = max(round(duration_s / flight_s * SLOTS), 1)
        if slots > longest:
            raise UavVslamError(f"{vehicles} legs of {duration_s:g} s do not fit into a flight of {flight_s:.0f} s")
        return [slots]
    shortest = max(1.0, SHORTEST_S / flight_s * SLOTS)
    found = [longest]
    while found[-1] * SHORTENING >= shortest:
        found.append(min(found[-1] - 1, round(found[-1] * SHORTENING)))
    return found


def _placed(score: Array, slots: int, vehicles: int) -> list[int]:
    """Return the first slots of the best legs: the best pair, with further legs added one by one.

    Room is left for those to come.

    Args:
        score: (S, S) overlap of a leg from slot a on with one from slot b on, in one direction.
        slots: of each leg.
        vehicles: how many legs.
    """
    score, starts = 0.5 * (score + score.T), range(len(score))
    pairs = [(a, b) for a, b in itertools.combinations(starts, 2) if _room([a, b], slots) >= vehicles - 2]
    best = max(pairs, key=lambda pair: float(score[pair]))
    chosen = [*best]
    while len(chosen) < vehicles:
        left = vehicles - len(chosen) - 1
        free = [start for start in starts if _room([*chosen, start], slots) >= left]
        chosen.append(max(free, key=lambda start: float(score[start, chosen].sum())))
    return chosen


def _room(starts: list[int], slots: int) -> int:
    """Return how many legs there is room for beside those from these slots on; negative if these intersect."""
    ends = [0, *(start + slots for start in sorted(starts))]
    gaps = [after - before for before, after in zip(ends, [*sorted(starts), SLOTS], strict=True)]
    return -1 if min(gaps) < 0 else sum(gap // slots for gap in gaps)


def _scores(slot: NDArray[np.int64], share: Array, slots: int, within: int) -> Array:
    """Return (S, S): mean share of the views of a leg from slot a on that the best view of the leg from b on sees.

    A view in slot k of its leg is compared with those in slots k - within to k + within of the other.
    """
    largest = np.zeros((len(slot), SLOTS))  # that a view in each slot sees
    for column, at in enumerate(slot):
        largest[:, at] = np.maximum(largest[:, at], share[:, column])
    starts = SLOTS - slots + 1
    total, count = np.zeros((starts, starts)), np.zeros((starts, 1))
    for k in range(slots):
        low, high = max(k - within, 0), min(k + within + 1, slots)
        best = np.lib.stride_tricks.sliding_window_view(largest, high - low, axis=1).max(axis=2)
        views = (slot >= k) & (slot < k + starts)
        np.add.at(total, slot[views] - k, best[views, low : low + starts])
        np.add.at(count, slot[views] - k, 1.0)
    return np.asarray(total / np.maximum(count, 1.0))
